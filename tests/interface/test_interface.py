"""Interfaces: refusals, geometry in closed form, self-crossings against shapely."""

import math

import numpy as np
import pytest
import shapely

from strandline.errors import InvalidInput, InvalidInterface
from strandline.interface import Interface, Observation, is_condition, oriented_like

ZIGZAG = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def chain(*points, closed=False):
    return Interface.polyline(np.array(points, float), closed=closed)


def test_geometry_of_an_open_polyline():
    zigzag = Interface.polyline(ZIGZAG)
    assert zigzag.dim == 2
    assert not zigzag.closed
    assert zigzag.lengths.tolist() == [5.0, 1.0]
    assert zigzag.centres.tolist() == [[1.5, 2.0], [3.0, 4.5]]
    assert zigzag.normals.tolist() == [[-4.0, 3.0], [-1.0, 0.0]]


def test_names_of_conditions():
    assert all(is_condition(name) for name in ("", "slow", "day 3", "100 mm²_s", "v=0.5", "x" * 64))
    assert not any(is_condition(name) for name in (None, 3, "a/b", "a\\b", " slow", "slow\n", "a\0b", "x" * 65))


def test_geometry_of_a_closed_polyline():
    square = Interface.polyline(SQUARE, closed=True)
    assert square.closed
    assert square.lengths.tolist() == [1.0] * 4
    assert square.normals.sum(axis=0).tolist() == [0.0, 0.0]


def test_reversing_twice_changes_nothing_and_once_turns_the_normals():
    for closed in (False, True):
        square = Interface.polyline(SQUARE, closed=closed)
        assert np.array_equal(square.reversed().reversed().points, square.points)
        assert square.reversed().closed == closed
    assert np.array_equal(Interface.polyline(ZIGZAG).reversed().normals, -Interface.polyline(ZIGZAG).normals[::-1])


@pytest.mark.parametrize(
    ("points", "found"),
    [
        ([[1.0, 2.0]], "too few points"),
        ([[0.0, 0.0], [math.nan, 1.0]], "point 1 of the interface is not finite"),
        ([[math.inf, 0.0], [0.0, 1.0]], "point 0 of the interface is not finite"),
        ([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [2.0, 0.0]], "segment 1 of the interface has no length"),
    ],
)
def test_refuses_what_is_no_polyline(points, found):
    with pytest.raises(InvalidInterface, match=found):
        chain(*points)


def test_refuses_no_point_at_all():
    with pytest.raises(InvalidInterface, match="too few points"):
        Interface.polyline(np.zeros((0, 2)))


def test_refuses_a_closed_polyline_that_repeats_its_first_point():
    with pytest.raises(InvalidInterface, match="segment 3 of the interface has no length"):
        chain((0, 0), (1, 0), (0, 1), (0, 0), closed=True)


@pytest.mark.parametrize("cells", [[[0, 1], [1, 3]], [[0, 1], [1, -1]], [[0, 1], [2, 1]]])
def test_refuses_cells_that_are_no_chain(cells):
    with pytest.raises(InvalidInterface, match="nodes of the cells"):
        Interface(ZIGZAG, np.array(cells))


def test_accepts_triangles_in_space():
    corners = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [3.0, 3.0, 0.0]])
    surface = Interface(corners, np.array([[0, 1, 2], [3, 2, 1]]))
    assert surface.dim == 3
    assert surface.centres.tolist() == [[1.0, 1.0, 0.0], [2.0, 2.0, 0.0]]


def test_resampling_is_equally_spaced_on_the_polyline_and_keeps_the_ends():
    fine = Interface.polyline(ZIGZAG).resampled(7)
    assert fine.points == pytest.approx(np.array([[0.6 * k, 0.8 * k] for k in range(6)] + [[3.0, 5.0]]))


def test_resampling_a_closed_polyline_keeps_it_closed():
    square = Interface.polyline(SQUARE, closed=True).resampled(8)
    assert square.closed
    assert square.lengths == pytest.approx([0.5] * 8)
    assert square.points[0].tolist() == [0.0, 0.0]


def spiral(nodes):
    angle = np.linspace(0.0, 1.9 * np.pi, nodes)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("points", [SQUARE, SQUARE + 50.0, spiral(30), ZIGZAG])
def test_orientation_is_found_and_repaired(points, closed):
    reference = Interface.polyline(points, closed=closed)
    wiggle = 0.02 * np.random.default_rng(1).normal(size=points.shape)
    observed = Interface.polyline(points + wiggle, closed=closed)
    assert not observed.runs_against(reference)
    assert observed.reversed().runs_against(reference)
    kept, flipped = oriented_like(observed, reference)
    assert kept is observed
    assert not flipped
    turned = oriented_like(observed.reversed(), reference)
    assert turned.flipped
    assert np.array_equal(turned.interface.points, observed.points)


