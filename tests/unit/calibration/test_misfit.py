"""Right models are seldom flagged, whatever the inputs; planted wrong ones are."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from tests.unit.discrepancy.surfaces import sheet

from strandline.calibration.misfit import Effort, Misfit, Prediction, by_runs, judge, misfit_of
from strandline.calibration.misfit.best_fit import BestFit
from strandline.calibration.misfit.patches import patches_of
from strandline.calibration.misfit.reference import corrected, drawn_statistics
from strandline.calibration.misfit.verdict import verdict_on
from strandline.discrepancy import ClosestPoint, Currents, Discrepancy, NormalOffset, TrackedPoints
from strandline.interface import Interface, Observation, PointErrors
from strandline.likelihood.noise_rule import noise_variance
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import Uniform
from strandline.runs import RunRecord

S = 0.002
NODES = np.linspace(0.0, 1.0, 81)
INNER = np.linspace(0.05, 0.95, 41)
MANY, FEW = np.linspace(0.05, 0.95, 301), np.linspace(0.1, 0.9, 8)
TRUTH = np.array([0.3, 0.05, 0.0])
LOCAL = PointErrors(S)
ALL = PointErrors(S, 0.05, shift=0.01, rotation=0.5, offset=0.004)
FULL = Effort(predictive=450)
LESS = Effort(draws=1000, per_part=0, predictive=450)
"""All observations together can flag a model, one part of the arc cannot."""
LEAST = Effort(draws=300, per_part=0, predictive=2)


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
    seen: Interface | np.ndarray,
    noise: PointErrors | float = LOCAL,
    *,
    prediction: Prediction | None = None,
    measure: Discrepancy | None = None,
    effort: Effort = LESS,
    explained: np.ndarray | None = None,
    **options: Any,
) -> Misfit:
    interface = seen if isinstance(seen, Interface) else Interface.polyline(seen)
    how = {"explained": explained, "effort": effort, "seed": 1}
    seen_by = (Observation(interface, noise),)
    return misfit_of(prediction or predicted(), seen_by, measure or NormalOffset(), posterior(**options), **how)


def flagged(errors: PointErrors, number: int, effort: Effort = LESS) -> int:
    return sum(judged(drawn(errors, seed), errors, seed=seed, effort=effort).flagged for seed in range(number))


def test_a_right_model_is_seldom_flagged() -> None:
    assert flagged(ALL, 8) <= 1


def bump(points: np.ndarray) -> np.ndarray:
    """Return points that a mode unknown to the model has moved by three standard deviations."""
    x = points[:, 0]
    return np.asarray(points + np.stack([0 * x, 3 * S * x * np.sin(3 * np.pi * x)], axis=1))


def lifted(points: np.ndarray) -> np.ndarray:
    return np.asarray(points + np.array([0.0, 10 * S]))


def test_a_wrong_model_is_flagged() -> None:
    """Planted: a bump, a lift, micrometres."""
    seen = drawn(LOCAL, 0).points
    for change in (bump, lifted, lambda points: 1000.0 * points):
        found = judged(change(seen))
        assert found.flagged
        assert found.verdict.startswith("The model does not explain the observation (p")
        assert "near s = " in found.verdict
        assert re.search("(deviation of that mean|times the noise); trust neither mean nor width", found.verdict)
        assert ("above the prediction" in found.verdict) or change is not lifted
        assert found.p_value is not None
        assert found.p_value < 0.01


def test_errors_that_were_stated_are_no_misfit_and_others_are() -> None:
    """Planted: a shift that nobody stated; ℓ left out. Noise that was overstated is said."""
    seen = lifted(drawn(LOCAL, 3).points)
    assert not judged(seen, replace(LOCAL, shift=0.02)).flagged
    assert judged(seen).flagged
    correlated = PointErrors(S, 0.1)
    seen = drawn(correlated, 5, MANY).points
    assert not judged(seen, correlated).flagged
    found = judged(seen)
    assert found.flagged
    assert found.conditions[0].ratio is not None
    assert found.conditions[0].ratio > 4
    found = judged(outline())
    assert not found.flagged
    assert found.verdict.startswith("The model explains the observation: p = 1")
    assert "smaller than the noise leads one to expect" in found.verdict
    assert found.predictive_p == 1.0


def p_values(name: str, t: np.ndarray, number: int) -> np.ndarray:
    """Return p-values of right models with inputs from the prior; of eight points, three inputs fit a large part."""
    found, box = [], space(0.03)
    for seed in range(number):
        truth = box.to_physical(np.random.default_rng([seed, 3]).uniform(0.2, 0.8, 3))
        one = judged(drawn(LOCAL, seed, t, truth), truth=truth, width=0.03, seed=seed, effort=LEAST)
        found.append(getattr(one, name))
    return np.array(found, float)


def unfitted(residuals: Any, fit: BestFit, *others: Any) -> Any:
    return drawn_statistics(residuals, replace(fit, by_inputs=fit.by_inputs[:, :0]), *others)


@pytest.mark.parametrize(
    ("p_value", "t", "number", "function", "planted"),
    [
        pytest.param("p_value", FEW, 30, "drawn_statistics", unfitted, id="drawn observations are not fitted"),
        pytest.param("smooth_p", INNER, 80, "beyond", lambda waves, *others: waves, id="the inputs' part is left in"),
    ],
)
def test_p_values_of_right_models_are_uniform(
    p_value: str, t: np.ndarray, number: int, function: str, planted: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of all residuals and of their waves, and a planted bug of each shows."""
    assert stats.kstest(p_values(p_value, t, number), "uniform").pvalue > 0.005
    monkeypatch.setattr(judge, function, planted)
    assert stats.kstest(p_values(p_value, t, number), "uniform").pvalue < 0.005


