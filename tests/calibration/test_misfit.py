"""Right models are seldom flagged, whatever the inputs; planted wrong ones are."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from tests.discrepancy.surfaces import sheet

from strandline.calibration import Calibration, Misfit, Problem, Settings, calibrate
from strandline.calibration.misfit import Prediction, by_runs, judge, misfit_of
from strandline.calibration.misfit.best_fit import BestFit
from strandline.calibration.misfit.patches import patches_of
from strandline.calibration.misfit.predictive import DRAWS
from strandline.calibration.misfit.reference import PER_PART, corrected, drawn_statistics
from strandline.calibration.misfit.verdict import verdict_on
from strandline.discrepancy import ClosestPoint, Currents, Discrepancy, NormalOffset, TrackedPoints
from strandline.interface import Interface, Observation, PointErrors
from strandline.likelihood.noise_rule import noise_variance
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import Uniform
from strandline.runs import RunRecord
from strandline.smc import SMCSettings
from strandline.testing.studies import beam

S = 0.002
NODES = np.linspace(0.0, 1.0, 161)
INNER = np.linspace(0.05, 0.95, 41)
TRUTH = np.array([0.3, 0.05, 0.0])
LOCAL = PointErrors(S)
ALL = PointErrors(S, 0.05, shift=0.01, rotation=0.5, offset=0.004)
Change = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(autouse=True)
def _all_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Undo what the other tests save."""
    draws = {"reference.DRAWS": 4000, "reference.PER_PART": PER_PART, "predictive.DRAWS": DRAWS}
    for place, value in ({"prediction.MOST_RUNS": 64} | draws).items():
        monkeypatch.setattr(f"strandline.calibration.misfit.{place}", value)


def arches(x: np.ndarray, t: np.ndarray = NODES) -> np.ndarray:
    """Return arches of some height that lean to one side and are lifted."""
    height, lean, lift = x.T[:, :, None]
    return np.stack([t + lean * np.sin(np.pi * t), lift + 4 * height * t * (1 - t)], axis=2)


def space(width: float) -> ParameterSpace:
    names = zip(("height", "lean", "lift"), TRUTH.tolist(), strict=True)
    return ParameterSpace(tuple(Parameter(name, Uniform(at - width, at + width)) for name, at in names))


def predicted(conditions: tuple[str, ...] = ("",)) -> Prediction:
    """Return the model itself: it is not uncertain."""

    def points(x: np.ndarray) -> Mapping[str, np.ndarray]:
        return dict.fromkeys(conditions, arches(x))

    def uncertain(x: np.ndarray, least: float) -> Mapping[str, np.ndarray]:
        return dict.fromkeys(conditions, arches(x[None])[:0])

    template = Interface.polyline(arches(TRUTH[None])[0])
    return Prediction(dict.fromkeys(conditions, template), points, uncertain, "the model itself")


def posterior(truth: np.ndarray = TRUTH, *, width: float = 0.003, seed: int = 0) -> Posterior:
    """Return draws about the truth; only where they begin and how far they reach matters."""
    box = space(width)
    draws = truth + 3e-4 * np.random.default_rng(seed).standard_normal((200, 3))
    draws = np.clip(draws, box.low, box.high)
    level = np.full(200, -np.log(200.0))
    return Posterior(box, draws, level, np.zeros(200), box.log_prior(draws), 0.0)


def outline(t: np.ndarray = INNER, truth: np.ndarray = TRUTH) -> Interface:
    return Interface.polyline(arches(truth[None], t)[0])


def drawn(errors: PointErrors, seed: int, t: np.ndarray = INNER, truth: np.ndarray = TRUTH) -> Interface:
    return errors.draw(outline(t, truth), np.random.default_rng([seed, 17]))


def judged(
    seen: Interface, noise: PointErrors | float, *, measure: Discrepancy | None = None, **options: Any
) -> Misfit:
    observations = (Observation(seen, noise),)
    return misfit_of(predicted(), observations, measure or NormalOffset(), posterior(**options), seed=1)


def flagged(errors: PointErrors, number: int) -> int:
    return sum(judged(drawn(errors, seed), errors, seed=seed).flagged for seed in range(number))


@pytest.mark.parametrize("errors", [LOCAL, ALL], ids=["local", "all"])
def test_a_right_model_is_seldom_flagged(errors: PointErrors) -> None:
    assert flagged(errors, 40) <= 4


