"""Right models are seldom flagged, whatever the inputs; planted wrong ones are."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from tests.unit.discrepancy.surfaces import sheet

from strandline.calibration import assess_fit
from strandline.calibration import best_fit as fits
from strandline.calibration.assess_fit import misfit_of
from strandline.calibration.best_fit import Prediction, by_runs, corrected, drawn_statistics
from strandline.calibration.misfit import Effort, verdict_on
from strandline.discrepancy import ClosestPoint, Currents, NormalOffset, TrackedPoints
from strandline.interface import Interface, Observation, PointErrors
from strandline.likelihood.noise_rule import noise_variance
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.posterior import Posterior
from strandline.runs import RunRecord

S = 0.002
NODES, INNER = np.linspace(0.0, 1.0, 81), np.linspace(0.05, 0.95, 41)
MANY, FEW = np.linspace(0.05, 0.95, 301), np.linspace(0.1, 0.9, 8)
TRUTH = np.array([0.3, 0.05, 0.0])
LOCAL = PointErrors(S)
ALL = PointErrors(S, 0.05, shift=0.01, rotation=0.5, offset=0.004)
FULL = Effort(predictive=450)
LESS = Effort(draws=1000, per_part=0, predictive=450)
"""All observations together can flag a model, one part of the arc cannot."""
LEAST = Effort(draws=300, per_part=0, predictive=2)


def arches(x, t=NODES):
    """Return arches of some height that lean to one side and are lifted."""
    height, lean, lift = x.T[:, :, None]
    return np.stack([t + lean * np.sin(np.pi * t), lift + 4 * height * t * (1 - t)], axis=2)


def space(width):
    names = zip(("height", "lean", "lift"), TRUTH.tolist(), strict=True)
    return ParameterSpace(tuple(Parameter(name, Uniform(at - width, at + width)) for name, at in names))


def predicted(conditions=("",)):
    """Return the model itself: it is not uncertain."""
    each, nothing = dict.fromkeys, dict.fromkeys(conditions, arches(TRUTH[None])[:0])
    points, uncertain = (lambda x: each(conditions, arches(x))), (lambda x, least: nothing)
    return Prediction(each(conditions, outline(NODES)), points, uncertain, "the model itself")


def posterior(truth=TRUTH, *, width=0.003, seed=0):
    """Return draws about the truth; only where they begin and how far they reach matters."""
    box = space(width)
    draws = np.clip(truth + 3e-4 * np.random.default_rng(seed).standard_normal((200, 3)), box.low, box.high)
    return Posterior(box, draws, np.full(200, -np.log(200.0)), np.zeros(200), box.log_prior(draws), 0.0)


def outline(t=INNER, truth=TRUTH):
    return Interface.polyline(arches(truth[None], t)[0])


def drawn(errors, seed, t=INNER, truth=TRUTH):
    return errors.draw(outline(t, truth), np.random.default_rng([seed, 17]))


def judged(seen, noise=LOCAL, *, prediction=None, measure=None, effort=LESS, explained=None, **options):
    interface = seen if isinstance(seen, Interface) else Interface.polyline(seen)
    how = {"explained": explained, "effort": effort, "seed": 1}
    seen_by = (Observation(interface, noise),)
    return misfit_of(prediction or predicted(), seen_by, measure or NormalOffset(), posterior(**options), **how)


def flagged(errors, number, effort=LESS):
    return sum(judged(drawn(errors, seed), errors, seed=seed, effort=effort).flagged for seed in range(number))


def bump(points, size=3.0):
    """Return points that a mode unknown to the model has moved by some standard deviations."""
    x = points[:, 0]
    return points + np.stack([0 * x, size * S * x * np.sin(3 * np.pi * x)], axis=1)


def lifted(points):
    return points + np.array([0.0, 10 * S])


@pytest.mark.repeats
def test_a_right_model_is_seldom_flagged_and_a_wrong_one_is():
    """Planted: a bump, a lift, micrometres."""
    assert flagged(ALL, 8) <= 1
    seen = drawn(LOCAL, 0).points
    for change in (bump, lifted, lambda points: 1000.0 * points):
        found = judged(change(seen))
        assert (found.flagged, found.p_value < 0.01) == (True, True)
        assert re.match(r"The model does not explain the observation \(p.*: .*near s = ", found.verdict)
        assert ("above the prediction" in found.verdict) or change is not lifted


def p_values(name, t, number):
    """Return p-values of right models with inputs from the prior; of eight points, three inputs fit a large part."""
    found, box = [], space(0.03)
    for seed in range(number):
        truth = box.to_physical(np.random.default_rng([seed, 3]).uniform(0.2, 0.8, 3))
        one = judged(drawn(LOCAL, seed, t, truth), truth=truth, width=0.03, seed=seed, effort=LEAST)
        found.append(getattr(one, name))
    return np.array(found, float)


@pytest.mark.repeats
def test_inputs_that_act_only_together_raise_no_false_alarm(monkeypatch):
    """The residuals tell their ratio alone. Planted: their derivatives count as two directions."""
    box = ParameterSpace((Parameter("E", Uniform(0.7, 3.0)), Parameter("q", Uniform(0.6, 1.4))))

    def bent(x, t=NODES):
        E, q = x.T[:, :, None]
        return np.stack(np.broadcast_arrays(t, 0.03 * q / E * t**2 * (6 - 4 * t + t**2)), axis=2)

    def separately(waves, by_inputs, model):
        weighed = model.solved(by_inputs.T)
        return waves - by_inputs @ np.linalg.lstsq(weighed @ by_inputs, weighed @ waves, rcond=None)[0]

    def smooth_p(seed):
        random = np.random.default_rng([seed, 5])
        truth = box.to_physical(random.uniform(0.3, 0.7, (1, 2)))
        seen = LOCAL.draw(Interface.polyline(bent(truth)[0]), random)
        draws = truth * random.uniform(0.9, 1.1, (100, 1))
        about = Posterior(box, draws, np.full(100, -np.log(100.0)), np.zeros(100), box.log_prior(draws), 0.0)
        model = Prediction(
            {"": Interface.polyline(bent(truth)[0])},
            lambda x: {"": bent(x)},
            lambda x, least: {"": bent(truth)[:0]},
            "the model itself",
        )
        found = misfit_of(model, (Observation(seen, LOCAL),), NormalOffset(), about, effort=LEAST, seed=seed)
        return found.smooth_p

    assert stats.kstest([smooth_p(seed) for seed in range(20)], "uniform").pvalue > 0.005
    monkeypatch.setattr(fits, "beyond", separately)
    assert stats.kstest([smooth_p(seed) for seed in range(20)], "uniform").pvalue < 0.005


@pytest.mark.repeats
def test_p_values_of_right_models_are_uniform(monkeypatch):
    """Of all residuals and of their waves. Planted: drawn observations are not fitted; the inputs' part is left in."""

    def unfitted(residuals, fit, *others):
        return drawn_statistics(residuals, replace(fit, by_inputs=fit.by_inputs[:, :0]), *others)

    rows = (("p_value", FEW, 30), "drawn_statistics", unfitted), (("smooth_p", INNER, 80), "beyond", lambda w, *_: w)
    for given, function, planted in rows:
        assert stats.kstest(p_values(*given), "uniform").pvalue > 0.005
        with monkeypatch.context() as patch:
            patch.setattr(fits, function, planted)
            assert stats.kstest(p_values(*given), "uniform").pvalue < 0.005