def test_a_smooth_error_too_small_for_the_sum_of_squares_is_flagged_by_its_waves() -> None:
    """Half of what `bump` does: among 301 points a sum over all of them does not see it."""
    for seed in range(2):
        points = drawn(LOCAL, seed, MANY).points
        found = judged(0.5 * (points + bump(points)), seed=seed)
        assert found.smooth_p is not None
        assert found.p_value is not None
        assert found.smooth_p < 0.0025 < found.p_value
        assert found.flagged


def test_a_variance_of_the_measure_stands_for_errors_of_the_points() -> None:
    """White noise of all coordinates, as a study draws it; planted: a bump."""
    for measure in (NormalOffset(), TrackedPoints(), ClosestPoint(), Currents(0.1, quadrature="centre")):
        exact = outline(NODES if isinstance(measure, TrackedPoints) else np.linspace(0.0, 1.0, len(INNER)))
        own = isinstance(measure, NormalOffset | TrackedPoints)
        variance = S**2 if own else noise_variance(measure, exact, LOCAL, len(NODES))
        noisy = exact.points + S * np.random.default_rng(0).standard_normal(exact.points.shape)
        right, wrong = (judged(points, variance, measure=measure) for points in (noisy, bump(bump(noisy))))
        assert (right.flagged, wrong.flagged) == (False, True), measure
        assert right.conditions[0].stated.assumed
        assert right.conditions[0].stated.errors.sd == pytest.approx(S, rel=0.25)
        assert any("Only σ_N² of the measure is stated" in note for note in right.notes)


def test_cameras_that_stay_where_they_are_have_one_shift() -> None:
    """Planted: one picture shifted up, the other down."""
    errors, names = PointErrors(S, shift=0.02, shared=True), ("a", "b")
    for other, verdict in ((1.0, "The model explains the observations"), (-1.0, "The model does not")):
        sides = [np.array([0.0, 10 * S * side]) for side in (1.0, other)]
        seen = [
            Observation(Interface.polyline(drawn(LOCAL, k).points + side), errors, name)
            for k, (side, name) in enumerate(zip(sides, names, strict=True))
        ]
        found = misfit_of(predicted(names), seen, NormalOffset(), posterior(), effort=LESS, seed=1)
        assert found.flagged == (other < 0)
        assert [one.condition for one in found.conditions] == ["a", "b"]
        assert found.verdict.startswith(verdict)


def test_an_uncertain_surrogate_is_no_misfit() -> None:
    """The same bump, once as an error that the surrogate reports of itself."""
    seen = bump(bump(drawn(LOCAL, 2).points))

    def uncertain(x: np.ndarray, least: float) -> Mapping[str, np.ndarray]:
        points = arches(x[None])
        return {"": points + 2 * (bump(points[0]) - points[0])}

    assert judged(seen).flagged
    assert not judged(seen, prediction=replace(predicted(), uncertain=uncertain)).flagged