@pytest.mark.long
@pytest.mark.parametrize("errors", [LOCAL, ALL], ids=["local", "all"])
def test_a_right_model_is_flagged_in_one_case_of_twenty_at_most(errors: PointErrors) -> None:
    assert flagged(errors, 200) <= 10


def bump(points: np.ndarray) -> np.ndarray:
    """Return points that a mode unknown to the model has moved by three standard deviations."""
    x = points[:, 0]
    return np.asarray(points + np.stack([0 * x, 3 * S * x * np.sin(3 * np.pi * x)], axis=1))


def lifted(points: np.ndarray) -> np.ndarray:
    return np.asarray(points + np.array([0.0, 10 * S]))


def in_micrometres(points: np.ndarray) -> np.ndarray:
    return np.asarray(1000.0 * points)


@pytest.mark.parametrize("change", [bump, lifted, in_micrometres])
@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_model_is_flagged(change: Change, seed: int) -> None:
    seen = drawn(LOCAL, seed, np.linspace(0.05, 0.95, 101))
    found = judged(Interface.polyline(change(seen.points)), LOCAL, seed=seed)
    assert found.flagged
    assert found.verdict.startswith("The model does not explain the observation (p")
    assert "near s = " in found.verdict
    assert re.search(
        r"(times the standard deviation of that mean|times the noise); trust neither mean nor width", found.verdict
    )
    if change is lifted:
        assert "above the prediction" in found.verdict
    assert found.p_value is not None
    assert found.p_value < 0.01


def test_a_global_error_that_was_stated_is_no_misfit_and_else_it_is() -> None:
    """Planted: a shift of the picture that nobody stated."""
    seen = Interface.polyline(lifted(drawn(LOCAL, 3).points))
    assert not judged(seen, replace(LOCAL, shift=0.02)).flagged
    assert judged(seen, LOCAL).flagged


def test_correlated_errors_taken_as_independent_show() -> None:
    """Planted: ℓ left out."""
    seen = drawn(PointErrors(S, 0.1), 5, np.linspace(0.05, 0.95, 201))
    assert not judged(seen, PointErrors(S, 0.1)).flagged
    found = judged(seen, LOCAL)
    assert found.flagged
    (one,) = found.conditions
    assert one.ratio is not None
    assert one.ratio > 4


FEW = np.linspace(0.1, 0.9, 8)


def p_values(name: str = "p_value", number: int = 60, t: np.ndarray = FEW) -> np.ndarray:
    """Return p-values of right models with inputs from the prior; of eight points, three inputs fit a large part."""
    found, box = [], space(0.03)
    for seed in range(number):
        truth = box.to_physical(np.random.default_rng([seed, 3]).uniform(0.2, 0.8, 3))
        one = judged(drawn(LOCAL, seed, t, truth), LOCAL, truth=truth, width=0.03, seed=seed)
        found.append(getattr(one, name))
    return np.array(found, float)


@pytest.fixture
def fewer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strandline.calibration.misfit.reference.DRAWS", 500)
    monkeypatch.setattr("strandline.calibration.misfit.reference.PER_PART", 0)
    monkeypatch.setattr("strandline.calibration.misfit.predictive.DRAWS", 20)


def test_p_values_of_right_models_are_uniform(fewer: None) -> None:
    assert stats.kstest(p_values(), "uniform").pvalue > 0.005


def test_p_values_of_the_waves_of_right_models_are_uniform(fewer: None) -> None:
    assert stats.kstest(p_values("smooth_p", t=INNER), "uniform").pvalue > 0.005


