"""Surfaces that are triangulated anew in every run, on the nodes of the first: against closed forms."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay, cKDTree
from shapely.geometry import LinearRing, Point
from tests.unit.discrepancy.surfaces import divided, sheet, sphere

from strandline.design import sobol
from strandline.foundations import InvalidInterface
from strandline.interface import Interface
from strandline.surrogate.field import FieldTraining, fit_field
from strandline.surrogate.field.correspondence import common_layout, fields_of, registered
from strandline.surrogate.field.projection import Projection, Reference, _along_normals


def disc(rings, seed):
    """Return points of the unit disc (point, 2) and triangles: rings of them, each turned and its points moved."""
    rng = np.random.default_rng(seed)
    points = [np.zeros((1, 2))]
    for k in range(1, rings + 1):
        number = 6 * k
        angle = 2 * np.pi * (np.arange(number) + rng.uniform() + rng.uniform(-0.15, 0.15, number)) / number
        radius = 1.0 if k == rings else (k + rng.uniform(-0.15, 0.15, number)) / rings
        points.append(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    flat = np.concatenate(points)
    cells = Delaunay(flat).simplices
    clockwise = np.linalg.det(flat[cells[:, 1:]] - flat[cells[:, :1]]) < 0
    cells[clockwise] = cells[clockwise, ::-1]
    return flat, cells.astype(int)


def cap(height, rings, seed, *, radius=1.0):
    """Return the graph of a height over a disc, facing up."""
    flat, cells = disc(rings, seed)
    x, y = radius * flat.T
    return Interface(np.stack([x, y, height(x, y)], axis=1), cells)


def ellipsoid(axes, number, seed):
    """Return an ellipsoid through the images of points spread evenly over a turned sphere; it faces outwards."""
    k = np.arange(number) + 0.5
    z, angle = 1 - 2 * k / number, np.pi * (1 + np.sqrt(5)) * k
    r = np.sqrt(1 - z**2)
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    ball = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1) @ rotation.T
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    cells = ConvexHull(ball).simplices.astype(int)
    inward = np.linalg.det(ball[cells]) < 0
    cells[inward] = cells[inward, ::-1]
    return Interface(ball * np.array(axes), cells)


def bulge(height, lean, *, radius=1.0):
    """Return a bump of this height that leans to one side and is zero at a radius."""
    return lambda x, y: height * (1 - (x**2 + y**2) / radius**2) * (1 + lean * x)


def projected(surface, reference):
    found = Reference(reference).on(surface)
    assert isinstance(found, Projection), found
    return found


def moved(surface, *by):
    return Interface(surface.points + np.array(by), surface.cells)


def off(points, height):
    """Return the root mean square of the heights' errors."""
    return float(np.sqrt(np.mean((points[:, 2] - height(points[:, 0], points[:, 1])) ** 2)))


def orders(errors):
    """Return the orders of convergence where the mesh is halved each time."""
    return -np.diff(np.log2(errors))


def test_the_first_surface_stands_as_it_is_and_further_ones_change_nothing():
    runs = [cap(bulge(0.3 + 0.1 * k, 0.2), 6 + k % 3, k) for k in range(5)]
    layout = common_layout(runs)
    assert layout.way == "projection"
    assert layout.template is runs[0]
    np.testing.assert_allclose(registered(runs[0], layout)[0], runs[0].points, atol=1e-14)
    few, _ = fields_of([{"": run} for run in runs[:3]], {"": common_layout(runs[:3])})
    all_of_them, worst = fields_of([{"": run} for run in runs], {"": layout})
    np.testing.assert_array_equal(all_of_them[:3], few)
    assert worst == max(registered(run, layout)[1] for run in runs)
    runs[1].points[:, 2] *= 1.5  # a surface that is changed in place is not taken for the old one
    after, _ = registered(runs[1], common_layout(runs[:2]))
    np.testing.assert_array_equal(after, projected(runs[1], runs[0]).points)


