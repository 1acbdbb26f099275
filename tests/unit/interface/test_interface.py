"""Polylines: refusals, geometry in closed form, self-crossings against shapely."""

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely

from strandline.errors import InvalidInput, InvalidInterface
from strandline.interface import Interface, Observation, UnknownErrors, is_condition, oriented_like
from strandline.interface.interface import _meeting

ZIGZAG = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
TRIANGLE = Interface(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([[0, 1, 2]]))


def chain(*points, closed=False):
    return Interface.polyline(np.array(points, float), closed=closed)


def test_geometry_in_closed_form():
    zigzag, square = Interface.polyline(ZIGZAG), Interface.polyline(SQUARE, closed=True)
    assert (zigzag.dim, zigzag.closed, square.closed) == (2, False, True)
    assert zigzag.lengths.tolist() == [5.0, 1.0]
    assert zigzag.centres.tolist() == [[1.5, 2.0], [3.0, 4.5]]
    assert zigzag.normals.tolist() == [[-4.0, 3.0], [-1.0, 0.0]]
    assert square.lengths.tolist() == [1.0] * 4
    assert square.normals.sum(axis=0).tolist() == [0.0, 0.0]
    for one in (square, Interface.polyline(SQUARE)):
        assert np.array_equal(one.reversed().reversed().points, one.points)
        assert one.reversed().closed == one.closed
    assert np.array_equal(zigzag.reversed().normals, -zigzag.normals[::-1])


def test_names_of_conditions():
    assert all(is_condition(name) for name in ("", "slow", "day 3", "100 mm²_s", "v=0.5", "x" * 64))
    assert not any(is_condition(name) for name in (None, 3, "a/b", "a\\b", " slow", "slow\n", "a\0b", "x" * 65))


def test_what_is_no_polyline_is_refused():
    for points, closed, found in (
        ([[1.0, 2.0]], False, "too few points"),
        ([[0.0, 0.0], [math.nan, 1.0]], False, "point 1 of the interface is not finite"),
        ([[math.inf, 0.0], [0.0, 1.0]], False, "point 0 of the interface is not finite"),
        ([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [2.0, 0.0]], False, "segment 1 of the interface has no length"),
        ([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], True, "segment 3 of the interface has no length"),
    ):
        with pytest.raises(InvalidInterface, match=found):
            chain(*points, closed=closed)
    with pytest.raises(InvalidInterface, match="too few points"):
        Interface.polyline(np.zeros((0, 2)))
    for cells in ([[0, 1], [1, 3]], [[0, 1], [1, -1]], [[0, 1], [2, 1]]):
        with pytest.raises(InvalidInterface, match="nodes of the cells"):
            Interface(ZIGZAG, np.array(cells))
    for variance in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InvalidInput, match="noise variance"):
            Observation(Interface.polyline(ZIGZAG), variance)


def test_resampling_is_equally_spaced_on_the_polyline_and_keeps_the_ends():
    fine = Interface.polyline(ZIGZAG).resampled(7)
    assert fine.points == pytest.approx(np.array([[0.6 * k, 0.8 * k] for k in range(6)] + [[3.0, 5.0]]))
    square = Interface.polyline(SQUARE, closed=True).resampled(8)
    assert square.closed
    assert square.lengths == pytest.approx([0.5] * 8)
    assert square.points[0].tolist() == [0.0, 0.0]


def spiral(nodes):
    angle = np.linspace(0.0, 1.9 * np.pi, nodes)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("closed", [False, True])
def test_orientation_is_found_and_repaired(closed):
    for points in (SQUARE, SQUARE + 50.0, spiral(30), ZIGZAG):
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
    narrow[-1], wide[-1] = [1.02, 0.01], [0.98, -0.01]
    assert np.dot(wide[-1] - wide[0], narrow[-1] - narrow[0]) < 0
    assert not Interface.polyline(wide).runs_against(Interface.polyline(narrow))
    assert Interface.polyline(wide).runs_against(Interface.polyline(narrow).reversed())


