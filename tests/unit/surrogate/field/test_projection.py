"""Surfaces that are triangulated anew in every run, on the nodes of the first: against closed forms."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.special import softmax
from shapely.geometry import LinearRing, Point, Polygon
from tests.unit.discrepancy.surfaces import divided, sheet, sphere
from tests.unit.surrogate.field.remeshed import Height, cap, disc, ellipsoid

from strandline.design import sobol
from strandline.discrepancy import ClosestPoint, Currents, Discrepancy
from strandline.errors import InvalidInterface
from strandline.interface import Interface, Observation
from strandline.likelihood import FieldLikelihood
from strandline.surrogate.field import FieldTraining, fit_field
from strandline.surrogate.field.correspondence import common_layout, fields_of, registered
from strandline.surrogate.field.projection import Projection, Reference, _along_normals


def bulge(height: float, lean: float, *, radius: float = 1.0) -> Height:
    """Return a bump of this height that leans to one side and is zero at a radius."""
    return lambda x, y: height * (1 - (x**2 + y**2) / radius**2) * (1 + lean * x)


def projected(surface: Interface, reference: Interface) -> Projection:
    found = Reference(reference).on(surface)
    assert isinstance(found, Projection), found
    return found


def off(points: np.ndarray, height: Height) -> float:
    """Return the root mean square of the heights' errors."""
    return float(np.sqrt(np.mean((points[:, 2] - height(points[:, 0], points[:, 1])) ** 2)))


def rim(rings: int) -> slice:
    """Return which points of a disc of so many rings are on its rim."""
    return slice(-6 * rings, None)


def orders(errors: list[float]) -> np.ndarray:
    """Return the orders of convergence where the mesh is halved each time."""
    return -np.diff(np.log2(errors))


def test_the_first_surface_stands_as_it_is_and_further_ones_change_nothing() -> None:
    runs = [cap(bulge(0.3 + 0.1 * k, 0.2), 6 + k % 3, k) for k in range(5)]
    layout = common_layout(runs)
    assert layout.way == "projection"
    assert layout.template is runs[0]
    points, error = registered(runs[0], layout)
    np.testing.assert_allclose(points, runs[0].points, atol=1e-14)
    assert error < 1e-14
    few, _ = fields_of([{"": run} for run in runs[:3]], {"": common_layout(runs[:3])})
    all_of_them, worst = fields_of([{"": run} for run in runs], {"": layout})
    np.testing.assert_array_equal(all_of_them[:3], few)
    assert worst == max(registered(run, layout)[1] for run in runs)


def test_a_surface_that_is_changed_in_place_is_not_taken_for_the_old_one() -> None:
    first, other = cap(bulge(0.3, 0.0), 6, 1), cap(bulge(0.4, 0.0), 7, 2)
    before, _ = registered(other, common_layout([first, other]))
    other.points[:, 2] *= 1.5
    after, _ = registered(other, common_layout([first, other]))
    np.testing.assert_array_equal(after, projected(other, first).points)
    assert np.abs(after - before).max() > 0.1


def pillow(nodes: int, seed: int | None, height: float) -> Interface:
    """Return a square that bulges and keeps its straight sides."""
    flat = sheet(nodes, seed=seed)
    x, y, _ = flat.points.T
    return Interface(np.stack([x, y, height * x * (1 - x) * y * (1 - y)], axis=1), flat.cells)


def test_nodes_go_along_the_normals_of_the_first_surface() -> None:
    """Those of a flat square point upwards, those of a sphere outwards; a surface cut finer is found node by node."""
    flat = pillow(15, 1, 0.0)
    points = projected(pillow(18, 2, 6.0), flat).points
    np.testing.assert_allclose(points[:, :2], flat.points[:, :2], atol=1e-13)
    x, y, z = points.T
    assert np.sqrt(np.mean((z - 6.0 * x * (1 - x) * y * (1 - y)) ** 2)) < 2e-3
    ball, axes = ellipsoid((1.0, 1.0, 1.0), 1200, 1), (1.4, 1.0, 0.8)
    points = projected(ellipsoid(axes, 1000, 2), ball).points
    along = ball.points / np.linalg.norm(ball.points / np.array(axes), axis=1, keepdims=True)
    assert np.sqrt(np.mean(np.sum((points - along) ** 2, axis=1))) < 1e-2
    surface = sheet(6, bend=0.2, seed=1)
    points, error = registered(divided(surface), common_layout([surface, divided(surface)]))
    np.testing.assert_allclose(points, surface.points, atol=1e-13)
    assert error < 1e-13