def test_a_smooth_error_too_small_for_the_sum_of_squares_is_flagged_by_its_waves():
    """Half a bump: among 301 points a sum over all of them does not see it."""
    found = judged(bump(drawn(LOCAL, 0, MANY).points, 1.5))
    assert found.smooth_p < 0.0025 < found.p_value
    assert found.flagged


def test_a_variance_of_the_measure_stands_for_errors_of_the_points():
    """White noise of all coordinates, as a study draws it; planted: a bump."""
    for measure in (NormalOffset(), TrackedPoints(), ClosestPoint(), Currents(0.1, quadrature="centre")):
        exact = outline(NODES if isinstance(measure, TrackedPoints) else np.linspace(0.0, 1.0, len(INNER)))
        own = isinstance(measure, NormalOffset | TrackedPoints)
        variance = S**2 if own else noise_variance(measure, exact, LOCAL, len(NODES))
        noisy = exact.points + S * np.random.default_rng(0).standard_normal(exact.points.shape)
        right, wrong = (judged(points, variance, measure=measure) for points in (noisy, bump(bump(noisy))))
        assert (right.flagged, wrong.flagged) == (False, True), measure
        assert right.conditions[0].stated.errors.sd == pytest.approx(S, rel=0.25)


def test_cameras_that_stay_where_they_are_have_one_shift():
    """Planted: one picture shifted up, the other down."""
    errors, names = PointErrors(S, shift=0.02, shared=True), ("a", "b")
    for sides in ((1.0, 1.0), (1.0, -1.0)):
        shifted = [drawn(LOCAL, k).points + np.array([0.0, 10 * S * side]) for k, side in enumerate(sides)]
        seen = [Observation(Interface.polyline(one), errors, name) for one, name in zip(shifted, names, strict=True)]
        found = misfit_of(predicted(names), seen, NormalOffset(), posterior(), effort=LESS, seed=1)
        assert found.flagged is (sides[1] < 0)