def pillow(x, y):
    """Return the height of a square that bulges and keeps its straight sides."""
    return 6.0 * x * (1 - x) * y * (1 - y)


def test_nodes_go_along_the_normals_of_the_first_surface():
    """Those of a flat square point upwards, those of a sphere outwards; a surface cut finer is found node by node."""
    flat, other = sheet(15, seed=1), sheet(18, seed=2)
    other.points[:, 2] = pillow(*other.points[:, :2].T)
    points = projected(other, flat).points
    np.testing.assert_allclose(points[:, :2], flat.points[:, :2], atol=1e-13)
    assert off(points, pillow) < 2e-3
    ball, axes = ellipsoid((1.0, 1.0, 1.0), 1200, 1), (1.4, 1.0, 0.8)
    points = projected(ellipsoid(axes, 1000, 2), ball).points
    along = ball.points / np.linalg.norm(ball.points / np.array(axes), axis=1, keepdims=True)
    assert np.sqrt(np.mean(np.sum((points - along) ** 2, axis=1))) < 1e-2
    surface = sheet(6, bend=0.2, seed=1)
    np.testing.assert_allclose(projected(divided(surface), surface).points, surface.points, atol=1e-13)


def test_caps_converge_with_the_square_of_the_mesh_size_whichever_side_they_face():
    errors, misfits, height = [], [], bulge(0.7, 0.4)
    for rings in (6, 12, 24):
        found = projected(cap(height, rings + 1, 20 + rings).reversed(), cap(bulge(0.4, 0.1), rings, rings))
        errors.append(off(found.points, height))
        misfits.append(found.error)
    for series in (errors, misfits):
        assert orders(series).mean() > 1.65, series
    assert errors[-1] < 1e-3
    assert errors[-1] < misfits[-1] < 4 * errors[-1] + 1e-3


def test_closed_surfaces_converge_with_the_square_of_the_mesh_size():
    """A body is followed wherever it moves, whichever side its surface faces."""
    errors, axes = [], (1.5, 1.0, 0.7)
    for number in (200, 800):
        away = moved(ellipsoid(axes, number + 7, 1), 0.0, 0.0, 3.0)
        points = projected(away.reversed(), ellipsoid((1.1, 0.9, 1.0), number, 2)).points - np.array([0.0, 0.0, 3.0])
        gradient, level = (np.linalg.norm(points / np.power(axes, power), axis=1) for power in (2, 1))
        errors.append(float(np.sqrt(np.mean(((level - 1) / gradient) ** 2))))
    assert (orders(errors) > 1.7).all(), errors


@pytest.mark.parametrize("radius", [0.6, 1.7])
def test_the_rim_stays_the_rim_where_it_moves(radius):
    """Its nodes are on the new rim, and all triangles keep their share of the area: none is stretched."""
    worst, misfits = [], []
    for rings in (8, 16):
        first = cap(bulge(0.3, 0.0), rings, 1)
        found = projected(cap(bulge(0.4, 0.3, radius=radius), rings + 1, 2, radius=radius), first)
        on_rim = found.points[-6 * rings :]
        worst.append(float(np.abs(np.linalg.norm(on_rim[:, :2], axis=1) - radius).max()))
        misfits.append(found.error)
        np.testing.assert_allclose(on_rim[:, 2], 0.0, atol=1e-12)
        taken = Interface(found.points, first.cells)
        shares = (taken.areas / taken.areas.sum()) / (first.areas / first.areas.sum())
        assert 0.5 < shares.min() < shares.max() < 2.0
    assert worst[0] < 0.01 * radius
    for series in (worst, misfits):
        assert orders(series)[0] > 1.5, series


