"""The likelihood of interfaces: conditions add up; stated errors of points against dense Gaussian densities."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import block_diag
from scipy.optimize import minimize
from tests.unit.discrepancy.curves import arch, level

from strandline.discrepancy import (
    ClosestPoint,
    Currents,
    JointErrors,
    MeasurementLines,
    NormalOffset,
    TrackedPoints,
    shared_errors,
)
from strandline.discrepancy.normal_offset import signed_distances
from strandline.foundations import InvalidInput, InvalidInterface, NumericsError
from strandline.interface import GaussianNoise, Interface, Observation, PointErrors, UnknownErrors
from strandline.likelihood import InterfaceLikelihood, compared
from strandline.likelihood.interfaces import Registered

SMALL = PointErrors(3e-6, 0.02, shift=1e-5, rotation=5e-4, scale=5e-6, offset=2e-6)
"""So small that the residuals are linear in the global errors."""
ERRORS = PointErrors(0.003, 0.02, shift=0.01, rotation=0.5, scale=0.005, offset=0.002)
TO_SIMULATED = ClosestPoint(direction="to_simulated")
HEIGHTS = {"low": 0.2, "high": 0.35}


def flat(y: float) -> Interface:
    return level(y, 3)


def test_conditions_add_each_with_its_own_variance():
    observations = (Observation(flat(0.0), 0.01, "slow"), Observation(flat(1.0), 0.04, "fast"))
    likelihood = InterfaceLikelihood(observations, TrackedPoints())
    simulated = {"fast": flat(0.8), "unobserved": flat(9.0), "slow": flat(0.1)}
    assert likelihood.discrepancies(simulated) == pytest.approx([0.03, 0.12])
    assert likelihood(simulated) == pytest.approx(-0.5 * (0.03 / 0.01 + 0.12 / 0.04))
    assert likelihood.conditions == ("slow", "fast")
    assert likelihood.independent_terms == 12  # two coordinates of three points, twice
    assert likelihood.unit == "mm²"
    alone = InterfaceLikelihood(observations[:1], TrackedPoints())
    assert alone({"slow": flat(0.2)}) == alone(flat(0.2)) == pytest.approx(-0.5 * 3 * 0.2**2 / 0.01)
    plain = InterfaceLikelihood(observations[1:], lambda one, seen: 10 * one.points[0, 1] + seen.points[0, 1])
    assert (plain(flat(4.0)), plain.unit) == (pytest.approx(-0.5 * 41.0 / 0.04), "")


def test_the_constant_counts_lines_or_points_and_is_none_where_there_is_no_count():
    observation = (Observation(flat(0.0), 0.01),)
    lines = InterfaceLikelihood(observation, MeasurementLines(4))
    assert lines.constant == pytest.approx(-0.5 * 4 * math.log(2 * math.pi * 0.01))
    for measure in (Currents(0.1), ClosestPoint(), lambda simulated, observed: 0.0):
        assert InterfaceLikelihood(observation, measure).constant is None
        assert InterfaceLikelihood(observation, measure).independent_terms is None
    for noise in (UnknownErrors(), PointErrors(0.003)):  # all of it is inferred, or that of one observation
        seen = Observation(flat(0.0), UnknownErrors(), "slow"), Observation(flat(1.0), noise, "fast")
        assert InterfaceLikelihood(seen, NormalOffset()).constant == pytest.approx(6 * stats.norm.logpdf(0.0))


def test_observations_that_do_not_fit_are_refused():
    plain, slow, fast = (Observation(flat(0.0), 1.0, name) for name in ("", "slow", "fast"))
    for observations, simulated, said in (
        ((slow, fast), {"slow": flat(0.0)}, r"lack condition 'fast'.*got condition 'slow'; expected at least"),
        ((plain,), {"slow": flat(0.0)}, "lack a condition without a name"),
        ((plain, plain), flat(0.0), "2 observations of a condition without a name"),
        ((), flat(0.0), "observations"),
    ):
        with pytest.raises(InvalidInput, match=said):
            InterfaceLikelihood(observations, TrackedPoints())(simulated)


def test_a_measure_that_returns_no_squared_distance_is_told():
    for measure, error, said in (
        (lambda simulated, observed: math.nan, NumericsError, "day 3"),
        (lambda simulated, observed: None, InvalidInput, "TypeError: float.*NoneType.*; expected d², one number"),
        (lambda simulated, observed: simulated.points, InvalidInput, "got a ndarray; expected d², one number"),
    ):
        with pytest.raises(error, match=said):
            InterfaceLikelihood((Observation(flat(0.0), 1.0, "day 3"),), measure)({"day 3": flat(0.1)})


def drawn(height: float, errors: PointErrors, seed: int, nodes: int = 90) -> Interface:
    """Return an outline without its ends, which could slide over those of the simulated one."""
    whole = Interface.polyline(arch(height, nodes).points[nodes // 18 : -(nodes // 18)])
    return errors.draw(whole, np.random.default_rng(seed))


def dense(observations: list[Observation]) -> np.ndarray:
    """Return the covariance of all residuals, one observation after the other, without Woodbury's identity."""
    seen = [(o.noise, o.interface) for o in observations]
    middle = np.concatenate([one.points for _, one in seen]).mean(axis=0)
    own = [PointErrors(e.sd, e.length, offset=e.offset).model(one) for e, one in seen]
    shared = [replace(e, offset=0.0).model(one, middle=middle).shared for e, one in seen]
    B = np.concatenate(shared)
    return block_diag(*(np.diag(one.local) + one.shared @ one.shared.T for one in own)) + B @ B.T


