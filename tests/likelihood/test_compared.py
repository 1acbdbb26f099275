"""How observations are compared under stated errors of their points: against dense Gaussian densities."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from strandline.discrepancy import (
    ClosestPoint,
    Currents,
    Discrepancy,
    MeasurementLines,
    NormalOffset,
    TrackedPoints,
    signed_distances,
)
from strandline.errors import InvalidInput, InvalidInterface
from strandline.interface import GaussianNoise, Interface, Observation, PointErrors
from strandline.likelihood import InterfaceLikelihood, compared
from strandline.likelihood.registered import Registered
from strandline.likelihood.shared_errors import shared_errors

SMALL = PointErrors(3e-6, 0.02, shift=1e-5, rotation=5e-4, scale=5e-6, offset=2e-6)
"""So small that the residuals are linear in the global errors."""
ERRORS = PointErrors(0.003, 0.02, shift=0.01, rotation=0.5, scale=0.005, offset=0.002)


def arch(height: float = 0.3, nodes: int = 61) -> Interface:
    x = np.linspace(0.0, 1.0, nodes)
    return Interface.polyline(np.stack([x, 4 * height * x * (1 - x)], axis=1))


def drawn(height: float, errors: PointErrors, seed: int) -> Interface:
    """Return an outline without its ends, which could slide over those of the simulated one."""
    whole = Interface.polyline(arch(height, 90).points[5:-5])
    return errors.draw(whole, np.random.default_rng(seed))


def dense(observations: list[Observation]) -> np.ndarray:
    """Return the covariance of all residuals, one observation after the other, without Woodbury's identity."""
    middle = np.concatenate([o.interface.points for o in observations]).mean(axis=0)
    blocks, shared = [], []
    for o in observations:
        errors = o.noise
        assert isinstance(errors, PointErrors)
        own = PointErrors(errors.sd, errors.length, offset=errors.offset).model(o.interface)
        blocks.append(np.diag(own.local) + own.shared @ own.shared.T)
        rest = PointErrors(errors.sd, errors.length, errors.shift, errors.rotation, errors.scale)
        shared.append(rest.model(o.interface, middle=middle).shared)
    size, C, first = sum(map(len, blocks)), np.zeros((1, 1)), 0
    C = np.zeros((size, size))
    for block in blocks:
        C[first : first + len(block), first : first + len(block)] = block
        first += len(block)
    B = np.concatenate(shared)
    return C + B @ B.T


def test_with_its_constant_the_likelihood_is_the_density_of_the_residuals() -> None:
    seen = Observation(drawn(0.3, SMALL, 1), SMALL)
    likelihood = InterfaceLikelihood((seen,), NormalOffset())
    residuals = signed_distances(seen.interface.points, arch(0.30001, 90))
    expected = multivariate_normal(np.zeros(len(residuals)), dense([seen])).logpdf(residuals)
    constant = likelihood.constant
    assert constant is not None
    assert likelihood(arch(0.30001, 90)) + constant == pytest.approx(expected, abs=0.05)
    assert likelihood.unit == "1"


def test_pictures_of_a_fixed_camera_share_their_errors() -> None:
    errors = PointErrors(**{**vars(SMALL), "shared": True})
    local = PointErrors(SMALL.sd, SMALL.length)
    seen = [Observation(drawn(height, local, k), errors, name) for k, (name, height) in enumerate(HEIGHTS.items())]
    likelihood = InterfaceLikelihood(tuple(seen), NormalOffset())
    interfaces = {name: arch(1.00001 * height, 90) for name, height in HEIGHTS.items()}
    residuals = np.concatenate([signed_distances(o.interface.points, interfaces[o.condition]) for o in seen])
    expected = multivariate_normal(np.zeros(len(residuals)), dense(seen)).logpdf(residuals)
    constant = likelihood.constant
    assert constant is not None
    assert likelihood(interfaces) + constant == pytest.approx(expected, abs=0.05)


HEIGHTS = {"low": 0.2, "high": 0.35}


def test_many_together_are_as_one_by_one() -> None:
    errors = PointErrors(**{**vars(ERRORS), "shared": True})
    seen = [Observation(drawn(height, ERRORS, k), errors, name) for k, (name, height) in enumerate(HEIGHTS.items())]
    both = shared_errors(seen, NormalOffset())
    assert both is not None
    shapes = np.random.default_rng(2).normal(1.0, 0.02, size=40)
    points = {name: np.stack([arch(height * f).points for f in shapes]) for name, height in HEIGHTS.items()}
    templates = {name: arch(height) for name, height in HEIGHTS.items()}
    each = [both.square({name: arch(height * f) for name, height in HEIGHTS.items()}) for f in shapes]
    np.testing.assert_allclose(both.many(points, templates), each, rtol=1e-9)
    few = {name: rows[:3] for name, rows in points.items()}
    np.testing.assert_allclose(both.many(few, templates), each[:3], rtol=1e-9)


@pytest.mark.parametrize(
    "noises",
    [
        (ERRORS, ERRORS),
        (GaussianNoise(1e-4), GaussianNoise(1e-4)),
        (PointErrors(0.003, shift=0.01, shared=True), PointErrors(0.003, shift=0.02, shared=True)),
    ],
)
def test_other_observations_are_compared_one_by_one(noises: tuple[PointErrors, PointErrors]) -> None:
    seen = [Observation(arch(h), noise, name) for noise, (name, h) in zip(noises, HEIGHTS.items(), strict=True)]
    assert shared_errors(seen, NormalOffset()) is None
    assert shared_errors(seen[:1], NormalOffset()) is None