def test_a_rim_that_is_left_behind_shows_in_the_error():
    """A square meets a larger one: the corners of that are cut off, as far as the rim of it knows."""
    small, large = sheet(9), moved(sheet(40, size=1.6), -0.3, -0.3, 0.0)
    found = projected(large, small)
    grid = np.arange(81).reshape(9, 9)
    around = np.concatenate([grid[:-1, 0], grid[-1, :-1], grid[:0:-1, -1], grid[0, :0:-1]])
    ring = LinearRing(found.points[around, :2])
    edge = [Point(p) for p in large.points[:, :2] if np.isclose(np.abs(p - 0.5).max(), 0.8)]
    off_rim = [ring.distance(p) for p in edge]
    assert len(edge) == 4 * 39
    assert max(off_rim) > 0.1
    assert found.error == pytest.approx(np.sqrt(np.mean(np.square(off_rim))), rel=1e-9)


def mushroom(overhang, rings):
    """Return a hat over a stem that is narrower by `overhang`: a profile that is swept around an axis."""
    flat, cells = disc(rings, 2)
    share = np.linalg.norm(flat, axis=1)
    knots = np.array([[0.0, 0.6], [0.5, 0.5], [0.5 - overhang, 0.25], [1.0, 0.0]])
    r, z = (np.interp(share, [0.0, 0.35, 0.65, 1.0], column) for column in knots.T)
    unit = np.divide(flat, share[:, None], out=np.zeros_like(flat), where=share[:, None] > 0)
    return Interface(np.column_stack([r[:, None] * unit, z]), cells)


def test_a_fold_that_is_lost_shows_in_the_error_and_its_inside_is_not_taken_for_the_surface():
    """Under the hat of the mushroom its lower side is nearest, which faces down; the foot and the hat face up."""
    flat = cap(bulge(0.0, 0.0), 14, 1)
    steep, folded = (projected(mushroom(by, 16), flat) for by in (-0.1, 0.25))
    assert steep.error < 0.015
    assert folded.error > 3 * steep.error
    points = projected(mushroom(0.25, 40), cap(bulge(0.4, 0.0), 14, 1)).points
    r, z = np.linalg.norm(points[:, :2], axis=1), points[:, 2]
    under = (r > 0.32) & (r < 0.45)
    hat, foot = 0.6 - 0.2 * r, (1 - r) / 3
    assert under.sum() > 30
    assert (np.minimum(np.abs(z - hat), np.abs(z - foot))[under] < 0.01).all()


def together(*surfaces):
    begins = np.cumsum([0] + [len(one.points) for one in surfaces[:-1]])
    cells = [one.cells + begin for one, begin in zip(surfaces, begins, strict=True)]
    return Interface(np.concatenate([one.points for one in surfaces]), np.concatenate(cells))


def test_a_crossing_far_behind_is_not_taken_where_the_line_just_misses():
    """A sheet moves aside by a sixth; behind its edge a line meets another sheet, ten times as far."""
    first = sheet(7)
    both = together(moved(first, 1 / 6, 0.0, 0.1), moved(sheet(7, size=4.0), -1.0, -1.0, -5.0))
    points = _along_normals(first.points, np.arange(49), first.cells, both, cKDTree(both.centres))
    expected = first.points + np.array([0.0, 0.0, 0.1])
    expected[:, 0] = np.maximum(expected[:, 0], 1 / 6)
    np.testing.assert_allclose(points, expected, atol=1e-12)


def test_surfaces_of_other_kinds_are_refused():
    one, holed = cap(bulge(0.3, 0.0), 6, 1), cap(bulge(0.3, 0.0), 7, 2)
    for other, words in (
        (sphere(1.0, 2), r"1 part\(s\), 1 rim\(s\), .* 1 in one run; .* 0 rim\(s\), .* 2"),
        (Interface(holed.points, holed.cells[1:]), r"1 rim\(s\).*2 rim\(s\)"),
        (together(holed, moved(sphere(0.3, 1), 3.0, 0.0, 0.0)), r"1 part\(s\).*2 part\(s\)"),
    ):
        with pytest.raises(InvalidInterface, match=words):
            common_layout([one, other])


