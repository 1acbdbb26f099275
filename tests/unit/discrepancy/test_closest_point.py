"""Oracles: shapely's distances, weights in closed form, convergence."""

import numpy as np
import pytest
import shapely
from tests.unit.discrepancy.curves import graph, level, ring
from tests.unit.discrepancy.surfaces import sheet, sphere

from strandline.discrepancy import ClosestPoint
from strandline.discrepancy.closest_point import DIRECTIONS, WEIGHTINGS
from strandline.foundations import InvalidInterface
from strandline.interface import Interface, PointErrors

MEAN = ClosestPoint(direction="to_simulated", weighting="length")


def wavy(nodes: int, seed: int, *, shift: float = 0.0, closed: bool = False) -> Interface:
    """Return a wave with nodes at random places."""
    x = np.sort(np.random.default_rng(seed).uniform(0.0, 2.0, nodes))
    return graph(x, shift + 0.3 * np.sin(3 * x), closed=closed)


@pytest.mark.parametrize("closed", [False, True])
def test_sums_against_shapely(closed):
    curve = shapely.LinearRing if closed else shapely.LineString
    for seed in range(3):
        simulated, observed = wavy(66, seed, shift=0.1 * seed, closed=closed), wavy(40, seed + 1, closed=closed)
        there = np.sum(shapely.distance(shapely.points(simulated.points), curve(observed.points)) ** 2)
        back = np.sum(shapely.distance(shapely.points(observed.points), curve(simulated.points)) ** 2)
        found = [ClosestPoint(direction=one)(simulated, observed) for one in DIRECTIONS]
        assert found == pytest.approx([there, back, 0.5 * (there + back)], rel=1e-12)


def test_weighting_converges_to_the_mean_square_with_order_two():
    """A line at an angle: mean square 1/12. A sheet δ = 0.3 sin(5x) cos(4y) over a plane: fine midpoint quadrature."""

    def tilted(nodes):
        x = np.linspace(0.0, 1.0, nodes) ** 1.5
        return graph(x, 0.5 * x)

    x, y = np.meshgrid(*2 * [(np.arange(1000) + 0.5) / 1000], indexing="ij")
    height, slope = 0.3 * np.sin(5 * x) * np.cos(4 * y), (1.5 * np.cos(5 * x) * np.cos(4 * y)) ** 2
    area = np.sqrt(1 + slope + (1.2 * np.sin(5 * x) * np.sin(4 * y)) ** 2)
    measure = ClosestPoint(weighting="length")
    lines = [measure(tilted(n), level(0.0, 3)) - 1 / 12 for n in (33, 65, 129)]
    sheets = [measure(sheet(n, bend=0.3), sheet(2)) - (area * height**2).sum() / area.sum() for n in (33, 65, 129)]
    for errors in np.abs([lines, sheets]):
        assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)


def test_terms_are_told_only_where_the_observation_fixes_them():
    observed = wavy(40, 2)
    assert ClosestPoint(direction="to_simulated").terms(observed) == 40
    assert ClosestPoint().terms(observed) is MEAN.terms(observed) is None
    with pytest.raises(InvalidInterface, match="coordinates"):
        MEAN(sheet(2), observed)


def test_what_offsets_amount_to_is_the_measure_of_the_moved_interface():
    """The observed points are twice as dense on one half, and fewer than the simulated nodes."""
    x = np.concatenate([np.linspace(0.0, 1.0, 40, endpoint=False), np.linspace(1.0, 2.0, 81)])
    observed, fine, sizes = graph(x, 0 * x), np.linspace(0.0, 2.0, 501), (1e-3, -2e-3)

    def offset(x, size):
        return size * (1 + np.sin(2 * x)) * x

    moved = [graph(fine, offset(fine, size)) for size in sizes]
    for measure in (ClosestPoint(direction=d, weighting=w) for d in DIRECTIONS for w in WEIGHTINGS):
        found = measure.of_offsets(np.array([offset(x, size) for size in sizes]), observed, len(fine))
        np.testing.assert_allclose(found, [measure(one, observed) for one in moved], rtol=0.02)


def test_noise_variance_of_a_mean_is_that_of_its_independent_points():
    """A mean of n squared distances moves the inputs as one point with a variance of s²/n would; by area on a ball."""
    errors, ball = PointErrors(0.01), sphere(1.0, 3)
    assert MEAN.noise_variance(errors, ring(200)) == pytest.approx(0.01**2 / 200, rel=1e-3)
    total = ClosestPoint(direction="to_simulated")
    assert total.noise_variance(errors, ring(200)) == pytest.approx(0.01**2, rel=1e-3)
    assert ClosestPoint(weighting="length").noise_variance(errors, ring(200)) is None
    share = np.bincount(ball.cells.ravel(), np.repeat(ball.sizes, 3)) / (3 * ball.sizes.sum())
    assert MEAN.noise_variance(errors, ball) == pytest.approx(0.01**2 * (share**2).sum(), rel=1e-9)