def test_with_its_constant_the_likelihood_is_the_density_of_the_residuals():
    """Of one observation, and of two by a camera that stays where it is: they share their errors."""
    shared, local = replace(SMALL, shared=True), SMALL.local_part
    one = [Observation(drawn(0.3, SMALL, 1), SMALL)]
    two = [Observation(drawn(height, local, k), shared, name) for k, (name, height) in enumerate(HEIGHTS.items())]
    for seen, heights in ((one, {"": 0.3}), (two, HEIGHTS)):
        likelihood = InterfaceLikelihood(tuple(seen), NormalOffset())
        simulated = {name: arch(1.00001 * height, 90) for name, height in heights.items()}
        residuals = np.concatenate([signed_distances(o.interface.points, simulated[o.condition]) for o in seen])
        expected = stats.multivariate_normal(np.zeros(len(residuals)), dense(seen)).logpdf(residuals)
        assert likelihood(simulated) + likelihood.constant == pytest.approx(expected, abs=0.05)
        assert likelihood.unit == "1"


def test_many_together_are_as_one_by_one():
    errors, shapes = replace(ERRORS, shared=True), np.random.default_rng(2).normal(1.0, 0.02, size=12)
    seen = [Observation(drawn(height, ERRORS, k), errors, name) for k, (name, height) in enumerate(HEIGHTS.items())]
    both = shared_errors(seen, NormalOffset())
    points = {name: np.stack([arch(height * f).points for f in shapes]) for name, height in HEIGHTS.items()}
    templates = {name: arch(height) for name, height in HEIGHTS.items()}
    each = [both.square({name: arch(height * f) for name, height in HEIGHTS.items()}) for f in shapes]
    np.testing.assert_allclose(both.many(points, templates), each, rtol=1e-9)
    one = compared(Observation(drawn(0.3, ERRORS, 4), ERRORS), TO_SIMULATED, 61)
    rows = np.stack([arch(height).points for height in np.linspace(0.28, 0.32, 6)])
    each = [one.measure(Interface(row, arch().cells), one.observation.interface) for row in rows]
    np.testing.assert_allclose(one.measure.many(rows, arch(), one.observation.interface), each, rtol=1e-9)


def test_other_observations_are_compared_one_by_one():
    for noises in (
        (ERRORS, ERRORS),
        (GaussianNoise(1e-4), GaussianNoise(1e-4)),
        (PointErrors(0.003, shift=0.01, shared=True), PointErrors(0.003, shift=0.02, shared=True)),
    ):
        seen = [Observation(arch(h), noise, name) for noise, (name, h) in zip(noises, HEIGHTS.items(), strict=True)]
        assert shared_errors(seen, NormalOffset()) is shared_errors(seen[:1], NormalOffset()) is None