def test_each_measure_gets_its_own_variance() -> None:
    seen = Observation(arch(), PointErrors(0.003, 0.02))
    one = compared(seen, ClosestPoint(direction="to_simulated"), 61)
    expected = ClosestPoint(direction="to_simulated").noise_variance(PointErrors(0.003, 0.02), arch())
    assert one.noise == GaussianNoise(expected)
    assert compared(Observation(arch(), 1e-4), TrackedPoints(), 61).noise == GaussianNoise(1e-4)


def test_lines_take_steady_directions_where_the_points_have_errors() -> None:
    seen, noisy = arch(0.3, 200), PointErrors(0.004)
    one = compared(Observation(noisy.draw(seen, np.random.default_rng(5)), noisy), MeasurementLines(20), 61)
    assert one.measure == MeasurementLines(20, smooth=20 * 0.004, trim=0.05)
    assert 0.5 * noisy.sd**2 < one.noise.scale < noisy.sd**2
    chosen = MeasurementLines(20, smooth=0.05, trim=0.1)
    assert compared(Observation(seen, noisy), chosen, 61).measure == chosen
    assert compared(Observation(seen, 1e-4), MeasurementLines(20), 61).measure == MeasurementLines(20)


def test_a_correlation_longer_than_the_interface_is_refused_for_every_measure() -> None:
    seen = Observation(arch(), PointErrors(0.003, 5.0))
    for measure in (NormalOffset(), ClosestPoint()):
        with pytest.raises(InvalidInput, match="half the length"):
            InterfaceLikelihood((seen,), measure)(arch(0.31))


def test_global_errors_of_any_measure_are_integrated_out() -> None:
    """Against the measure whose residuals are those of the points, which needs no differences; ends are not seen."""
    errors = PointErrors(0.003, 0.0, shift=0.004, rotation=0.3, scale=0.003, offset=0.002)
    part = Interface.polyline(arch(0.3, 90).points[8:-8])
    seen = Observation(errors.draw(part, np.random.default_rng(3)), errors)
    by_measure = InterfaceLikelihood((seen,), ClosestPoint(direction="to_simulated"))
    exact = InterfaceLikelihood((seen,), NormalOffset())
    heights = [0.296, 0.3, 0.303]
    found, expected = (np.array([one(arch(h)) for h in heights]) for one in (by_measure, exact))
    np.testing.assert_allclose(found - found[1], expected - expected[1], atol=0.15)


def test_many_with_global_errors_are_as_one_by_one() -> None:
    one = compared(Observation(drawn(0.3, ERRORS, 4), ERRORS), ClosestPoint(direction="to_simulated"), 61)
    assert isinstance(one.measure, Registered)
    points = np.stack([arch(height).points for height in np.linspace(0.28, 0.32, 20)])
    each = [one.measure(Interface(row, arch().cells), one.observation.interface) for row in points]
    np.testing.assert_allclose(one.measure.many(points, arch(), one.observation.interface), each, rtol=1e-9)


@pytest.mark.parametrize("measure", [MeasurementLines(30), Currents(0.1)])
def test_global_errors_are_followed_to_the_most_probable_ones(measure: Discrepancy) -> None:
    """Against a minimisation over the five of them that needs no derivatives."""
    seen = Observation(drawn(0.3, ERRORS, 6), ERRORS)
    one = compared(seen, measure, 61)
    assert isinstance(one.measure, Registered)
    for height in (0.3, 0.31):
        nodes, middle = arch(height).points[None], seen.interface.points.mean(axis=0)

        def f(g: np.ndarray, nodes: np.ndarray = nodes, middle: np.ndarray = middle) -> float:
            moved = Interface(ERRORS.followed(nodes, arch(), g[None], middle=middle)[0], arch().cells)
            return one.measure.measure(moved, seen.interface) / one.measure.variance + float(g @ g)

        least = minimize(f, np.zeros(5), method="Powell", options={"xtol": 1e-3, "ftol": 1e-6}).fun
        assert one.measure(arch(height), seen.interface) == pytest.approx(least, abs=0.2 + 0.01 * least)


@pytest.mark.parametrize("measure", [MeasurementLines(30), ClosestPoint(direction="to_simulated")])
def test_outlines_far_away_do_not_look_near(measure: Discrepancy) -> None:
    one = compared(Observation(drawn(0.3, ERRORS, 7), ERRORS), measure, 61)
    heights = (0.05, 0.1, 0.15, 0.2, 0.5)
    values = [one.measure(arch(height), one.observation.interface) for height in heights]
    assert min(values) > 0.99 * one.measure(arch(0.2), one.observation.interface) > 500


def test_global_errors_need_interfaces_in_the_same_direction() -> None:
    seen = Observation(drawn(0.3, ERRORS, 4), ERRORS)
    with pytest.raises(InvalidInterface, match="opposite sides"):
        InterfaceLikelihood((seen,), NormalOffset())(arch().reversed())
    shared = Observation(seen.interface, PointErrors(0.003, shift=0.01, shared=True), "a")
    both = shared_errors([shared, Observation(seen.interface, shared.noise, "b")], NormalOffset())
    assert both is not None
    with pytest.raises(InvalidInterface, match="opposite sides"):
        both.square({"a": arch(), "b": arch().reversed()})
    alone = Observation(seen.interface, PointErrors(0.003))
    values = [InterfaceLikelihood((alone,), NormalOffset())(one) for one in (arch(0.31), arch(0.31).reversed())]
    assert values[0] == pytest.approx(values[1])
