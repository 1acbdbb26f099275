"""Polylines and surfaces: refusals, geometry in closed form, orientation, self-crossings against shapely."""

import math

import numpy as np
import pytest
import shapely
from tests.unit.discrepancy.curves import graph, line
from tests.unit.discrepancy.surfaces import divided, sheet, sphere, turned

from strandline.foundations import InvalidInput, InvalidInterface
from strandline.interface import Interface, Observation, UnknownErrors, is_condition, oriented_like, triangles

ZIGZAG = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
CORNERS = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 3.0]])
FOLDED = [[0, 1, 2], [1, 3, 2]]


def test_geometry_in_closed_form():
    zigzag, square, surface = line(*ZIGZAG), line(*SQUARE, closed=True), Interface(CORNERS, np.array(FOLDED))
    assert [(one.dim, one.closed) for one in (zigzag, square, surface)] == [(2, False), (2, True), (3, False)]
    assert zigzag.centres.tolist() == [[1.5, 2.0], [3.0, 4.5]]
    assert zigzag.normals.tolist() == [[-4.0, 3.0], [-1.0, 0.0]]
    assert square.lengths.tolist() == [1.0] * 4
    assert surface.sizes.tolist() == surface.areas.tolist() == pytest.approx([4.5, 4.5 * math.sqrt(3)])
    assert surface.normals.tolist() == [[0.0, 0.0, 4.5], [-4.5, -4.5, -4.5]]
    assert np.array_equal(zigzag.reversed().normals, -zigzag.normals[::-1])
    assert np.array_equal(surface.reversed().normals, -surface.normals)
    for one in (zigzag, square, surface):
        twice = one.reversed().reversed()
        assert one.reversed().closed == one.closed
        assert np.array_equal(twice.points[twice.cells], one.points[one.cells])


def test_area_and_volume_of_a_sphere_converge_with_order_two_wherever_it_lies():
    balls = [turned(sphere(2.0, k), k) for k in (2, 3, 4)]
    areas = np.array([ball.areas.sum() for ball in balls]) - 16 * math.pi
    volumes = np.array([triangles.signed_volume(ball.points, ball.cells) for ball in balls]) - 32 / 3 * math.pi
    for errors in (areas, volumes):
        assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)


def test_names_of_conditions():
    assert all(is_condition(name) for name in ("", "slow", "day 3", "100 mm²_s", "v=0.5", "x" * 64))
    assert not any(is_condition(name) for name in (None, 3, "a/b", "a\\b", " slow", "slow\n", "a\0b", "x" * 65))


def test_what_is_no_polyline_is_refused():
    for points, closed, found in (
        ([[1.0, 2.0]], False, "too few points"),
        ([[0.0, 0.0], [1.0, math.nan]], False, "point 2 of the interface is not finite"),
        ([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [2.0, 0.0]], False, "segment 2 of the interface has no length"),
        ([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], True, "segment 4 of the interface has no length"),
    ):
        with pytest.raises(InvalidInterface, match=found):
            Interface.polyline(np.array(points), closed=closed)
    for cells in ([[0, 1], [1, 3]], [[0, 1], [2, 1]]):
        with pytest.raises(InvalidInterface, match="nodes of the cells"):
            Interface(ZIGZAG, np.array(cells))
    with pytest.raises(InvalidInput, match="noise variance"):
        Observation(line(*ZIGZAG), math.nan)


@pytest.mark.stand_in
def test_points_alone_are_no_observation():
    with pytest.raises(InvalidInput, match=r"interface of an observation: .*expected an Interface"):
        Observation(ZIGZAG, 1e-5)


def test_what_is_no_surface_is_refused():
    straight, pair = np.array([[0, 0, 0], [0.1, 0.3, 0.7], [0.3, 0.9, 2.1], [0, 1, 0]]), [[0, 1, 3], [0, 1, 2]]
    for points, cells in (
        (straight + 50.0, pair),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 1]]),
    ):
        with pytest.raises(InvalidInterface, match="triangle 2 of the interface has no area"):
            Interface(np.array(points, float), np.array(cells))
    sliver = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1e-9, 0.0]])
    assert Interface(sliver, np.array([[0, 1, 2]])).areas == pytest.approx([0.5e-9])
    with pytest.raises(InvalidInterface, match="point 4 of the surface belongs to no triangle"):
        Interface(CORNERS, np.array([[0, 1, 2]]))


def test_resampling_is_equally_spaced_on_the_polyline_and_keeps_the_ends():
    fine = line(*ZIGZAG).resampled(7)
    assert fine.points == pytest.approx(np.array([[0.6 * k, 0.8 * k] for k in range(6)] + [[3.0, 5.0]]))
    assert line(*SQUARE, closed=True).resampled(8).lengths == pytest.approx([0.5] * 8)


