"""Oracles: every cell by projections, closed forms, and the same bits as brute force."""

from itertools import combinations

import numpy as np
import pytest
from tests.unit.discrepancy.curves import graph, line, ring
from tests.unit.discrepancy.surfaces import sheet, sphere, turned

from strandline.discrepancy import nearest
from strandline.discrepancy.nearest import BLOCK, SMALL, brute_force, by_tree, closest_points, squared_distances
from strandline.foundations import InvalidInterface
from strandline.interface import Interface


def by_projections(p: np.ndarray, corners: np.ndarray) -> float:
    """Return the distance of a triangle by projections onto its plane, sides and corners: the least one inside."""
    found = []
    for first, *others in (some for number in (1, 2, 3) for some in combinations(corners, number)):
        edges = np.array([other - first for other in others]).reshape(-1, 3).T
        share = np.linalg.lstsq(edges, p - first)[0]
        if (share >= 0).all() and share.sum() <= 1:
            found.append(np.linalg.norm(p - first - edges @ share))
    return min(found)


def soup(number: int, seed: int, *, spread: float) -> Interface:
    """Return unconnected triangles whose sizes differ by the factor exp(±spread), some of them slivers."""
    rng = np.random.default_rng(seed)
    size = np.exp(rng.uniform(-spread, spread, (number, 1, 1)))
    corners = rng.normal(size=(number, 1, 3)) + 0.1 * size * rng.normal(size=(number, 3, 3))
    thin = rng.random(number) < 0.2
    corners[thin, 2] = corners[thin, :2].mean(axis=1) + 1e-7 * (corners[thin, 2] - corners[thin, 0])
    return Interface(corners.reshape(-1, 3), np.arange(3 * number).reshape(-1, 3))


def wave(number: int, seed: int, *, closed: bool = False) -> Interface:
    """Return a polyline of very short and very long segments."""
    steps = np.exp(np.random.default_rng(seed).uniform(-6.0, 0.0, number))
    x = np.cumsum(steps) / steps.sum()
    return graph(x, 0.3 * np.sin(9 * x), closed=closed)


def around(target: Interface, number: int, seed: int) -> np.ndarray:
    """Return points near and far, on corners, on the middles of sides, in centres, and close to all of those."""
    rng = np.random.default_rng(seed)
    cells = target.cells[rng.integers(0, len(target.cells), number)]
    corners = target.points[cells]
    on = np.concatenate([corners[:, 0], corners[:, :2].mean(axis=1), corners.mean(axis=1)])
    scale = np.exp(rng.uniform(-25.0, 5.0, (len(on), 1)))
    return np.concatenate([on, on + scale * rng.normal(size=on.shape)])


def is_exact(found, points, target) -> bool:
    """Tell whether all is as by trying every cell, to the last bit."""
    expected = brute_force(points, target)
    return all(np.array_equal(getattr(found, one), getattr(expected, one)) for one in ("squares", "cells", "points"))


def test_the_tree_gives_what_trying_every_cell_gives_to_the_last_bit():
    curves, surfaces = (wave(300, 6), wave(300, 7, closed=True)), (sheet(25, bend=0.3, seed=2), sphere(0.6, 3))
    for target in (*curves, *surfaces, soup(300, 8, spread=1.0), soup(300, 9, spread=6.0)):
        points = around(target, 20, 0)
        assert len(points) * len(target.cells) > SMALL
        assert is_exact(closest_points(points, target), points, target)


def test_an_interface_that_is_searched_once_gets_no_tree(monkeypatch):
    target = wave(100, seed=2)
    points = around(target, 100, seed=3)
    assert SMALL < len(points) * len(target.cells) < nearest.ONCE
    assert is_exact(by_tree(points, target), points, target)
    monkeypatch.setattr(nearest, "by_tree", lambda *arguments: pytest.fail("searched by a tree"))
    assert is_exact(closest_points(points, target, once=True), points, target)


def test_many_points_and_many_pairs_are_taken_in_blocks():
    """From the middle of a ball every cell is as far; each of very many points is near one of three segments."""
    ball, random = sphere(1.0, 4), np.random.default_rng(1)
    middle = 1e-3 * random.normal(size=(20, 3))
    assert len(middle) * len(ball.cells) > BLOCK
    assert is_exact(closest_points(middle, ball), middle, ball)
    many, short = random.random((BLOCK + 9, 2)), wave(4, 1)
    assert is_exact(by_tree(many, short), many, short)