def test_waves_that_inputs_can_cause_show(fewer: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: the inputs' part of the waves is left in; it depends on the truth, not only on the noise."""
    monkeypatch.setattr(judge, "beyond", lambda waves, *others: waves)
    assert stats.kstest(p_values("smooth_p", t=INNER), "uniform").pvalue < 0.005


def test_a_smooth_error_too_small_for_the_sum_of_squares_is_flagged_by_its_waves() -> None:
    """Half of what `bump` does: among 301 points a sum over all of them does not see it."""
    found = []
    for seed in range(6):
        points = drawn(LOCAL, seed, np.linspace(0.05, 0.95, 301)).points
        found.append(judged(Interface.polyline(0.5 * (points + bump(points))), LOCAL, seed=seed))
    assert max(one.smooth_p for one in found if one.smooth_p is not None) < 0.0025
    assert min(one.p_value for one in found if one.p_value is not None) > 0.0025
    assert all(one.flagged for one in found)


def test_inputs_left_out_of_the_projection_show(fewer: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: drawn observations are not fitted."""

    def unfitted(residuals: Any, fit: BestFit, *others: Any) -> Any:
        return drawn_statistics(residuals, replace(fit, by_inputs=fit.by_inputs[:, :0]), *others)

    monkeypatch.setattr(judge, "drawn_statistics", unfitted)
    assert stats.kstest(p_values(), "uniform").pvalue < 0.005


def test_noise_that_was_overstated_is_no_misfit_but_said() -> None:
    found = judged(outline(), LOCAL)
    assert not found.flagged
    assert found.verdict.startswith("The model explains the observation: p = 1")
    assert "smaller than the noise leads one to expect" in found.verdict
    assert found.predictive_p == 1.0


MEASURES = [
    NormalOffset(),
    TrackedPoints(),
    ClosestPoint(),
    ClosestPoint(direction="to_simulated"),
    Currents(0.1, quadrature="centre"),
]


@pytest.mark.parametrize("measure", MEASURES, ids=str)
def test_a_variance_of_the_measure_stands_for_errors_of_the_points(measure: Discrepancy) -> None:
    """White noise of all coordinates, as a study draws it; planted: a bump."""
    t = NODES if isinstance(measure, TrackedPoints) else np.linspace(0.0, 1.0, 101)
    exact = outline(t)
    own = isinstance(measure, NormalOffset | TrackedPoints)
    variance = S**2 if own else noise_variance(measure, exact, LOCAL, len(NODES))
    right, wrong = [], []
    for seed in range(3):
        noisy = exact.points + S * np.random.default_rng(seed).standard_normal(exact.points.shape)
        right.append(judged(Interface.polyline(noisy), variance, measure=measure))
        wrong.append(judged(Interface.polyline(bump(bump(noisy))), variance, measure=measure))
    assert sum(one.flagged for one in right) <= 1
    assert all(one.flagged for one in wrong)
    assert right[0].conditions[0].stated.assumed
    assert right[0].conditions[0].stated.errors.sd == pytest.approx(S, rel=0.25)
    assert any("Only σ_N² of the measure is stated" in note for note in right[0].notes)


@pytest.mark.parametrize("sides", [(1.0, 1.0), (1.0, -1.0)])
def test_cameras_that_stay_where_they_are_have_one_shift(sides: tuple[float, float]) -> None:
    """Planted: one picture shifted up, the other down."""
    errors, names = PointErrors(S, shift=0.02, shared=True), ("a", "b")
    seen = [
        Observation(Interface.polyline(drawn(LOCAL, k).points + np.array([0.0, 10 * S * side])), errors, name)
        for k, (side, name) in enumerate(zip(sides, names, strict=True))
    ]
    found = misfit_of(predicted(names), seen, NormalOffset(), posterior(), seed=1)
    assert found.flagged == (sides[0] != sides[1])
    assert [one.condition for one in found.conditions] == ["a", "b"]
    assert found.verdict.startswith(
        "The model explains the observations" if not found.flagged else "The model does not"
    )


def test_an_uncertain_surrogate_is_no_misfit() -> None:
    """The same bump, once as an error that the surrogate reports of itself."""
    seen = Interface.polyline(bump(bump(drawn(LOCAL, 2).points)))

    def uncertain(x: np.ndarray, least: float) -> Mapping[str, np.ndarray]:
        points = arches(x[None])
        return {"": points + 2 * (bump(points[0]) - points[0])}

    one, other = predicted(), replace(predicted(), uncertain=uncertain)
    observations = (Observation(seen, LOCAL),)
    assert misfit_of(one, observations, NormalOffset(), posterior(), seed=1).flagged
    assert not misfit_of(other, observations, NormalOffset(), posterior(), seed=1).flagged


def test_parts_of_the_arc_cover_it_and_the_bump_is_found_where_it_is() -> None:
    t = np.linspace(0.05, 0.95, 151)
    points = drawn(LOCAL, 4, t).points
    points = points + np.stack([0 * t, 8 * S * np.exp(-0.5 * ((t - 0.75) / 0.04) ** 2)], axis=1)
    found = judged(Interface.polyline(points), LOCAL)
    (one,) = found.conditions
    assert len(one.regions) == 6
    assert one.regions[0].begin == 0.0
    assert one.regions[-1].end == pytest.approx(one.arc_length[-1])
    assert all(a.end == b.begin for a, b in zip(one.regions, one.regions[1:], strict=False))
    worst = min(one.regions, key=lambda region: (region.p_value, -region.excess))
    peak = float(one.arc_length[int(np.argmin(np.abs(t - 0.75)))])
    assert worst.begin <= peak <= worst.end
    assert worst.p_value < 0.01
    assert worst.mean > S
    assert found.region_p == worst.p_value


FLAT = sheet(9)
RISE = np.sin(np.pi * FLAT.points[:, 0])[:, None] * np.array([0.0, 0.0, 1.0])
ROUGH = PointErrors(0.005, 0.1)


def on_surface(change: np.ndarray | None = None, *, seed: int = 2) -> Misfit:
    """Return the misfit of a sheet that rises by 0.1 and is moved by a change along z, with correlated errors."""
    box = ParameterSpace((Parameter("rise", Uniform(0.0, 0.2)),))
    draws = np.linspace(0.09, 0.11, 50)[:, None]
    known = Posterior(box, draws, np.full(50, -np.log(50.0)), np.zeros(50), box.log_prior(draws), 0.0)

    def points(x: np.ndarray) -> Mapping[str, np.ndarray]:
        return {"": FLAT.points + x[:, :1, None] * RISE}

    def uncertain(x: np.ndarray, least: float) -> Mapping[str, np.ndarray]:
        return {"": FLAT.points[None][:0]}

    prediction = Prediction({"": FLAT}, points, uncertain, "the model itself")
    exact = Interface(points(np.array([[0.1]]))[""][0], FLAT.cells)
    seen = ROUGH.draw(exact, np.random.default_rng(seed))
    if change is not None:
        seen = Interface(seen.points + change[:, None] * np.array([0.0, 0.0, 1.0]), FLAT.cells)
    return misfit_of(prediction, (Observation(seen, ROUGH),), NormalOffset(), known, seed=seed)


def test_patches_cover_a_surface_and_are_compact() -> None:
    which = patches_of(FLAT.points)
    assert set(which.tolist()) == set(range(8))
    np.testing.assert_array_equal(which, patches_of(FLAT.points))
    sizes = np.bincount(which)
    assert sizes.min() > 0.3 * sizes.max()
    spread = [FLAT.points[which == k].std(axis=0).max() for k in range(8)]
    assert max(spread) < 0.6 * FLAT.points.std(axis=0).max()
    assert patches_of(FLAT.points[:3]).tolist() == [0, 0, 0]


def test_a_wrong_surface_is_flagged_and_its_patch_is_named() -> None:
    """Planted: a bump outwards over a few errors of the points, near one corner."""
    off = np.linalg.norm(FLAT.points[:, :2] - (0.8, 0.2), axis=1)
    found = on_surface(0.03 * np.exp(-0.5 * (off / 0.12) ** 2))
    assert found.flagged
    (one,) = found.conditions
    worst = min(one.regions, key=lambda region: (region.p_value, -region.excess))
    assert worst.centre is not None
    assert np.linalg.norm(np.array(worst.centre[:2]) - (0.8, 0.2)) < 0.25
    assert (worst.side, worst.p_value < 0.01, worst.mean > 0.005) == ("outside", True, True)
    where = r"near \(\S+, \S+, \S+\) mm the observed surface lies \S+ µm outside the prediction"
    assert re.search(where, found.verdict)


def test_right_surfaces_are_not_flagged(fewer: None) -> None:
    """The p-values of all residuals and of the patches' means are those of the noise."""
    found = [on_surface(seed=seed) for seed in range(30)]
    assert sum(one.flagged for one in found) <= 2
    assert stats.kstest([float(one.p_value or 0.0) for one in found], "uniform").pvalue > 0.005
    least = np.array([float(one.region_p or 0.0) for one in found])
    assert (least < 0.05).mean() < 0.2
    assert found[0].smooth_p is None


def test_residuals_of_a_surface_have_their_own_sd_and_length(fewer: None) -> None:
    """Over draws the ratio is about 1; a slow wave has a length of its own."""
    ratios = [on_surface(seed=seed).conditions[0].ratio for seed in range(12)]
    assert 0.4 < float(np.median(ratios)) < 2.5
    slow = on_surface(0.02 * np.cos(np.pi * FLAT.points[:, 1]))
    assert slow.flagged
    assert slow.conditions[0].ratio > 8
    assert slow.conditions[0].found.length > 2 * ROUGH.length


def runs(number: int, *, closed: bool) -> tuple[np.ndarray, list[RunRecord]]:
    """Return runs, the last of which may be closed: then there is no field."""
    x = space(0.003).to_physical(np.random.default_rng(1).random((number, 3)))
    lines = [Interface.polyline(points, closed=closed and k == number - 1) for k, points in enumerate(arches(x))]
    names = space(0.003).names
    inputs = [dict(zip(names, row, strict=True)) for row in x.tolist()]
    return x, [RunRecord(str(k), one, "ok", {"": lines[k]}) for k, one in enumerate(inputs)]


@pytest.mark.parametrize("closed", [False, True])
def test_a_field_is_learnt_from_the_best_runs_or_the_best_run_stands_alone(closed: bool) -> None:
    x, records = runs(40, closed=closed)
    values = -1e4 * ((x - TRUTH) ** 2).sum(axis=1)
    right = (Observation(drawn(LOCAL, 1), LOCAL),)
    prediction = by_runs(x, records, values, space(0.003), right, NormalOffset())
    assert prediction.run_alone == closed
    found = prediction.points(x[:3])[""]
    if closed:
        np.testing.assert_array_equal(found[0], records[int(np.argmax(values))].interfaces[""].points)
    else:
        np.testing.assert_allclose(found, arches(x[:3]), atol=0.1 * S)
        assert not misfit_of(prediction, right, NormalOffset(), posterior(), seed=1).flagged
    wrong = (Observation(Interface.polyline(lifted(drawn(LOCAL, 1).points)), LOCAL),)
    misfit = misfit_of(prediction, wrong, NormalOffset(), posterior(), seed=1)
    assert misfit.flagged is not closed
    assert ("no surrogate could be built" in misfit.verdict) == closed
    assert any("best run" in note for note in misfit.notes)


def blind(simulated: Interface, observed: Interface) -> float:
    """Return the same for all interfaces: no errors of points have a noise variance of this measure."""
    return 0.0


def test_what_cannot_be_computed_is_said() -> None:
    found = judged(drawn(LOCAL, 0), 1e-4, measure=blind)
    assert not found.flagged
    assert found.p_value is None
    assert "was not computed: noise of function" in found.verdict


@pytest.mark.parametrize(
    ("noise", "fixed", "told", "silent"),
    [
        (PointErrors(S, scale=0.01), (), ["a load, an inflow, a density or any other factor."], ["picture scale"]),
        (LOCAL, ("V_in",), ["a wrong value of V_in, a density or", "factor, or most of a wrong picture"], ["inflow"]),
        (1e-6, (), ["picture scale"], []),
    ],
)
def test_errors_that_leave_no_residual_are_named(
    noise: PointErrors | float, fixed: tuple[str, ...], told: list[str], silent: list[str]
) -> None:
    text = judge.invisible([Observation(outline(), noise)], ["E", "nu"], fixed)
    assert text.count(". ") == 1
    assert text.startswith("Residuals cannot reveal an error that E or nu can compensate for: ")
    assert all(words in text for words in told)
    assert not any(words in text for words in silent)


@pytest.mark.parametrize("conditions", [1, 2, 5])
def test_each_kind_of_test_alone_can_flag_a_model(conditions: int) -> None:
    """Even the least p-value is above the level if there are too few draws."""
    names = tuple(f"load {k}" for k in range(conditions))
    seen = [Observation(drawn(LOCAL, k), LOCAL, name) for k, name in enumerate(names)]
    bent = Interface.polyline(seen[0].interface.points + S * 12 * (np.abs(INNER - 0.5) < 0.04)[:, None])
    observations = (Observation(bent, LOCAL, names[0]), *seen[1:])
    found = misfit_of(predicted(names), observations, NormalOffset(), posterior(), seed=1)
    parts = [region.p_value for one in found.conditions for region in one.regions]
    assert min(parts) < 0.01 / 4
    assert verdict_on(0.5, 0.5, 0.5, found.conditions, run_alone=False).flagged
    assert verdict_on(0.5, 1 / (1 + DRAWS), 0.5, (), run_alone=False).flagged


@pytest.mark.parametrize(("size", "said"), [(0.0, ""), (0.01 * S, ""), (S, "With an error of the model allowed for, ")])
def test_a_model_error_is_mentioned_unless_it_is_negligible(size: float, said: str) -> None:
    seen = (Observation(drawn(LOCAL, 1), LOCAL),)
    explained = np.full((len(INNER), 1), size)
    found = misfit_of(predicted(), seen, NormalOffset(), posterior(), explained=explained, seed=1)
    assert found.verdict.startswith(said + ("the model" if said else "The model") + " explains")


def test_what_was_removed_is_said() -> None:
    def notes(errors: PointErrors, explained: np.ndarray | None = None) -> str:
        seen = (Observation(drawn(LOCAL, 1), errors),)
        found = misfit_of(predicted(), seen, NormalOffset(), posterior(), explained=explained, seed=1)
        return " ".join(found.notes)

    error = np.full((len(INNER), 1), S)
    assert "The most probable model error was removed from the residuals." in notes(LOCAL, error)
    both = notes(replace(LOCAL, shift=0.01, rotation=0.5))
    assert re.search(
        r"The most probable shift \(\S+, \S+\) µm and rotation \S+° were removed from the residuals\.", both
    )
    some = notes(replace(LOCAL, shift=0.01), error)
    assert "The most probable model error was removed" in some
    assert "The most probable shift (" in some
    assert "removed" not in notes(LOCAL)


@pytest.mark.parametrize("shift", [(0.004, -0.006), (-0.009, 0.002)])
def test_the_shift_that_was_removed_is_that_of_the_observation(shift: tuple[float, float]) -> None:
    errors = replace(LOCAL, shift=0.02)
    moved = Interface.polyline(drawn(LOCAL, 1).points + shift)
    found = misfit_of(predicted(), (Observation(moved, errors),), NormalOffset(), posterior(width=1e-4), seed=1)
    removed = found.conditions[0].removed
    assert list(removed) == ["shift"]
    np.testing.assert_allclose(removed["shift"], shift, atol=0.0015)


def test_p_values_are_corrected_as_holm_does() -> None:
    np.testing.assert_allclose(corrected(np.array([0.04, 0.01, 0.5, 0.03])), [0.09, 0.04, 0.5, 0.09])


def calibrated(change: Change | None, folder: Path, surrogate: Any) -> Calibration:
    """Return the calibration of a bent beam, whose observation a change has moved."""
    points = beam({"E": 400.0, "tilt": 0.02, "load": 1e-5}, folder).interface.points
    points = points + 0.003 * np.random.default_rng(4).standard_normal(points.shape)
    seen = Interface.polyline(points if change is None else change(points))
    box = ParameterSpace((Parameter("E", Uniform(300.0, 560.0), "Pa"), Parameter("tilt", Uniform(0.0, 0.04))))
    problem = Problem(beam, box, {"load": 1e-5}, (Observation(seen, 0.003**2),), {"tracked": TrackedPoints()})
    smc = SMCSettings(rejuvenation_steps=3, zeta=0.5)
    return calibrate(problem, Settings(runs=32, particles=500, smc=smc, surrogate=surrogate))


@pytest.mark.parametrize("surrogate", ["log_likelihood", "field"])
def test_every_calibration_has_its_misfit(tmp_path: Path, surrogate: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strandline.calibration.method._sensitivity", lambda *arguments: None)
    right = calibrated(None, tmp_path, surrogate).misfit
    wrong = calibrated(lambda points: bump(bump(bump(points))), tmp_path, surrogate).misfit
    assert right is not None
    assert wrong is not None
    assert (right.flagged, wrong.flagged) == (False, True)
    assert repr(wrong).startswith("<Misfit The model does not explain the observation")
    assert len(right.conditions[0].residual) == 17
    assert any("best runs" in note for note in right.notes) == (surrogate == "log_likelihood")
    assert "a wrong value of load" in right.notes[-1]