def test_what_could_not_be_computed_is_none_and_no_p_value_of_a_good_fit(monkeypatch):
    def failing(*_, **__):
        raise ArithmeticError("singular")

    monkeypatch.setattr(assess_fit, "predictive_shares", failing)
    found = judged(outline())
    assert (found.flagged, found.predictive_p, found.conditions[0].predictive_p) == (False, None, None)
    assert "could not be computed: singular" in " ".join(found.notes)
    monkeypatch.setattr(fits, "best_fit", failing)
    assert (judged(outline()).flagged, judged(outline()).p_value) == (None, None)


def test_errors_that_were_stated_or_that_the_surrogate_reports_are_no_misfit_and_others_are():
    """Planted: a shift that nobody stated; ℓ left out. Noise that was overstated is said."""
    seen = lifted(drawn(LOCAL, 3).points)
    assert not judged(seen, replace(LOCAL, shift=0.02)).flagged
    correlated = PointErrors(S, 0.1)
    seen = drawn(correlated, 5, MANY).points
    assert not judged(seen, correlated).flagged
    assert judged(seen).flagged
    found = judged(outline())
    assert (found.flagged, found.predictive_p) == (False, 1.0)
    assert "smaller than the noise leads one to expect" in found.verdict
    seen = bump(bump(drawn(LOCAL, 2).points))

    def uncertain(x, least):
        points = arches(x[None])
        return {"": points + 2 * (bump(points[0]) - points[0])}

    assert judged(seen).flagged
    assert not judged(seen, prediction=replace(predicted(), uncertain=uncertain)).flagged


def test_parts_of_the_arc_cover_it_the_bump_is_found_where_it_is_and_p_values_are_corrected_as_holm_does():
    np.testing.assert_allclose(corrected(np.array([0.04, 0.01, 0.5, 0.03])), [0.09, 0.04, 0.5, 0.09])
    peak = 8 * S * np.exp(-0.5 * ((MANY - 0.75) / 0.04) ** 2)
    found = judged(drawn(LOCAL, 4, MANY).points + peak[:, None] * [0, 1], effort=FULL)
    (one,) = found.conditions
    ends = np.array([(region.begin, region.end) for region in one.regions])
    np.testing.assert_array_equal(ends[1:, 0], ends[:-1, 1])
    worst = min(one.regions, key=lambda region: (region.p_value, -region.excess))
    assert worst.begin <= float(one.arc_length[int(np.argmin(np.abs(MANY - 0.75)))]) <= worst.end
    assert found.region_p == worst.p_value < 0.01
    assert verdict_on(0.5, 0.5, 0.5, found.conditions, run_alone=False).flagged, "by a part alone"


FLAT, ROUGH, UP = sheet(9), PointErrors(0.005, 0.1), np.array([0.0, 0.0, 1.0])


def on_surface(change=0.0, *, seed=2, effort=LEAST):
    """Return the misfit of a sheet that rises by 0.1 and is moved by a change along z, with correlated errors."""
    box, rise = ParameterSpace((Parameter("rise", Uniform(0.0, 0.2)),)), np.sin(np.pi * FLAT.points[:, :1]) * UP
    draws = np.linspace(0.09, 0.11, 50)[:, None]
    known = Posterior(box, draws, np.full(50, -np.log(50.0)), np.zeros(50), box.log_prior(draws), 0.0)
    points, nothing = (lambda x: {"": FLAT.points + x[:, :1, None] * rise}), {"": FLAT.points[None][:0]}
    prediction = Prediction({"": FLAT}, points, lambda x, least: nothing, "the model itself")
    seen = ROUGH.draw(Interface(FLAT.points + 0.1 * rise, FLAT.cells), np.random.default_rng(seed))
    seen = Interface(seen.points + np.reshape(change, (-1, 1)) * UP, FLAT.cells)
    return misfit_of(prediction, (Observation(seen, ROUGH),), NormalOffset(), known, effort=effort, seed=seed)