def test_parts_and_holes_that_all_runs_have_are_fine():
    """An open part, whose rim moves, does not pull at a closed one, be it as simple as an octahedron."""
    first = together(cap(bulge(0.3, 0.0), 6, 1), moved(sphere(0.4, 0), 3.0, 0.0, 0.0))
    other = together(cap(bulge(0.4, 0.0), 7, 2, radius=1.2), moved(sphere(0.6, 0), 3.0, 0.0, 0.0))
    points = projected(other, first).points
    np.testing.assert_allclose(points[-6:], other.points[-6:], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(points[-42:-6, :2], axis=1), 1.2, atol=0.02)


def test_triangles_that_the_projection_turns_over_or_flattens_are_refused():
    """Two discs that stand across each other; a rim that shrinks to a notch, near whose tip nodes find one point."""
    lying, standing = ellipsoid((2.0, 1.0, 0.3), 800, 1), ellipsoid((0.3, 1.0, 2.0), 800, 2)
    with pytest.raises(InvalidInterface, match=r"triangle\(s\) of one run's surface (turned over|flattened) when"):
        common_layout([lying, standing])
    for size in (1.0, 1e-3):
        ball, flat = ellipsoid((size, size, size), 1200, 1), ellipsoid((2.0 * size, size, 0.3 * size), 1200, 6)
        assert "turned over" in Reference(ball).on(flat)
    first = sheet(9)
    corner = Interface(np.array([[0.4, 0.4, 0.0], [0.6, 0.4, 0.0], [0.5, 0.6, 0.0]]), np.array([[0, 1, 2]]))
    with pytest.raises(InvalidInterface, match=r"flattened when .* at \(.*\) mm"):
        registered(corner, common_layout([first, divided(first)]))


def test_a_flatter_run_is_the_reference_where_the_first_is_bent_too_much():
    """The normals of a high bulge meet below it; those of a low one fit onto the high."""
    heights = (1.2, 0.9, 0.3, -0.3)
    runs = [cap(bulge(height, 0.1), 12 + k % 3, k) for k, height in enumerate(heights)]
    layout = common_layout(runs)
    assert layout.template is runs[2]
    for run, height in zip(runs, heights, strict=True):
        points, error = registered(run, layout)
        assert max(error, off(points, bulge(height, 0.1))) < 0.01
    assert common_layout([runs[2], *runs]).template is runs[2]


LOW, HIGH = np.array([0.2, -0.4]), np.array([0.6, 0.4])
INPUTS = LOW + (HIGH - LOW) * sobol(14, 2, scramble=3)
RINGS = 7


def leaning(x, *, rings, seed):
    """Return a leaning bulge, whose radius falls with the height."""
    radius = 1.2 - 0.5 * x[0]
    return cap(bulge(x[0], x[1], radius=radius), rings, seed, radius=radius)


def test_the_field_is_learnt_from_runs_that_are_meshed_anew():
    runs = [{"": leaning(x, rings=RINGS + k % 3, seed=100 + k)} for k, x in enumerate(INPUTS)]
    slopes = [{"": np.zeros((*run[""].points.shape, 2))} for run in runs]
    found = fit_field(FieldTraining(INPUTS, runs, slopes, LOW, HIGH))
    assert found.layouts[""].way == "projection"
    assert not found.gradients
    assert 0 < found.registration_error < 0.02
    for x in LOW + (HIGH - LOW) * np.array([[0.3, 0.4], [0.7, 0.2], [0.5, 0.8]]):
        radius, predicted = 1.2 - 0.5 * x[0], found.interfaces(x)[""]
        assert off(predicted.points, bulge(x[0], x[1], radius=radius)) < 6e-3
        on_rim = np.linalg.norm(predicted.points[-6 * RINGS :, :2], axis=1)
        np.testing.assert_allclose(on_rim, radius, atol=8e-3)
