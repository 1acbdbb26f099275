"""Surfaces: areas and volumes in closed form, refusals, orientation found and repaired."""

import math

import numpy as np
import pytest
from tests.unit.discrepancy.surfaces import divided, sheet, sphere, turned

from strandline.errors import InvalidInterface
from strandline.interface import Interface, oriented_like, triangles

CORNERS = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 3.0]])


def test_geometry_of_two_triangles():
    surface = Interface(CORNERS, np.array([[0, 1, 2], [1, 3, 2]]))
    assert surface.dim == 3
    assert surface.areas.tolist() == pytest.approx([4.5, 4.5 * math.sqrt(3)])
    assert surface.normals.tolist() == [[0.0, 0.0, 4.5], [-4.5, -4.5, -4.5]]
    assert surface.centres.tolist() == [[1.0, 1.0, 0.0], [1.0, 1.0, 1.0]]
    assert surface.sizes.tolist() == surface.areas.tolist()
    assert not surface.closed
    bent = sheet(4, bend=0.2)
    assert bent.reversed().normals == pytest.approx(-bent.normals)
    assert np.array_equal(bent.reversed().reversed().cells, bent.cells)


def test_area_and_volume_of_a_sphere_converge_with_order_two_wherever_it_lies():
    balls = [sphere(2.0, k) for k in (2, 3, 4)]
    areas = np.array([ball.areas.sum() for ball in balls]) - 16 * math.pi
    volumes = np.array([triangles.signed_volume(ball.points, ball.cells) for ball in balls]) - 32 / 3 * math.pi
    for errors in (areas, volumes):
        assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)
    assert all(ball.closed for ball in balls)
    moved = turned(balls[0], 1)
    assert moved.areas == pytest.approx(balls[0].areas)
    assert triangles.signed_volume(moved.points, moved.cells) == pytest.approx(volumes[0] + 32 / 3 * math.pi)


def test_what_is_no_surface_is_refused():
    for points, cells in (
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 1, 3], [0, 1, 2]]),
        ([[0, 0, 0], [0.1, 0.3, 0.7], [0.3, 0.9, 2.1], [0, 1, 0]], [[0, 1, 3], [0, 1, 2]]),
        ([[50, 50, 50], [50.1, 50.3, 50.7], [50.3, 50.9, 52.1], [0, 1, 0]], [[0, 1, 3], [0, 1, 2]]),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 1]]),
    ):
        with pytest.raises(InvalidInterface, match="triangle 1 of the interface has no area"):
            Interface(np.array(points, float), np.array(cells))
    sliver = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1e-9, 0.0]])
    assert Interface(sliver, np.array([[0, 1, 2]])).areas == pytest.approx([0.5e-9])
    with pytest.raises(InvalidInterface, match="point 3 of the surface belongs to no triangle"):
        Interface(CORNERS, np.array([[0, 1, 2]]))
    for dim, number in ((3, 2), (2, 3), (4, 4)):
        with pytest.raises(InvalidInterface, match="kind of interface"):
            Interface(np.eye(4, dim), np.arange(number)[None])


def test_a_surface_has_no_segments_and_a_polyline_no_areas():
    for name in ("starts", "ends", "lengths"):
        with pytest.raises(InvalidInterface, match="surface, which has areas"):
            getattr(sheet(3), name)
    with pytest.raises(InvalidInterface, match="polyline, which has lengths"):
        _ = Interface.polyline(np.eye(2)).areas
    with pytest.raises(InvalidInterface, match="orientation"):
        sheet(3).runs_against(Interface.polyline(np.eye(2)))


def dome() -> Interface:
    ball = sphere(1.0, 2)
    used, cells = np.unique(ball.cells[ball.centres[:, 2] > 0], return_inverse=True)
    return Interface(ball.points[used], cells.reshape(-1, 3))


SURFACES = {"bent sheet": sheet(9, bend=0.3, seed=1), "ball": sphere(0.7, 2), "dome": dome()}


@pytest.mark.parametrize("reference", SURFACES.values(), ids=SURFACES)
def test_orientation_is_found_and_repaired(reference):
    """The other surface has other triangles, is moved by a tenth of its extent and jittered."""
    finer = divided(reference)
    moved = finer.points + 0.1 + 0.01 * np.random.default_rng(1).normal(size=finer.points.shape)
    observed = Interface(moved, finer.cells)
    assert not observed.runs_against(reference)
    assert not reference.runs_against(observed)
    assert observed.reversed().runs_against(reference)
    turned_round = oriented_like(observed.reversed(), reference)
    assert turned_round.flipped
    assert np.array_equal(turned_round.interface.cells, observed.cells)


def test_closed_surfaces_are_compared_by_volume_wherever_they_lie():
    """Two balls far apart: the nearest triangles of each face each other, and yet they are oriented alike."""
    one, other = sphere(1.0, 2), sphere(1.0, 2)
    other = Interface(other.points + np.array([10.0, 0.0, 0.0]), other.cells)
    assert not one.runs_against(other)
    assert one.runs_against(other.reversed())
    flipped = one.cells.copy()
    flipped[3] = flipped[3, ::-1]
    assert one.closed
    assert not Interface(one.points, flipped).closed