def spiral(nodes):
    angle = np.linspace(0.0, 1.9 * np.pi, nodes)
    return graph(np.cos(angle), np.sin(angle))


POLYLINES = (SQUARE, SQUARE + 50.0, spiral(30).points, ZIGZAG)
FACING = {
    "open": [Interface.polyline(points) for points in POLYLINES],
    "closed": [Interface.polyline(points, closed=True) for points in POLYLINES],
    "surfaces": [sheet(9, bend=0.3, seed=1), sphere(0.7, 2)],
}


@pytest.mark.parametrize("references", FACING.values(), ids=FACING)
def test_orientation_is_found_and_repaired(references):
    """The other one is jittered; a surface has other triangles, too, and is moved by a tenth of its extent."""
    for reference in references:
        other, shift, noise = (divided(reference), 0.1, 0.01) if reference.dim == 3 else (reference, 0.0, 0.02)
        jitter = noise * np.random.default_rng(1).normal(size=other.points.shape)
        observed = Interface(other.points + shift + jitter, other.cells)
        assert not observed.runs_against(reference)
        assert not reference.runs_against(observed)
        assert observed.reversed().runs_against(reference)
        kept, flipped = oriented_like(observed, reference)
        assert (kept is observed, flipped) == (True, False)
        back = oriented_like(observed.reversed(), reference)
        assert back.flipped
        assert np.array_equal(back.interface.points, observed.points)
        assert np.array_equal(back.interface.cells, observed.cells)


def test_orientation_survives_a_chord_that_turns():
    """Nearly closed: the ends move past each other, the chords point opposite ways, the curve runs on as before."""
    wide, narrow = spiral(40), spiral(40)
    narrow.points[-1], wide.points[-1] = [1.02, 0.01], [0.98, -0.01]
    assert np.dot(wide.points[-1] - wide.points[0], narrow.points[-1] - narrow.points[0]) < 0
    assert not wide.runs_against(narrow)
    assert wide.runs_against(narrow.reversed())


def test_closed_surfaces_are_compared_by_volume_wherever_they_lie():
    """Two balls far apart: the nearest triangles of each face each other, and yet they are oriented alike."""
    one = sphere(1.0, 2)
    other = Interface(one.points + np.array([10.0, 0.0, 0.0]), one.cells)
    assert not one.runs_against(other)
    assert one.runs_against(other.reversed())
    flipped = one.cells.copy()
    flipped[3] = flipped[3, ::-1]
    assert one.closed
    assert not Interface(one.points, flipped).closed


CROSSINGS = {
    "returning to a node": ([(1, 0), (2, 1), (0, 1), (1, 0), (1, -1)], False, "1 and 3"),
    "collinear overlap": ([(0, 0), (3, 0), (3, 1), (4, 0), (1, 0)], False, "1 and 4"),
    "end on a slanted segment": ([(0, 0), (1, 1), (3, 3), (4, 3), (2, 2)], False, "2 and 4"),
    "slanted fold-back": ([(0, 0), (1, 1), (4, 4), (2, 2), (5, 2)], False, "2 and 3"),
    "closed, straight across the joint": ([(1, 0), (2, 0), (2, 1), (0, 0)], True, ""),
    "closed, fold-back at the joint": ([(1, 0), (2, 0), (2, 1), (3, 1), (3, 0)], True, "5 and 1"),
    "hairpin": ([(0, 0), (1, 0), (1, 1e-9), (0, 1e-9)], False, ""),
}


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0])
def test_self_crossings(angle):
    """Also turned by an angle, where touching is a matter of rounding."""
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    for points, closed, segments in CROSSINGS.values():
        interface = Interface.polyline(np.array(points, float) @ turn, closed=closed)
        if not segments:
            interface.require_simple()
            continue
        with pytest.raises(InvalidInterface, match="crosses itself") as caught:
            interface.require_simple()
        assert caught.value.what.endswith(f"segments {segments}")
    with pytest.raises(InvalidInterface, match=r"\(1.5, 0\) mm"):
        line((0, 0), (2, 0), (2, 1), (1, -1)).require_simple()


@pytest.mark.parametrize("closed", [False, True])
def test_self_crossings_of_random_walks_against_shapely(closed):
    rng, verdicts = np.random.default_rng(5), []
    for _ in range(150):
        points = rng.normal(size=(rng.integers(3, 9), 2)).cumsum(axis=0)
        verdicts.append((shapely.LinearRing if closed else shapely.LineString)(points).is_simple)
        assert (Interface.polyline(points, closed=closed)._first_crossing() is None) == verdicts[-1]
    assert 15 < sum(verdicts) < 135


def test_unknown_errors_are_not_inferred_on_a_surface():
    with pytest.raises(InvalidInput, match="got unknown"):
        UnknownErrors().require_fits(sphere(1.0, 1))
