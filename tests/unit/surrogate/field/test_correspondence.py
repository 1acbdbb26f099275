"""Interfaces of all runs over common points."""

import numpy as np
import pytest
import shapely
from tests.discrepancy.surfaces import divided, sheet

from strandline.errors import InvalidInterface
from strandline.interface import Interface
from strandline.surrogate.field.correspondence import FEWEST_POINTS, common_layout, fields_of, registered


def arc(nodes: int, *, height: float = 0.3, seed: int | None = None) -> Interface:
    """Return an arc through unevenly spaced nodes."""
    s = np.linspace(0.0, 1.0, nodes)
    if seed is not None:
        s[1:-1] = np.sort(np.random.default_rng(seed).uniform(0.0, 1.0, nodes - 2))
    return Interface.polyline(np.stack([s, height * np.sin(np.pi * s)], axis=1))


def ring(nodes: int, *, start: float = 0.0, stretch: float = 1.0) -> Interface:
    angle = start + np.linspace(0.0, 2 * np.pi, nodes, endpoint=False)
    return Interface.polyline(np.stack([stretch * np.cos(angle), np.sin(angle)], axis=1), closed=True)


def test_nodes_that_correspond_are_taken_as_they_are() -> None:
    runs = [arc(20), arc(20, height=0.5)]
    layout = common_layout(runs)
    assert layout.way == "nodes"
    points, error = registered(runs[1], layout)
    np.testing.assert_array_equal(points, runs[1].points)
    assert error == 0.0
    assert layout.weights.sum() == pytest.approx(1.0)
    with pytest.raises(InvalidInterface, match="a different number of points"):
        registered(arc(21), layout)


def test_the_error_of_common_points_is_the_root_mean_square_distance_of_the_nodes() -> None:
    runs = [arc(60, seed=1), arc(90, seed=2)]
    layout = common_layout(runs)
    for run in runs:
        points, error = registered(run, layout)
        distances = shapely.distance(shapely.points(run.points), shapely.LineString(points))
        assert error == pytest.approx(np.sqrt(np.mean(distances**2)))


def test_weights_are_shares_of_the_length() -> None:
    layout = common_layout([Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [4.0, 0.0]]))])
    np.testing.assert_allclose(layout.weights, [1 / 8, 1 / 2, 3 / 8])


def test_weights_of_a_surface_are_shares_of_the_area() -> None:
    surface = sheet(5)
    weights = common_layout([surface]).weights
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ surface.points[:, 0] == pytest.approx(0.5)


def test_polylines_of_other_nodes_are_taken_by_arclength() -> None:
    runs = [arc(60, seed=1), arc(90, seed=2), arc(75, seed=3).reversed()]
    layout = common_layout(runs)
    assert layout.way == "arclength"
    assert len(layout.template.points) == 90
    taken = [registered(run, layout) for run in runs]
    for points, error in taken:
        np.testing.assert_allclose(points, taken[0][0], atol=5e-3)
        np.testing.assert_allclose(points[:, 1], 0.3 * np.sin(np.pi * points[:, 0]), atol=2e-3)
        assert 0 < error < 1e-3
    fields, worst = fields_of([{"": run} for run in runs], {"": layout})
    np.testing.assert_array_equal(fields, [points.ravel() for points, _ in taken])
    assert worst == max(error for _, error in taken)


def test_few_points_become_enough() -> None:
    assert len(common_layout([arc(4), arc(5)]).template.points) == FEWEST_POINTS


def test_the_registration_error_is_that_of_cut_corners() -> None:
    """A corner that falls between two points at distance h is cut off; its node is the only one that moves."""
    corner = Interface.polyline(np.array([[0.0, 0.0], [0.503, 0.0], [0.503, 1.0]]))
    layout = common_layout([arc(4), corner])
    points, error = registered(corner, layout)
    cut = Interface.polyline(points)
    a, d = cut.starts, cut.ends - cut.starts
    share = np.clip(np.sum((corner.points[1] - a) * d, axis=1) / np.sum(d * d, axis=1), 0, 1)
    distance = np.min(np.linalg.norm(a + share[:, None] * d - corner.points[1], axis=1))
    assert distance > 1e-3
    assert error == pytest.approx(distance / np.sqrt(3.0))


def test_closed_polylines_may_begin_anywhere_and_run_either_way() -> None:
    runs = [ring(80), ring(97, start=2.1), ring(97, start=1.0).reversed()]
    layout = common_layout(runs)
    first, _ = registered(runs[0], layout)
    for run in runs[1:]:
        points, error = registered(run, layout)
        assert np.abs(points - first).max() < 2 * np.pi / 97 + 1e-3  # the first nodes differ by half a segment
        assert error < 2e-3


def test_surfaces_of_other_triangles_are_projected() -> None:
    surface = sheet(5)
    assert common_layout([surface, sheet(5, height=0.1)]).way == "nodes"
    layout = common_layout([surface, divided(surface)])
    assert layout.way == "projection"
    assert layout.weights.sum() == pytest.approx(1.0)


def test_open_and_closed_ones_together_are_refused() -> None:
    with pytest.raises(InvalidInterface, match="open polylines in some runs"):
        common_layout([arc(30), ring(30)])
    layout = common_layout([arc(30), arc(40)])
    with pytest.raises(InvalidInterface, match="open or closed where the others are not"):
        registered(ring(30), layout)