def test_a_wrong_surface_is_flagged_and_its_patch_is_named():
    """Planted: a bump outwards over a few errors of the points, near one corner."""
    off = np.linalg.norm(FLAT.points[:, :2] - (0.8, 0.2), axis=1)
    found = on_surface(0.03 * np.exp(-0.5 * (off / 0.12) ** 2), effort=replace(FULL, predictive=2))
    assert found.flagged
    worst = min(found.conditions[0].regions, key=lambda region: (region.p_value, -region.excess))
    assert np.linalg.norm(np.array(worst.centre[:2]) - (0.8, 0.2)) < 0.25
    assert (worst.side, worst.p_value < 0.01) == ("outside", True)
    assert re.search(r"mm the observed surface lies \S+ µm outside the prediction", found.verdict)


def test_right_surfaces_are_not_flagged():
    """The p-values of all residuals and of the patches' means are those of the noise."""
    found = [on_surface(seed=seed) for seed in range(16)]
    assert sum(one.flagged for one in found) <= 1
    assert stats.kstest([one.p_value for one in found], "uniform").pvalue > 0.005
    assert np.mean([one.region_p < 0.05 for one in found]) < 0.2


@pytest.mark.parametrize("closed", [False, True])
def test_a_field_is_learnt_from_the_best_runs_or_the_best_run_stands_alone(closed):
    """One closed run among the others: then there is no field."""
    x = space(0.003).to_physical(np.random.default_rng(1).random((40, 3)))
    lines = [Interface.polyline(points, closed=closed and k == 39) for k, points in enumerate(arches(x))]
    records = [RunRecord(str(k), space(0.003).as_mapping(x[k]), "ok", {"": one}) for k, one in enumerate(lines)]
    values, seen = -1e4 * ((x - TRUTH) ** 2).sum(axis=1), drawn(LOCAL, 1)
    prediction = by_runs(x, records, values, space(0.003), (Observation(seen, LOCAL),), NormalOffset())
    assert prediction.run_alone == closed
    found, misfit = prediction.points(x[:3])[""], judged(lifted(seen.points), prediction=prediction)
    assert misfit.flagged is not closed
    assert ("no surrogate could be built" in misfit.verdict) == closed
    if closed:
        np.testing.assert_array_equal(found[0], lines[int(np.argmax(values))].points)
    else:
        np.testing.assert_allclose(found, arches(x[:3]), atol=0.1 * S)
        assert not judged(seen, prediction=prediction).flagged


def test_what_cannot_be_computed_and_errors_that_leave_no_residual_are_said():
    """No errors of points have a noise variance of a measure that is the same for all interfaces."""
    found = judged(drawn(LOCAL, 0), 1e-4, measure=lambda simulated, observed: 0.0)
    assert (found.flagged, found.p_value) == (None, None)
    assert "was not computed: noise of function" in found.verdict
    text = assess_fit.invisible([Observation(outline(), LOCAL)], ["E", "nu"], ("V_in",))
    assert text.startswith("Residuals cannot reveal an error that E or nu can compensate for: a wrong value of V_in, ")
    assert "picture scale" in text
    assert "picture scale" not in assess_fit.invisible([Observation(outline(), PointErrors(S, scale=0.01))], ["E"], ())


def test_what_was_removed_or_allowed_for_is_said_and_is_that_of_the_observation():
    shift = (0.004, -0.006)
    found = judged(drawn(LOCAL, 1).points + shift, replace(LOCAL, shift=0.02), width=1e-4, effort=LEAST)
    np.testing.assert_allclose(found.conditions[0].removed["shift"], shift, atol=0.0015)
    assert any(re.match(r"The most probable shift \(\S+, \S+\) µm was removed", note) for note in found.notes)
    for size, said in ((0.01 * S, "The model"), (S, "With an error of the model allowed for, the")):
        found = judged(drawn(LOCAL, 1), explained=np.full((len(INNER), 1), size), effort=LEAST)
        assert found.verdict.startswith(said)