def test_against_projections_onto_a_triangle_its_sides_and_corners():
    target = soup(30, 8, spread=1.0)
    points = around(target, 8, 3)
    found, corners = closest_points(points, target), target.points[target.cells]
    for p, closest, square in zip(points, found.points, found.squares, strict=True):
        distance = min(by_projections(p, triangle) for triangle in corners)
        assert np.sqrt(square) == pytest.approx(distance, rel=1e-9, abs=1e-9)
        assert np.linalg.norm(p - closest) == pytest.approx(np.sqrt(square), rel=1e-12, abs=1e-12)


def test_distances_in_closed_form():
    """To a plane and beyond its edge; from outside a ball they converge to those of the sphere."""
    points = np.array([[0.3, 0.7, 0.2], [0.31, 0.5, -0.4], [1.3, 0.5, 0.4], [-0.3, -0.4, 0.0]])
    assert np.sqrt(squared_distances(points, sheet(9))) == pytest.approx([0.2, 0.4, 0.5, 0.5])
    directions = np.random.default_rng(5).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    errors = np.array([np.sqrt(squared_distances(1.5 * directions, sphere(1.0, k))) - 0.5 for k in (2, 3, 4)])
    assert (errors > -1e-15).all()
    means = errors.mean(axis=1)
    assert np.log2(means[:-1] / means[1:]) == pytest.approx([2.0, 2.0], abs=0.3)


POLYLINES = {
    "huge and tiny segments": wave(900, 8),
    "twice the same": Interface.polyline(np.tile(ring(450, flat=0.5).points, (2, 1)), closed=True),
    "far from the origin": Interface.polyline(wave(900, 10).points + np.array([3e5, -2e10])),
    "too short": line((1, 0), (0, 1e-150), (0, 2e-150), (-1, 0.5)),
    "one segment": line((0, 0), (1e-3, 2)),
}


@pytest.mark.parametrize("target", POLYLINES.values(), ids=POLYLINES)
def test_the_tree_is_exact_for_odd_polylines_and_for_points_near_and_far(target):
    extent = np.ptp(target.points, axis=0).max()
    offsets = extent * np.random.default_rng(1).normal(size=(300, 2)) * np.geomspace(1e-12, 1e5, 300)[:, None]
    points = np.concatenate([around(target, 150, 0), target.points[:1] + offsets])
    assert is_exact(by_tree(points, target), points, target)


def test_what_is_kept_of_a_target_follows_its_content_and_points_of_another_dimension_are_refused():
    target = sheet(25, bend=0.3, seed=2)
    points = around(target, 20, 9)
    before = squared_distances(points, target)
    target.points[:] += 0.5
    after = squared_distances(points, target)
    assert np.array_equal(after, brute_force(points, target).squares)
    assert not np.array_equal(after, before)
    with pytest.raises(InvalidInterface, match="project"):
        squared_distances(np.zeros((4, 2)), target)


def test_the_margin_for_rounding_grows_with_the_coordinates_whatever_their_sign():
    point = np.array([[1e3, 1e3]])
    below, above = (nearest._Best(sign * point, line((sign * 999, 0), (sign * 1e3, 0))) for sign in (-1, 1))
    assert below.rounding == above.rounding > 0


def test_slivers_are_as_exact_as_other_triangles():
    """Points above a known place of the sliver, turned in space; the closest point is that place."""
    last, heights = np.arange(2, 33), np.linspace(0.0, 0.5, 30)
    fan = np.stack([np.zeros_like(last), last - 1, last], axis=1)
    for altitude, corner in ((a, c) for a in (1e-3, 1e-9, 1e-12) for c in (-3.0, 0.2, 1.0)):
        flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [corner, altitude, 0.0]])
        places = np.random.default_rng(2).dirichlet(np.ones(3), 30) @ flat
        above = Interface(np.concatenate([flat, places + heights[:, None] * [0.0, 0.0, 1.0]]), fan)
        moved = turned(above, 4, shift=0.0).points
        found = squared_distances(moved[3:], Interface(moved[:3], np.array([[0, 1, 2]])))
        assert np.sqrt(found) == pytest.approx(heights, abs=3e-15)
