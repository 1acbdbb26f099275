"""Oracles: shapely's distances, parallel lines and circles in closed form, convergence."""

import numpy as np
import pytest
import shapely
from tests.discrepancy.surfaces import sheet

from strandline.discrepancy import ClosestPoint, closest_point
from strandline.discrepancy.search.nearest import squared_distances
from strandline.errors import InvalidInput, InvalidInterface
from strandline.interface import Interface, PointErrors


def wavy(nodes: int, seed: int) -> Interface:
    x = np.sort(np.random.default_rng(seed).uniform(0.0, 2.0, nodes))
    return Interface.polyline(np.stack([x, 0.1 * seed + 0.3 * np.sin(3 * x)], axis=1))


def level(y: float, nodes: int, *, length: float = 1.0) -> Interface:
    x = np.linspace(0.0, length, nodes)
    return Interface.polyline(np.stack([x, 0 * x + y], axis=1))


@pytest.mark.parametrize("seed", range(5))
def test_sums_against_shapely(seed):
    simulated, observed = wavy(66, seed), wavy(40, seed + 1)
    there = shapely.distance(shapely.points(simulated.points), shapely.LineString(observed.points))
    back = shapely.distance(shapely.points(observed.points), shapely.LineString(simulated.points))
    assert ClosestPoint()(simulated, observed) == pytest.approx(np.sum(there**2), rel=1e-12)
    assert ClosestPoint(direction="to_simulated")(simulated, observed) == pytest.approx(np.sum(back**2), rel=1e-12)
    both = 0.5 * (np.sum(there**2) + np.sum(back**2))
    assert ClosestPoint(direction="symmetric")(simulated, observed) == pytest.approx(both, rel=1e-12)


def test_projects_onto_segments_not_onto_nodes():
    simulated = Interface.polyline(np.array([[0.5, 0.1], [0.6, 0.1]]))
    assert ClosestPoint()(simulated, level(0.0, 2)) == pytest.approx(2 * 0.1**2)


def test_closed_target_includes_its_last_segment():
    square = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), closed=True)
    points = np.array([[-0.1, 0.5], [0.1, 0.4]])
    assert squared_distances(points, square) == pytest.approx([0.01, 0.01])


@pytest.mark.parametrize("nodes", [2, 5, 66])
def test_length_weighting_is_the_mean_square_and_the_sum_grows_with_the_nodes(nodes):
    simulated, observed = level(0.1, nodes), level(0.0, 11)
    assert ClosestPoint(weighting="length")(simulated, observed) == pytest.approx(0.1**2)
    assert ClosestPoint()(simulated, observed) == pytest.approx(nodes * 0.1**2)


def test_length_weighting_converges_to_the_mean_square_with_order_two():
    """A line at an angle: δ = x/2 on 0 ≤ x ≤ 1, mean square 1/12."""

    def tilted(nodes):
        x = np.linspace(0.0, 1.0, nodes) ** 1.5
        return Interface.polyline(np.stack([x, 0.5 * x], axis=1))

    values = [ClosestPoint(weighting="length")(tilted(n), level(0.0, 3)) for n in (33, 65, 129)]
    errors = np.abs(np.array(values) - 1 / 12)
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)


def test_concentric_rings():
    """Outer nodes project onto inner nodes; inner nodes, turned by half a segment, onto the middle of outer edges."""
    angle = 2 * np.pi * np.arange(32) / 32
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    half = np.stack([np.cos(angle + np.pi / 32), np.sin(angle + np.pi / 32)], axis=1)
    outer = Interface.polyline(1.3 * ring, closed=True)
    inner, turned = Interface.polyline(ring, closed=True), Interface.polyline(half, closed=True)
    onto_edges = 32 * (1.3 * np.cos(np.pi / 32) - 1) ** 2
    assert ClosestPoint()(outer, inner) == pytest.approx(32 * 0.3**2, rel=1e-12)
    assert ClosestPoint(direction="to_simulated")(outer, turned) == pytest.approx(onto_edges, rel=1e-12)


def test_node_weights_add_up_to_the_length():
    for interface in (wavy(30, 2), Interface.polyline(wavy(30, 2).points, closed=True)):
        assert closest_point.node_weights(interface).sum() == pytest.approx(interface.lengths.sum())
    assert closest_point.node_weights(level(0.0, 3)) == pytest.approx([0.25, 0.5, 0.25])