@pytest.mark.parametrize(("height", "lean"), [(0.7, 0.4), (-0.2, -0.5)])
def test_caps_converge_with_the_square_of_the_mesh_size(height: float, lean: float) -> None:
    errors, misfits = [], []
    for rings in (6, 12, 24):
        found = projected(cap(bulge(height, lean), rings + 1, 20 + rings), cap(bulge(0.4, 0.1), rings, rings))
        errors.append(off(found.points, bulge(height, lean)))
        misfits.append(found.error)
    for series in (errors, misfits):
        assert orders(series).mean() > 1.65, series
    assert errors[-1] < 1e-3
    assert errors[-1] < misfits[-1] < 4 * errors[-1] + 1e-3


def test_closed_surfaces_converge_with_the_square_of_the_mesh_size() -> None:
    errors, axes = [], (1.5, 1.0, 0.7)
    for number in (200, 800):
        points = projected(ellipsoid(axes, number + 7, 1), ellipsoid((1.1, 0.9, 1.0), number, 2)).points
        gradient = np.linalg.norm(points / np.square(axes), axis=1)
        level = np.linalg.norm(points / np.array(axes), axis=1)
        errors.append(float(np.sqrt(np.mean(((level - 1) / gradient) ** 2))))
    assert (orders(errors) > 1.7).all(), errors


@pytest.mark.parametrize("radius", [0.6, 1.7])
def test_the_rim_stays_the_rim_where_it_moves(radius: float) -> None:
    """Its nodes are on the new rim, and all triangles keep their share of the area: none is stretched."""
    worst, misfits = [], []
    for rings in (8, 16):
        first = cap(bulge(0.3, 0.0), rings, 1)
        found = projected(cap(bulge(0.4, 0.3, radius=radius), rings + 1, 2, radius=radius), first)
        on_rim = found.points[rim(rings)]
        worst.append(float(np.abs(np.linalg.norm(on_rim[:, :2], axis=1) - radius).max()))
        misfits.append(found.error)
        np.testing.assert_allclose(on_rim[:, 2], 0.0, atol=1e-12)
        taken = Interface(found.points, first.cells)
        shares = (taken.areas / taken.areas.sum()) / (first.areas / first.areas.sum())
        assert 0.5 < shares.min() < shares.max() < 2.0
    assert worst[0] < 0.01 * radius
    for series in (worst, misfits):
        assert orders(series)[0] > 1.5, series


def test_a_rim_that_is_left_behind_shows_in_the_error() -> None:
    """A square meets a larger one: the corners of that are cut off, as far as the rim of it knows."""
    small, large = sheet(9), sheet(40, size=1.6)
    large = Interface(large.points - np.array([0.3, 0.3, 0.0]), large.cells)
    found = projected(large, small)
    grid = np.arange(81).reshape(9, 9)
    around = np.concatenate([grid[:-1, 0], grid[-1, :-1], grid[:0:-1, -1], grid[0, :0:-1]])
    ring = LinearRing(found.points[around, :2])
    edge = [Point(p) for p in large.points[:, :2] if np.isclose(np.abs(p - 0.5).max(), 0.8)]
    off_rim = [ring.distance(p) for p in edge]
    everywhere = [Polygon(ring).distance(Point(p)) for p in large.points[:, :2]]
    assert len(edge) == 4 * 39
    assert max(off_rim) > 0.1
    assert found.error == pytest.approx(np.sqrt(np.mean(np.square(off_rim))), rel=1e-9)
    assert found.error > 1.5 * np.sqrt(np.mean(np.square(everywhere)))


def mushroom(overhang: float, rings: int) -> Interface:
    """Return a hat over a stem that is narrower by `overhang`: a profile that is swept around an axis."""
    flat, cells = disc(rings, 2)
    share = np.linalg.norm(flat, axis=1)
    knots = np.array([[0.0, 0.6], [0.5, 0.5], [0.5 - overhang, 0.25], [1.0, 0.0]])
    r, z = (np.interp(share, [0.0, 0.35, 0.65, 1.0], column) for column in knots.T)
    unit = np.divide(flat, share[:, None], out=np.zeros_like(flat), where=share[:, None] > 0)
    return Interface(np.column_stack([r[:, None] * unit, z]), cells)


def test_a_fold_that_is_lost_shows_in_the_error_and_its_inside_is_not_taken_for_the_surface() -> None:
    """Under the hat of the mushroom its lower side is nearest, which faces down; the foot and the hat face up."""
    flat, round_one = cap(bulge(0.0, 0.0), 14, 1), cap(bulge(0.4, 0.0), 14, 1)
    steep, folded = (projected(mushroom(by, 16), flat) for by in (-0.1, 0.25))
    assert steep.error < 0.015
    assert folded.error > 3 * steep.error
    points = projected(mushroom(0.25, 40), round_one).points
    r, z = np.linalg.norm(points[:, :2], axis=1), points[:, 2]
    under = (r > 0.32) & (r < 0.45)
    hat, foot = 0.6 - 0.2 * r, (1 - r) / 3
    assert under.sum() > 30
    assert (np.minimum(np.abs(z - hat), np.abs(z - foot))[under] < 0.01).all()