CROSSINGS = {
    "crossing": ([(0, 0), (2, 0), (2, 2), (1, -1)], False, "0 and 2"),
    "touching with a node": ([(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)], False, "0 and 2"),
    "returning to a node": ([(1, 0), (2, 1), (0, 1), (1, 0), (1, -1)], False, "0 and 2"),
    "collinear overlap": ([(0, 0), (3, 0), (3, 1), (4, 0), (1, 0)], False, "0 and 3"),
    "collinear, end to end": ([(0, 0), (1, 0), (1, 1), (3, 1), (3, 0), (1, 0)], False, "0 and 4"),
    "end on a slanted segment": ([(0, 0), (1, 1), (3, 3), (4, 3), (2, 2)], False, "1 and 3"),
    "fold-back": ([(0, 0), (3, 0), (1, 0)], False, "0 and 1"),
    "slanted fold-back": ([(0, 0), (1, 1), (4, 4), (2, 2), (5, 2)], False, "1 and 2"),
    "closed, there and back": ([(0, 0), (1, 0)], True, "0 and 1"),
    "closed, straight across the joint": ([(1, 0), (2, 0), (2, 1), (0, 0)], True, ""),
    "closed, fold-back at the joint": ([(1, 0), (2, 0), (2, 1), (3, 1), (3, 0)], True, "4 and 0"),
    "bow tie": ([(0, 0), (1, 1), (1, 0), (0, 1)], True, "0 and 2"),
    "square": (SQUARE.tolist(), True, ""),
    "open square": (SQUARE.tolist(), False, ""),
    "triangle": ([(0, 0), (1, 0), (0, 1)], True, ""),
    "straight": ([(0, 0), (1, 0), (2, 0), (3, 0)], False, ""),
    "hairpin": ([(0, 0), (1, 0), (1, 1e-9), (0, 1e-9)], False, ""),
    "open, ends in its first point": ([*SQUARE.tolist(), (0, 0)], False, "0 and 3"),
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
        chain((0, 0), (2, 0), (2, 1), (1, -1)).require_simple()


@pytest.mark.parametrize("closed", [False, True])
def test_self_crossings_of_random_walks_against_shapely(closed):
    rng, verdicts = np.random.default_rng(5), []
    for _ in range(150):
        points = rng.normal(size=(int(rng.integers(3, 9)), 2)).cumsum(axis=0)
        verdicts.append((shapely.LinearRing if closed else shapely.LineString)(points).is_simple)
        assert (Interface.polyline(points, closed=closed)._first_crossing() is None) == verdicts[-1]
    assert 15 < sum(verdicts) < 135


def test_the_first_of_many_crossings_is_named_whatever_the_size_of_the_blocks():
    rng = np.random.default_rng(6)
    for _ in range(5):
        points = rng.normal(size=(40, 2))
        lines = [shapely.LineString(points[k : k + 2]) for k in range(39)]
        pairs = [(i, j) for i in range(39) for j in range(i + 2, 39) if lines[i].intersects(lines[j])]
        found = Interface.polyline(points)._first_crossing()
        assert found is not None
        assert found[:2] == pairs[0]
        for together in (1, 7, 1 << 18):
            assert sorted(_meeting(points[:-1], points[1:], 1e-15, closed=False, together=together)) == pairs


def corners(points):
    (drawn,) = ElementTree.fromstring(Interface.polyline(np.array(points))._repr_svg_())
    return np.array(re.findall(r"[\d.]+", drawn.attrib["points"]), float).reshape(-1, 2)


def test_an_interface_at_a_prompt_and_in_a_notebook() -> None:
    """The drawing keeps proportions and has y upwards; a level line has a height; a surface has no drawing."""
    points = np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 0.25]])
    assert repr(Interface.polyline(points)) == "<Interface: polyline of 3 points, 2 × 0.5 mm>"
    got = corners([[1.0, 1.0], [3.0, 1.0], [3.0, 2.0]])
    across, up = got[1] - got[0], got[2] - got[1]
    np.testing.assert_allclose(across[0], 2 * -up[1], rtol=1e-3)
    assert across[1] == up[0] == 0.0
    assert np.isfinite(corners([[0.0, 0.0], [1.0, 0.0]])).all()
    assert TRIANGLE._repr_svg_() is None
    assert repr(TRIANGLE) == "<Interface: surface of 3 points, 1 × 1 × 0 mm>"


def test_unknown_errors_are_not_inferred_on_a_surface() -> None:
    for noise, said, remedy in (
        (UnknownErrors(), "got unknown", "State them"),
        (UnknownErrors(0.003, None, model_error=True), "got unknown", "State them"),
        (UnknownErrors(0.003, 0.015, model_error=True), "got a model error", "Remove `model_error` and `spread`."),
        (UnknownErrors(0.003, 0.015, spread=(0,)), "got a spread", "Remove `model_error` and `spread`."),
    ):
        with pytest.raises(InvalidInput, match=said) as caught:
            noise.require_fits(TRIANGLE)
        assert remedy in str(caught.value)