@pytest.mark.parametrize("direction", ["to_observed", "to_simulated", "symmetric"])
def test_parallel_sheets(direction):
    upper, lower = sheet(5, height=0.2), sheet(5)
    assert ClosestPoint(direction=direction)(upper, lower) == pytest.approx(25 * 0.2**2)
    assert ClosestPoint(direction=direction, weighting="length")(upper, lower) == pytest.approx(0.2**2)


def test_area_weighting_converges_to_the_mean_square_with_order_two():
    """A sheet over a plane: δ² = 0.09 sin²(5x) cos²(4y), weighted by area, against fine midpoint quadrature."""
    x, y = np.meshgrid(*2 * [(np.arange(2000) + 0.5) / 2000], indexing="ij")
    height, slope = 0.3 * np.sin(5 * x) * np.cos(4 * y), (1.5 * np.cos(5 * x) * np.cos(4 * y)) ** 2
    area = np.sqrt(1 + slope + (1.2 * np.sin(5 * x) * np.sin(4 * y)) ** 2)
    exact = (area * height**2).sum() / area.sum()
    plane, measure = sheet(2), ClosestPoint(weighting="length")
    errors = np.array([abs(measure(sheet(n, bend=0.3), plane) - exact) for n in (33, 65, 129)])
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)


def test_node_weights_of_a_surface_add_up_to_its_area():
    surface = sheet(6, bend=0.2, seed=1)
    assert closest_point.node_weights(surface).sum() == pytest.approx(surface.areas.sum())
    assert closest_point.node_weights(sheet(2)) == pytest.approx([1 / 3, 1 / 6, 1 / 6, 1 / 3])


def test_orientation_does_not_matter_and_a_polyline_is_no_surface():
    upper, lower = sheet(5, height=0.2), sheet(5)
    assert ClosestPoint()(upper, lower.reversed()) == ClosestPoint()(upper, lower)
    with pytest.raises(InvalidInterface, match="coordinates"):
        ClosestPoint()(upper, level(0.0, 3))


def test_terms_are_told_only_where_the_observation_fixes_them():
    observed = wavy(40, 2)
    assert ClosestPoint(direction="to_simulated").terms(observed) == 40
    assert ClosestPoint().terms(observed) is None
    assert ClosestPoint(direction="to_simulated", weighting="length").terms(observed) is None


@pytest.mark.parametrize("options", [{"direction": "sideways"}, {"weighting": "area"}])
def test_invalid_options(options):
    with pytest.raises(InvalidInput, match=f"{next(iter(options))} of the closest point"):
        ClosestPoint(**options)


def test_unit():
    assert ClosestPoint().unit == "mm²"


@pytest.mark.parametrize("weighting", ["sum", "length"])
@pytest.mark.parametrize("direction", ["to_observed", "to_simulated", "symmetric"])
def test_what_offsets_amount_to_is_the_measure_of_the_moved_interface(direction: str, weighting: str) -> None:
    """The observed points are twice as dense on one half, and fewer than the simulated nodes."""
    x = np.concatenate([np.linspace(0.0, 1.0, 40, endpoint=False), np.linspace(1.0, 2.0, 81)])
    observed = Interface.polyline(np.stack([x, 0 * x], axis=1))

    def offset(x: np.ndarray, size: float) -> np.ndarray:
        return np.asarray(size * (1 + np.sin(2 * x)) * x)

    fine = np.linspace(0.0, 2.0, 501)
    measure = ClosestPoint(direction=direction, weighting=weighting)
    sizes = 1e-3, -2e-3
    moved = [Interface.polyline(np.stack([fine, offset(fine, size)], axis=1)) for size in sizes]
    found = measure.of_offsets(np.array([offset(x, size) for size in sizes]), observed, len(fine))
    np.testing.assert_allclose(found, [measure(one, observed) for one in moved], rtol=0.02)


def test_noise_variance_of_a_mean_is_that_of_its_independent_points() -> None:
    """A mean of n squared distances moves the inputs as one point with a variance of s²/n would."""
    angle = np.linspace(0.0, 2 * np.pi, 200, endpoint=False)
    ring = Interface.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)
    errors = PointErrors(0.01)
    mean, total = (ClosestPoint(direction="to_simulated", weighting=one) for one in ("length", "sum"))
    assert mean.noise_variance(errors, ring) == pytest.approx(0.01**2 / 200, rel=1e-3)
    assert total.noise_variance(errors, ring) == pytest.approx(0.01**2, rel=1e-3)
    assert ClosestPoint(weighting="length").noise_variance(errors, ring) is None