def test_parts_of_the_arc_cover_it_and_the_bump_is_found_where_it_is() -> None:
    t, points = MANY, drawn(LOCAL, 4, MANY).points
    points = points + np.stack([0 * t, 8 * S * np.exp(-0.5 * ((t - 0.75) / 0.04) ** 2)], axis=1)
    found = judged(points, effort=FULL)
    (one,) = found.conditions
    assert len(one.regions) == 6
    assert one.regions[0].begin == 0.0
    assert one.regions[-1].end == pytest.approx(one.arc_length[-1])
    assert all(a.end == b.begin for a, b in zip(one.regions, one.regions[1:], strict=False))
    worst = min(one.regions, key=lambda region: (region.p_value, -region.excess))
    assert worst.begin <= float(one.arc_length[int(np.argmin(np.abs(t - 0.75)))]) <= worst.end
    assert worst.p_value < 0.01
    assert worst.mean > S
    assert found.region_p == worst.p_value


FLAT = sheet(9)
RISE = np.sin(np.pi * FLAT.points[:, 0])[:, None] * np.array([0.0, 0.0, 1.0])
ROUGH = PointErrors(0.005, 0.1)


def on_surface(change: np.ndarray | None = None, *, seed: int = 2, effort: Effort = LEAST) -> Misfit:
    """Return the misfit of a sheet that rises by 0.1 and is moved by a change along z, with correlated errors."""
    box = ParameterSpace((Parameter("rise", Uniform(0.0, 0.2)),))
    draws = np.linspace(0.09, 0.11, 50)[:, None]
    known = Posterior(box, draws, np.full(50, -np.log(50.0)), np.zeros(50), box.log_prior(draws), 0.0)

    def points(x: np.ndarray) -> Mapping[str, np.ndarray]:
        return {"": FLAT.points + x[:, :1, None] * RISE}

    prediction = Prediction({"": FLAT}, points, lambda x, least: {"": FLAT.points[None][:0]}, "the model itself")
    seen = ROUGH.draw(Interface(FLAT.points + 0.1 * RISE, FLAT.cells), np.random.default_rng(seed))
    if change is not None:
        seen = Interface(seen.points + change[:, None] * np.array([0.0, 0.0, 1.0]), FLAT.cells)
    return misfit_of(prediction, (Observation(seen, ROUGH),), NormalOffset(), known, effort=effort, seed=seed)


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
    """Planted: a bump outwards over a few errors of the points, near one corner; a slow wave."""
    off = np.linalg.norm(FLAT.points[:, :2] - (0.8, 0.2), axis=1)
    found = on_surface(0.03 * np.exp(-0.5 * (off / 0.12) ** 2), effort=replace(FULL, predictive=2))
    assert found.flagged
    worst = min(found.conditions[0].regions, key=lambda region: (region.p_value, -region.excess))
    assert worst.centre is not None
    assert np.linalg.norm(np.array(worst.centre[:2]) - (0.8, 0.2)) < 0.25
    assert (worst.side, worst.p_value < 0.01, worst.mean > 0.005) == ("outside", True, True)
    where = r"near \(\S+, \S+, \S+\) mm the observed surface lies \S+ µm outside the prediction"
    assert re.search(where, found.verdict)
    slow = on_surface(0.02 * np.cos(np.pi * FLAT.points[:, 1]), effort=replace(LESS, predictive=2))
    assert slow.flagged
    assert slow.conditions[0].ratio > 8
    assert slow.conditions[0].found.length > 2 * ROUGH.length


def test_right_surfaces_are_not_flagged() -> None:
    """The p-values of all residuals and of the patches' means are those of the noise, and so are sd and length."""
    found = [on_surface(seed=seed) for seed in range(16)]
    assert sum(one.flagged for one in found) <= 1
    assert stats.kstest([float(one.p_value or 0.0) for one in found], "uniform").pvalue > 0.005
    assert np.mean([float(one.region_p or 0.0) < 0.05 for one in found]) < 0.2
    assert found[0].smooth_p is None
    assert 0.4 < float(np.median([one.conditions[0].ratio for one in found])) < 2.5