def test_which_side_a_surface_faces_does_not_matter() -> None:
    first, other = cap(bulge(0.3, 0.0), 6, 1), cap(bulge(0.5, 0.2), 7, 2)
    ball, oval = ellipsoid((1.0, 1.0, 1.0), 300, 1), ellipsoid((1.2, 1.0, 0.9), 310, 2)
    for a, b in ((first, other), (ball, oval)):
        straight, turned = projected(b, a), projected(b.reversed(), a)
        np.testing.assert_allclose(turned.points, straight.points, atol=1e-13)
        assert turned.error == pytest.approx(straight.error, rel=1e-9)
        against = projected(b, a.reversed())
        np.testing.assert_allclose(against.points, straight.points, atol=1e-13)
        assert not Interface(straight.points, a.cells).runs_against(b)


def test_a_body_that_moves_by_more_than_its_thickness_is_followed() -> None:
    first, lens = ellipsoid((1.0, 1.0, 0.3), 1200, 1), ellipsoid((1.0, 1.0, 0.3), 1250, 2)
    by = np.array([0.0, 0.0, 0.7])
    found = projected(Interface(lens.points + by, lens.cells), first)
    np.testing.assert_allclose(found.points, projected(lens, first).points + by, atol=1e-12)
    np.testing.assert_allclose(found.points - by, first.points, atol=0.03)


def together(*surfaces: Interface) -> Interface:
    begins = np.cumsum([0] + [len(one.points) for one in surfaces[:-1]])
    cells = [one.cells + begin for one, begin in zip(surfaces, begins, strict=True)]
    return Interface(np.concatenate([one.points for one in surfaces]), np.concatenate(cells))


def shifted(surface: Interface, by: float) -> Interface:
    return Interface(surface.points + np.array([by, 0.0, 0.0]), surface.cells)


def test_a_crossing_far_behind_is_not_taken_where_the_line_just_misses() -> None:
    """A sheet moves aside by a sixth; behind its edge a line meets another sheet, ten times as far."""
    first = sheet(7)
    aside = Interface(first.points + np.array([1 / 6, 0.0, 0.1]), first.cells)
    behind = Interface(sheet(7, size=4.0).points - np.array([1.0, 1.0, 5.0]), first.cells)
    both = together(aside, behind)
    points = _along_normals(first.points, np.arange(49), first.cells, both, cKDTree(both.centres))
    expected = first.points + np.array([0.0, 0.0, 0.1])
    expected[:, 0] = np.maximum(expected[:, 0], 1 / 6)
    np.testing.assert_allclose(points, expected, atol=1e-12)


CAP, HOLED = cap(bulge(0.3, 0.0), 6, 1), cap(bulge(0.3, 0.0), 7, 2)


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (sphere(1.0, 2), r"1 part\(s\), 1 rim\(s\), .* 1 in one run; .* 0 rim\(s\), .* 2"),
        (Interface(HOLED.points, HOLED.cells[1:]), r"1 rim\(s\).*2 rim\(s\)"),
        (together(HOLED, shifted(sphere(0.3, 1), 3.0)), r"1 part\(s\).*2 part\(s\)"),
    ],
)
def test_surfaces_of_other_kinds_are_refused(other: Interface, words: str) -> None:
    with pytest.raises(InvalidInterface, match=words):
        common_layout([CAP, other])
    with pytest.raises(InvalidInterface, match=words):
        registered(other, common_layout([CAP, divided(CAP)]))


def test_parts_and_holes_that_all_runs_have_are_fine() -> None:
    """An open part, whose rim moves, does not pull at a closed one, be it as simple as an octahedron."""
    first = together(cap(bulge(0.3, 0.0), 6, 1), shifted(sphere(0.4, 0), 3.0))
    other = together(cap(bulge(0.4, 0.0), 7, 2, radius=1.2), shifted(sphere(0.6, 0), 3.0))
    points = projected(other, first).points
    np.testing.assert_allclose(points[-6:], other.points[-6:], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(points[-42:-6, :2], axis=1), 1.2, atol=0.02)