def test_each_measure_gets_its_own_variance():
    """Lines also take steady directions where the points have errors, unless the user chose them."""
    errors, noisy, seen = PointErrors(0.003, 0.02), PointErrors(0.004), arch(0.3, 200)
    one = compared(Observation(arch(), errors), TO_SIMULATED, 61)
    assert one.noise == GaussianNoise(TO_SIMULATED.noise_variance(errors, arch()))
    one = compared(Observation(noisy.draw(seen, np.random.default_rng(5)), noisy), MeasurementLines(20), 61)
    assert one.measure == MeasurementLines(20, smooth=20 * 0.004, trim=0.05)
    assert 0.5 * noisy.sd**2 < one.noise.scale < noisy.sd**2
    chosen = MeasurementLines(20, smooth=0.05, trim=0.1)
    assert compared(Observation(seen, noisy), chosen, 61).measure == chosen


def test_global_errors_of_any_measure_are_integrated_out():
    """Against the measure whose residuals are those of the points, which needs no differences; ends are not seen."""
    errors = PointErrors(0.003, 0.0, shift=0.004, rotation=0.3, scale=0.003, offset=0.002)
    part = Interface.polyline(arch(0.3, 90).points[8:-8])
    seen = (Observation(errors.draw(part, np.random.default_rng(3)), errors),)
    both = InterfaceLikelihood(seen, TO_SIMULATED), InterfaceLikelihood(seen, NormalOffset())
    found, expected = (np.array([one(arch(h)) for h in (0.296, 0.3, 0.303)]) for one in both)
    np.testing.assert_allclose(found - found[1], expected - expected[1], atol=0.15)


def test_each_of_several_observations_takes_its_own_part_of_all_global_errors():
    """Two shifts and a rotation of the first observation, two shifts of the second, in standard deviations."""
    errors = PointErrors(0.001, 0.01, shift=0.01, rotation=2.0), PointErrors(0.001, 0.01, shift=0.02)
    seen = Observation(arch(0.2), errors[0], "slow"), Observation(arch(0.4), errors[1], "fast")
    by, templates = np.array([[0.3, -0.2, 0.5, -0.7, 0.4]]), {"slow": arch(0.25), "fast": arch(0.35)}
    points = {name: one.points[None] for name, one in templates.items()}
    found, middle = JointErrors(seen, errors).followed(points, templates, by), arch(0.2).points.mean(axis=0)
    alone = errors[0].followed(points["slow"], templates["slow"], by[:, :3], middle=middle)
    np.testing.assert_array_equal(found["slow"], alone)
    assert np.linalg.norm(found["fast"] - points["fast"], axis=2) == pytest.approx(0.02 * np.hypot(0.7, 0.4))


def test_what_cannot_be_compared_is_refused():
    """A correlation longer than half the interface; interfaces in opposite directions."""
    with pytest.raises(InvalidInput, match="half the length"):
        InterfaceLikelihood((Observation(arch(), PointErrors(0.003, 5.0)),), ClosestPoint())(arch(0.31))
    seen, shared = drawn(0.3, ERRORS, 4), PointErrors(0.003, shift=0.01, shared=True)
    with pytest.raises(InvalidInterface, match="opposite sides"):
        InterfaceLikelihood((Observation(seen, ERRORS),), NormalOffset())(arch().reversed())
    both = shared_errors([Observation(seen, shared, name) for name in "ab"], NormalOffset())
    with pytest.raises(InvalidInterface, match="opposite sides"):
        both.square({"a": arch(), "b": arch().reversed()})


@pytest.mark.parametrize("measure", [MeasurementLines(30), Currents(0.1)])
def test_global_errors_are_followed_to_the_most_probable_ones(measure):
    """Against a minimisation over the five of them that needs no derivatives; outlines far away do not look near."""
    seen = Observation(drawn(0.3, ERRORS, 6, 45), ERRORS)
    one, simulated = compared(seen, measure, 31), arch(0.31, 31)
    assert isinstance(one.measure, Registered)
    nodes, middle = simulated.points[None], seen.interface.points.mean(axis=0)

    def f(g):
        moved = Interface(ERRORS.followed(nodes, simulated, g[None], middle=middle)[0], simulated.cells)
        return one.measure.measure(moved, seen.interface) / one.measure.variance + float(g @ g)

    least = minimize(f, np.zeros(5), method="Powell", options={"xtol": 3e-2, "ftol": 1e-4}).fun
    assert one.measure(simulated, seen.interface) == pytest.approx(least, abs=0.2 + 0.01 * least)
    if isinstance(measure, MeasurementLines):
        values = [one.measure(arch(height, 31), one.observation.interface) for height in (0.05, 0.1, 0.15, 0.2, 0.5)]
        assert min(values) > 0.99 * values[3] > 500
