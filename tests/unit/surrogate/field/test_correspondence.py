"""Interfaces of all runs over common points."""

import numpy as np
import pytest
import shapely
from tests.unit.discrepancy.surfaces import divided, sheet

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


def test_weights_are_shares_of_the_length_or_the_area() -> None:
    layout = common_layout([Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [4.0, 0.0]]))])
    np.testing.assert_allclose(layout.weights, [1 / 8, 1 / 2, 3 / 8])
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
    for run, (points, error) in zip(runs, taken, strict=True):
        distances = shapely.distance(shapely.points(run.points), shapely.LineString(points))
        assert error == pytest.approx(np.sqrt(np.mean(distances**2)))
        np.testing.assert_allclose(points, taken[0][0], atol=5e-3)
        np.testing.assert_allclose(points[:, 1], 0.3 * np.sin(np.pi * points[:, 0]), atol=2e-3)
        assert 0 < error < 1e-3
    fields, worst = fields_of([{"": run} for run in runs], {"": layout})
    np.testing.assert_array_equal(fields, [points.ravel() for points, _ in taken])
    assert worst == max(error for _, error in taken)
    assert len(common_layout([arc(4), arc(5)]).template.points) == FEWEST_POINTS


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


def test_interfaces_of_other_kinds_are_refused() -> None:
    for together, words in [
        ([arc(30), ring(30)], "open polylines in some runs"),
        ([sheet(4), arc(30)], "polylines in some runs, surfaces in others"),
    ]:
        with pytest.raises(InvalidInterface, match=words):
            common_layout(together)
    for together, other, words in [
        ([arc(30), arc(40)], ring(30), "open or closed where the others are not"),
        ([arc(20)], arc(21), "a different number of points"),
        ([sheet(4), sheet(5)], arc(30), "a polyline where the others are surfaces"),
    ]:
        with pytest.raises(InvalidInterface, match=words):
            registered(other, common_layout(together))