def test_triangles_that_the_projection_turns_over_or_flattens_are_refused() -> None:
    """Two discs with round sides that stand across each other; a rim that shrinks to a notch, near whose tip all
    nodes find the same point.
    """
    lying, standing = ellipsoid((2.0, 1.0, 0.3), 800, 1), ellipsoid((0.3, 1.0, 2.0), 800, 2)
    with pytest.raises(InvalidInterface, match=r"triangle\(s\) of one run's surface (turned over|flattened) when"):
        common_layout([lying, standing])
    for size in (1.0, 1e-3):
        ball, flat = ellipsoid((size, size, size), 1200, 1), ellipsoid((2.0 * size, size, 0.3 * size), 1200, 6)
        found = Reference(ball).on(flat)
        assert isinstance(found, str)
        assert "turned over" in found
    first = sheet(9)
    corner = Interface(np.array([[0.4, 0.4, 0.0], [0.6, 0.4, 0.0], [0.5, 0.6, 0.0]]), np.array([[0, 1, 2]]))
    with pytest.raises(InvalidInterface, match=r"flattened when .* at \(.*\) mm"):
        registered(corner, common_layout([first, divided(first)]))


def test_a_flatter_run_is_the_reference_where_the_first_is_bent_too_much() -> None:
    """The normals of a high bulge meet below it; those of a low one fit onto the high."""
    heights = (1.2, 0.9, 0.3, -0.3)
    runs = [cap(bulge(height, 0.1), 12 + k % 3, k) for k, height in enumerate(heights)]
    layout = common_layout(runs)
    assert layout.template is runs[2]
    for run, height in zip(runs, heights, strict=True):
        points, error = registered(run, layout)
        assert off(points, bulge(height, 0.1)) < 0.01
        assert error < 0.01
    assert common_layout([runs[2], *runs]).template is runs[2]


LOW, HIGH = np.array([0.2, -0.4]), np.array([0.6, 0.4])
INPUTS = LOW + (HIGH - LOW) * sobol(14, 2, scramble=3)
RINGS = 7


def training(*, remeshed: bool, rings: int = RINGS) -> FieldTraining:
    """Return runs of leaning bulges, whose radius falls with the height, on one mesh or each on its own."""
    interfaces = [
        {"": one(x, rings=rings + k % 3 if remeshed else rings, seed=100 + k if remeshed else 1)}
        for k, x in enumerate(INPUTS)
    ]
    return FieldTraining(INPUTS, interfaces, None, LOW, HIGH)


def one(x: np.ndarray, *, rings: int, seed: int) -> Interface:
    radius = 1.2 - 0.5 * float(x[0])
    return cap(bulge(float(x[0]), float(x[1]), radius=radius), rings, seed, radius=radius)


def test_the_field_is_learnt_from_runs_that_are_meshed_anew() -> None:
    base = training(remeshed=True)
    slopes = [{"": np.zeros((*run[""].points.shape, 2))} for run in base.interfaces]
    found = fit_field(replace(base, gradients=slopes))
    assert found.layouts[""].way == "projection"
    assert not found.gradients
    assert 0 < found.registration_error < 0.02
    for x in LOW + (HIGH - LOW) * np.array([[0.3, 0.4], [0.7, 0.2], [0.5, 0.8]]):
        radius, predicted = 1.2 - 0.5 * float(x[0]), found.interfaces(x)[""]
        assert off(predicted.points, bulge(float(x[0]), float(x[1]), radius=radius)) < 6e-3
        on_rim = np.linalg.norm(predicted.points[rim(RINGS), :2], axis=1)
        np.testing.assert_allclose(on_rim, radius, atol=8e-3)


def moments(log_likelihood: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean and the standard deviation of a posterior under a uniform prior, on a grid."""
    u, v = np.meshgrid(*2 * [(np.arange(16) + 0.5) / 16], indexing="ij")
    x = np.array([0.35, -0.25]) + np.array([0.1, 0.6]) * np.stack([u.ravel(), v.ravel()], axis=1)
    weights = softmax(log_likelihood(x))
    mean = weights @ x
    return mean, np.sqrt(weights @ (x - mean) ** 2)


@pytest.mark.long
@pytest.mark.parametrize(
    ("measure", "noise", "rings"), [(ClosestPoint(), 1.2e-2, 12), (Currents(0.4, quadrature="centre"), 2e-3, 8)]
)
def test_the_posterior_is_that_of_runs_on_one_mesh(measure: Discrepancy, noise: float, rings: int) -> None:
    """And that of the model itself, asked directly; the observed surface has a mesh of its own."""
    seen = one(np.array([0.4, 0.05]), rings=rings + 3, seed=999)
    observation = Observation(seen, noise)
    mean, sd = moments(lambda x: np.array([-0.5 * measure(one(u, rings=rings, seed=1), seen) / noise for u in x]))
    for remeshed in (False, True):
        surrogate = fit_field(training(remeshed=remeshed, rings=rings))
        found_mean, found_sd = moments(FieldLikelihood(surrogate, (observation,), measure).plug_in)
        assert (np.abs(found_mean - mean) / sd < 0.2).all()
        np.testing.assert_allclose(found_sd, sd, rtol=0.1)