def test_orientation_survives_a_chord_that_turns():
    """Nearly closed: the ends move past each other, the chords point opposite ways, the curve runs on as before."""
    wide, narrow = spiral(40), spiral(40)
    narrow[-1] = [1.02, 0.01]
    wide[-1] = [0.98, -0.01]
    assert np.dot(wide[-1] - wide[0], narrow[-1] - narrow[0]) < 0
    assert not Interface.polyline(wide).runs_against(Interface.polyline(narrow))
    assert Interface.polyline(wide).runs_against(Interface.polyline(narrow).reversed())


@pytest.mark.parametrize(
    ("points", "closed", "segments"),
    [
        pytest.param([(0, 0), (2, 0), (2, 2), (1, -1)], False, "0 and 2", id="crossing"),
        pytest.param([(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)], False, "0 and 2", id="touching with a node"),
        pytest.param([(1, 0), (2, 1), (0, 1), (1, 0), (1, -1)], False, "0 and 2", id="returning to a node"),
        pytest.param([(0, 0), (3, 0), (3, 1), (4, 0), (1, 0)], False, "0 and 3", id="collinear overlap"),
        pytest.param([(0, 0), (1, 0), (1, 1), (3, 1), (3, 0), (1, 0)], False, "0 and 4", id="collinear, end to end"),
        pytest.param([(0, 0), (1, 1), (3, 3), (4, 3), (2, 2)], False, "1 and 3", id="end on a slanted segment"),
        pytest.param([(0, 0), (3, 0), (1, 0)], False, "0 and 1", id="fold-back"),
        pytest.param([(0, 0), (1, 1), (4, 4), (2, 2), (5, 2)], False, "1 and 2", id="slanted fold-back"),
        pytest.param([(0, 0), (1, 0)], True, "0 and 1", id="closed, there and back"),
        pytest.param([(1, 0), (2, 0), (2, 1), (0, 0)], True, "", id="closed, straight across the joint"),
        pytest.param([(1, 0), (2, 0), (2, 1), (3, 1), (3, 0)], True, "4 and 0", id="closed, fold-back at the joint"),
        pytest.param([(0, 0), (1, 1), (1, 0), (0, 1)], True, "0 and 2", id="bow tie"),
        pytest.param(SQUARE.tolist(), True, "", id="square"),
        pytest.param(SQUARE.tolist(), False, "", id="open square"),
        pytest.param([(0, 0), (1, 0), (0, 1)], True, "", id="triangle"),
        pytest.param([(0, 0), (1, 0), (2, 0), (3, 0)], False, "", id="straight"),
        pytest.param([(0, 0), (1, 0), (1, 1e-9), (0, 1e-9)], False, "", id="hairpin"),
        pytest.param([*SQUARE.tolist(), (0, 0)], False, "0 and 3", id="open, ends in its first point"),
    ],
)
@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0])
def test_self_crossings(points, closed, segments, angle):
    """Also turned by an angle, where touching is a matter of rounding."""
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    interface = Interface.polyline(np.array(points, float) @ turn, closed=closed)
    if not segments:
        interface.require_simple()
        return
    with pytest.raises(InvalidInterface, match="crosses itself") as caught:
        interface.require_simple()
    assert caught.value.what.endswith(f"segments {segments}")


def test_the_place_of_a_crossing_is_told():
    with pytest.raises(InvalidInterface, match=r"\(1.5, 0\) mm"):
        chain((0, 0), (2, 0), (2, 1), (1, -1)).require_simple()


@pytest.mark.parametrize("closed", [False, True])
def test_self_crossings_of_random_walks_against_shapely(closed):
    rng = np.random.default_rng(5)
    verdicts = []
    for _ in range(300):
        points = rng.normal(size=(int(rng.integers(3, 9)), 2)).cumsum(axis=0)
        simple = (shapely.LinearRing if closed else shapely.LineString)(points).is_simple
        verdicts.append(simple)
        interface = Interface.polyline(points, closed=closed)
        assert (interface._first_crossing() is None) == simple
    assert 30 < sum(verdicts) < 270


@pytest.mark.parametrize("pairs", [1, 7, 1 << 18])
def test_the_first_of_many_crossings_is_named_whatever_the_size_of_the_blocks(pairs, monkeypatch):
    monkeypatch.setattr("strandline.interface.interface._PAIRS", pairs)
    rng = np.random.default_rng(6)
    for _ in range(20):
        points = rng.normal(size=(40, 2))
        lines = [shapely.LineString(points[k : k + 2]) for k in range(39)]
        first = next((i, j) for i in range(39) for j in range(i + 2, 39) if lines[i].intersects(lines[j]))
        found = Interface.polyline(points)._first_crossing()
        assert found is not None
        assert found[:2] == first


@pytest.mark.parametrize("variance", [0.0, -1.0, math.nan, math.inf])
def test_observation_refuses_a_noise_variance_that_is_none(variance):
    with pytest.raises(InvalidInput, match="noise variance"):
        Observation(Interface.polyline(ZIGZAG), variance)
