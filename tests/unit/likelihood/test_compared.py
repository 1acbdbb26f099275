"""How observations are compared under stated errors of their points: against dense Gaussian densities."""

from dataclasses import replace

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
from strandline.interface import GaussianNoise, Interface, Noise, Observation, PointErrors
from strandline.likelihood import InterfaceLikelihood, compared
from strandline.likelihood.joint_errors import JointErrors
from strandline.likelihood.registered import Registered
from strandline.likelihood.shared_errors import shared_errors

SMALL = PointErrors(3e-6, 0.02, shift=1e-5, rotation=5e-4, scale=5e-6, offset=2e-6)
"""So small that the residuals are linear in the global errors."""
ERRORS = PointErrors(0.003, 0.02, shift=0.01, rotation=0.5, scale=0.005, offset=0.002)
HEIGHTS = {"low": 0.2, "high": 0.35}


def arch(height: float = 0.3, nodes: int = 61) -> Interface:
    x = np.linspace(0.0, 1.0, nodes)
    return Interface.polyline(np.stack([x, 4 * height * x * (1 - x)], axis=1))


def drawn(height: float, errors: PointErrors, seed: int, nodes: int = 90) -> Interface:
    """Return an outline without its ends, which could slide over those of the simulated one."""
    whole = Interface.polyline(arch(height, nodes).points[nodes // 18 : -(nodes // 18)])
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
    size, first = sum(map(len, blocks)), 0
    C = np.zeros((size, size))
    for block in blocks:
        C[first : first + len(block), first : first + len(block)] = block
        first += len(block)
    B = np.concatenate(shared)
    return C + B @ B.T


def test_with_its_constant_the_likelihood_is_the_density_of_the_residuals() -> None:
    """Of one observation, and of two by a camera that stays where it is: they share their errors."""
    shared, local = replace(SMALL, shared=True), PointErrors(SMALL.sd, SMALL.length)
    one = [Observation(drawn(0.3, SMALL, 1), SMALL)]
    two = [Observation(drawn(height, local, k), shared, name) for k, (name, height) in enumerate(HEIGHTS.items())]
    for seen, heights in ((one, {"": 0.3}), (two, HEIGHTS)):
        likelihood = InterfaceLikelihood(tuple(seen), NormalOffset())
        simulated = {name: arch(1.00001 * height, 90) for name, height in heights.items()}
        residuals = np.concatenate([signed_distances(o.interface.points, simulated[o.condition]) for o in seen])
        expected = multivariate_normal(np.zeros(len(residuals)), dense(seen)).logpdf(residuals)
        assert likelihood.constant is not None
        assert likelihood(simulated) + likelihood.constant == pytest.approx(expected, abs=0.05)
        assert likelihood.unit == "1"


def test_many_together_are_as_one_by_one() -> None:
    errors = replace(ERRORS, shared=True)
    seen = [Observation(drawn(height, ERRORS, k), errors, name) for k, (name, height) in enumerate(HEIGHTS.items())]
    both = shared_errors(seen, NormalOffset())
    assert both is not None
    shapes = np.random.default_rng(2).normal(1.0, 0.02, size=12)
    points = {name: np.stack([arch(height * f).points for f in shapes]) for name, height in HEIGHTS.items()}
    templates = {name: arch(height) for name, height in HEIGHTS.items()}
    each = [both.square({name: arch(height * f) for name, height in HEIGHTS.items()}) for f in shapes]
    np.testing.assert_allclose(both.many(points, templates), each, rtol=1e-9)

    one = compared(Observation(drawn(0.3, ERRORS, 4), ERRORS), ClosestPoint(direction="to_simulated"), 61)
    assert isinstance(one.measure, Registered)
    rows = np.stack([arch(height).points for height in np.linspace(0.28, 0.32, 6)])
    each = [one.measure(Interface(row, arch().cells), one.observation.interface) for row in rows]
    np.testing.assert_allclose(one.measure.many(rows, arch(), one.observation.interface), each, rtol=1e-9)


def test_other_observations_are_compared_one_by_one() -> None:
    pairs: list[tuple[Noise, Noise]] = [
        (ERRORS, ERRORS),
        (GaussianNoise(1e-4), GaussianNoise(1e-4)),
        (PointErrors(0.003, shift=0.01, shared=True), PointErrors(0.003, shift=0.02, shared=True)),
    ]
    for noises in pairs:
        seen = [Observation(arch(h), noise, name) for noise, (name, h) in zip(noises, HEIGHTS.items(), strict=True)]
        assert shared_errors(seen, NormalOffset()) is None
        assert shared_errors(seen[:1], NormalOffset()) is None


def test_each_measure_gets_its_own_variance() -> None:
    """Lines also take steady directions where the points have errors, unless the user chose them."""
    errors, measure = PointErrors(0.003, 0.02), ClosestPoint(direction="to_simulated")
    one = compared(Observation(arch(), errors), measure, 61)
    assert one.noise == GaussianNoise(measure.noise_variance(errors, arch()))
    assert compared(Observation(arch(), 1e-4), TrackedPoints(), 61).noise == GaussianNoise(1e-4)
    seen, noisy = arch(0.3, 200), PointErrors(0.004)
    one = compared(Observation(noisy.draw(seen, np.random.default_rng(5)), noisy), MeasurementLines(20), 61)
    assert one.measure == MeasurementLines(20, smooth=20 * 0.004, trim=0.05)
    assert 0.5 * noisy.sd**2 < one.noise.scale < noisy.sd**2
    chosen = MeasurementLines(20, smooth=0.05, trim=0.1)
    assert compared(Observation(seen, noisy), chosen, 61).measure == chosen
    assert compared(Observation(seen, 1e-4), MeasurementLines(20), 61).measure == MeasurementLines(20)


def test_global_errors_of_any_measure_are_integrated_out() -> None:
    """Against the measure whose residuals are those of the points, which needs no differences; ends are not seen."""
    errors = PointErrors(0.003, 0.0, shift=0.004, rotation=0.3, scale=0.003, offset=0.002)
    part = Interface.polyline(arch(0.3, 90).points[8:-8])
    seen = Observation(errors.draw(part, np.random.default_rng(3)), errors)
    by_measure = InterfaceLikelihood((seen,), ClosestPoint(direction="to_simulated"))
    exact = InterfaceLikelihood((seen,), NormalOffset())
    found, expected = (np.array([one(arch(h)) for h in (0.296, 0.3, 0.303)]) for one in (by_measure, exact))
    np.testing.assert_allclose(found - found[1], expected - expected[1], atol=0.15)


@pytest.mark.parametrize("measure", [MeasurementLines(30), Currents(0.1)])
def test_global_errors_are_followed_to_the_most_probable_ones(measure: Discrepancy) -> None:
    """Against a minimisation over the five of them that needs no derivatives."""
    seen = Observation(drawn(0.3, ERRORS, 6, 45), ERRORS)
    one, simulated = compared(seen, measure, 31), arch(0.31, 31)
    assert isinstance(one.measure, Registered)
    nodes, middle = simulated.points[None], seen.interface.points.mean(axis=0)

    def f(g: np.ndarray) -> float:
        moved = Interface(ERRORS.followed(nodes, simulated, g[None], middle=middle)[0], simulated.cells)
        return one.measure.measure(moved, seen.interface) / one.measure.variance + float(g @ g)

    least = minimize(f, np.zeros(5), method="Powell", options={"xtol": 3e-2, "ftol": 1e-4}).fun
    assert one.measure(simulated, seen.interface) == pytest.approx(least, abs=0.2 + 0.01 * least)
    heights = (0.05, 0.1, 0.15, 0.2, 0.5)
    if isinstance(measure, MeasurementLines):  # outlines far away do not look near
        values = [one.measure(arch(height, 31), one.observation.interface) for height in heights]
        assert min(values) > 0.99 * values[3] > 500


def test_each_of_several_observations_takes_its_own_part_of_all_global_errors() -> None:
    """Two shifts and a rotation of the first observation, two shifts of the second, in standard deviations."""
    turned, shifted = PointErrors(0.001, 0.01, shift=0.01, rotation=2.0), PointErrors(0.001, 0.01, shift=0.02)
    by = np.array([0.3, -0.2, 0.5, -0.7, 0.4])
    seen = Observation(arch(0.2), turned, "slow"), Observation(arch(0.4), shifted, "fast")
    joint = JointErrors(seen, (turned, shifted))
    assert joint.sizes(by) == (turned.sizes(by[:3], 2), shifted.sizes(by[3:], 2))
    templates = {"slow": arch(0.25), "fast": arch(0.35)}
    points = {name: one.points[None] for name, one in templates.items()}
    found = joint.followed(points, templates, by[None])
    for one, errors, part in ((seen[0], turned, slice(0, 3)), (seen[1], shifted, slice(3, 5))):
        name, middle = one.condition, one.interface.points.mean(axis=0)
        alone = errors.followed(points[name], templates[name], by[None, part], middle=middle)
        np.testing.assert_array_equal(found[name], alone)
    moved = found["fast"] - points["fast"]
    assert np.linalg.norm(moved, axis=2) == pytest.approx(0.02 * np.hypot(0.7, 0.4))


def test_what_cannot_be_compared_is_refused() -> None:
    """A correlation longer than half the interface; interfaces in opposite directions, unless no error is global."""
    for measure in (NormalOffset(), ClosestPoint()):
        with pytest.raises(InvalidInput, match="half the length"):
            InterfaceLikelihood((Observation(arch(), PointErrors(0.003, 5.0)),), measure)(arch(0.31))
    seen = Observation(drawn(0.3, ERRORS, 4), ERRORS)
    with pytest.raises(InvalidInterface, match="opposite sides"):
        InterfaceLikelihood((seen,), NormalOffset())(arch().reversed())
    shared = PointErrors(0.003, shift=0.01, shared=True)
    both = shared_errors([Observation(seen.interface, shared, name) for name in "ab"], NormalOffset())
    assert both is not None
    with pytest.raises(InvalidInterface, match="opposite sides"):
        both.square({"a": arch(), "b": arch().reversed()})
    alone = InterfaceLikelihood((Observation(seen.interface, PointErrors(0.003)),), NormalOffset())
    assert alone(arch(0.31)) == pytest.approx(alone(arch(0.31).reversed()))