@pytest.mark.parametrize("closed", [False, True])
def test_a_field_is_learnt_from_the_best_runs_or_the_best_run_stands_alone(closed: bool) -> None:
    """One closed run among the others: then there is no field."""
    x = space(0.003).to_physical(np.random.default_rng(1).random((40, 3)))
    lines = [Interface.polyline(points, closed=closed and k == 39) for k, points in enumerate(arches(x))]
    records = [
        RunRecord(str(k), space(0.003).as_mapping(row), "ok", {"": one})
        for k, (row, one) in enumerate(zip(x, lines, strict=True))
    ]
    values = -1e4 * ((x - TRUTH) ** 2).sum(axis=1)
    right = (Observation(drawn(LOCAL, 1), LOCAL),)
    prediction = by_runs(x, records, values, space(0.003), right, NormalOffset())
    assert prediction.run_alone == closed
    found = prediction.points(x[:3])[""]
    if closed:
        np.testing.assert_array_equal(found[0], lines[int(np.argmax(values))].points)
    else:
        np.testing.assert_allclose(found, arches(x[:3]), atol=0.1 * S)
        assert not judged(drawn(LOCAL, 1), prediction=prediction).flagged
    misfit = judged(lifted(drawn(LOCAL, 1).points), prediction=prediction)
    assert misfit.flagged is not closed
    assert ("no surrogate could be built" in misfit.verdict) == closed
    assert any("best run" in note for note in misfit.notes)


def test_what_cannot_be_computed_is_said() -> None:
    """No errors of points have a noise variance of a measure that is the same for all interfaces."""
    found = judged(drawn(LOCAL, 0), 1e-4, measure=lambda simulated, observed: 0.0)
    assert not found.flagged
    assert found.p_value is None
    assert "was not computed: noise of function" in found.verdict


def test_errors_that_leave_no_residual_are_named() -> None:
    rows: list[tuple[PointErrors | float, tuple[str, ...], str, bool]] = [
        (PointErrors(S, scale=0.01), (), "a load, an inflow, a density or any other factor", False),
        (LOCAL, ("V_in",), "a wrong value of V_in, a density or", True),
        (1e-6, (), "an inflow", True),
    ]
    for noise, fixed, told, of_scale in rows:
        text = judge.invisible([Observation(outline(), noise)], ["E", "nu"], fixed)
        assert text.count(". ") == 1
        assert text.startswith("Residuals cannot reveal an error that E or nu can compensate for: ")
        assert told in text
        assert ("picture scale" in text) == of_scale
        assert ("inflow" in text) == (not fixed)


def test_each_kind_of_test_alone_can_flag_a_model() -> None:
    """Even the least p-value is above the level if there are too few draws."""
    for conditions in (1, 3):
        names = tuple(f"load {k}" for k in range(conditions))
        seen = [Observation(drawn(LOCAL, k), LOCAL, name) for k, name in enumerate(names)]
        bent = seen[0].interface.points + S * 12 * (np.abs(INNER - 0.5) < 0.04)[:, None]
        seen[0] = replace(seen[0], interface=Interface.polyline(bent))
        found = misfit_of(predicted(names), seen, NormalOffset(), posterior(), effort=FULL, seed=1)
        assert min(region.p_value for one in found.conditions for region in one.regions) < 0.01 / 4
        assert verdict_on(0.5, 0.5, 0.5, found.conditions, run_alone=False).flagged
    assert verdict_on(0.5, 1 / (1 + Effort().predictive), 0.5, (), run_alone=False).flagged


def test_what_was_removed_or_allowed_for_is_said() -> None:
    def told(errors: PointErrors = LOCAL, error: float | None = None) -> tuple[str, str]:
        explained = None if error is None else np.full((len(INNER), 1), error)
        found = judged(drawn(LOCAL, 1), errors, explained=explained, effort=LEAST)
        return found.verdict, " ".join(found.notes)

    for size, said in ((0.0, "The model"), (0.01 * S, "The model"), (S, "With an error of the model allowed for, the")):
        assert told(error=size)[0].startswith(said)
    assert "The most probable model error was removed from the residuals." in told(error=S)[1]
    both = r"The most probable shift \(\S+, \S+\) µm and rotation \S+° were removed from the residuals\."
    assert re.search(both, told(replace(LOCAL, shift=0.01, rotation=0.5))[1])
    notes = told(replace(LOCAL, shift=0.01), S)[1]
    assert "The most probable model error was removed" in notes
    assert "The most probable shift (" in notes
    assert "removed" not in told()[1]


def test_the_shift_that_was_removed_is_that_of_the_observation() -> None:
    for shift in ((0.004, -0.006), (-0.009, 0.002)):
        errors, moved = replace(LOCAL, shift=0.02), drawn(LOCAL, 1).points + shift
        removed = judged(moved, errors, width=1e-4, effort=LEAST).conditions[0].removed
        assert list(removed) == ["shift"]
        np.testing.assert_allclose(removed["shift"], shift, atol=0.0015)


def test_p_values_are_corrected_as_holm_does() -> None:
    np.testing.assert_allclose(corrected(np.array([0.04, 0.01, 0.5, 0.03])), [0.09, 0.04, 0.5, 0.09])
