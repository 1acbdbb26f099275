"""Outlines, channels, partitions and their meshes: what is made, and what is refused with its place."""

import ngsolve as ng
import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.models.biofilm.channel import Channel, check_outline
from strandline.models.biofilm.geometry import MESHES, MeshSize, mesh_flow_cell, subdivide
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition, Subdivision

COARSE = MESHES["coarse"]
THREE = Partition.PRESETS["three_parts"]
BUMP = ((0.5, 0.0), (0.6, 0.3), (0.9, 0.35), (1.2, 0.0))


def _shoelace(points: np.ndarray) -> float:
    x, y = points.T
    return 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _areas(mesh) -> dict[str, float]:
    one = ng.CF(1)
    return {name: ng.Integrate(one, mesh, definedon=mesh.Materials(name)) for name in set(mesh.GetMaterials())}


def test_polyline_outline_from_a_csv(tmp_path):
    path = tmp_path / "outline.csv"
    np.savetxt(path, np.array(BUMP), delimiter=",")
    interface = Interface.polyline(np.loadtxt(path, delimiter=","))
    outline = Outline.of(interface, nodes=31).interface()
    assert len(outline.points) == 31
    np.testing.assert_array_equal(outline.points[[0, -1]], np.array(BUMP)[[0, -1]])
    np.testing.assert_array_equal(Outline.of(interface, nodes=None).interface().points, np.array(BUMP))


def test_outline_in_the_mesh_to_the_area():
    outline = Outline(BUMP, spline=False, nodes=21).interface()
    mesh = mesh_flow_cell(outline, COARSE, Channel(length=3.0, height=0.8))
    areas = _areas(mesh)
    np.testing.assert_allclose(areas["solid"], _shoelace(outline.points), rtol=1e-12)
    np.testing.assert_allclose(areas["fluid"], 2.4 - areas["solid"], rtol=1e-12)


def test_layer_covers_the_floor():
    layer = Outline(((0.0, 0.2), (0.7, 0.3), (2.0, 0.1)), spline=False, nodes=None).interface()
    mesh = mesh_flow_cell(layer, MeshSize(0.3, 0.1, 0.1, 0.5))
    assert set(mesh.GetBoundaries()) == {"base", "side", "inlet", "outlet", "top", "interface"}
    np.testing.assert_allclose(_areas(mesh)["solid"], 0.5 * 0.7 * 0.5 + 0.5 * 1.3 * 0.4, rtol=1e-12)


@pytest.mark.parametrize("mirrored", [False, True])
def test_layer_that_ends_on_the_floor(mirrored):
    """It starts on one end of the channel; the floor is bare beyond its foot."""
    points = [(0.0, 0.2), (0.7, 0.3), (1.4, 0.0)]
    if mirrored:
        points = [(2.0 - x, y) for x, y in reversed(points)]
    mesh = mesh_flow_cell(Outline(tuple(points), spline=False, nodes=None).interface(), MeshSize(0.3, 0.1, 0.1, 0.5))
    assert set(mesh.GetBoundaries()) == {"base", "floor", "side", "inlet", "outlet", "top", "interface"}
    areas = _areas(mesh)
    np.testing.assert_allclose(areas["solid"], 0.5 * 0.7 * 0.5 + 0.5 * 0.7 * 0.3, rtol=1e-12)
    np.testing.assert_allclose(areas["fluid"] + areas["solid"], 2.0, rtol=1e-12)


def test_ends_within_rounding_of_the_wall_are_on_it():
    points = [(0.0, 0.2), (0.7, 0.3), (1.4, 0.0)]
    off = [(1e-12, 0.2), (0.7, 0.3), (1.4, -1e-12)]
    exact, rounded = (
        mesh_flow_cell(Outline(tuple(p), spline=False, nodes=None).interface(), COARSE) for p in (points, off)
    )
    assert rounded.GetBoundaries() == exact.GetBoundaries()
    assert (rounded.ne, rounded.nv) == (exact.ne, exact.nv)


@pytest.mark.parametrize(("inlet", "x"), [("left", 0.0), ("right", 2.0)])
def test_inlet_is_on_the_side_asked_for(inlet, x):
    mesh = mesh_flow_cell(Outline().interface(), COARSE, Channel(inlet=inlet))
    at = {mesh.vertices[v.nr].point[0] for e in mesh.Elements(ng.BND) if e.mat == "inlet" for v in e.vertices}
    assert at == {x}


def test_three_parts_fill_the_specimen_and_are_numbered_as_in_the_study():
    outline = Outline().interface()
    areas = _areas(mesh_flow_cell(outline, COARSE, Channel(), THREE))
    parts = [areas[f"solid{k}"] for k in (1, 2, 3)]
    np.testing.assert_allclose(sum(parts), _shoelace(outline.points), rtol=1e-12)
    assert np.argmax(parts) == 1
    assert set(areas) == {"fluid", "solid1", "solid2", "solid3"}
    mesh = mesh_flow_cell(outline, COARSE, Channel(), THREE)
    heights = {}
    for element in mesh.Elements(ng.VOL):
        y = np.mean([mesh.vertices[v.nr].point[1] for v in element.vertices])
        heights.setdefault(element.mat, []).append(y)
    assert max(heights["solid3"]) < min(np.mean(heights["solid1"]), np.mean(heights["solid2"]))


def test_cutting_keeps_areas_and_shares_vertices():
    figure = Subdivision([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], {"solid": [0, 1, 2, 3]})
    parts = figure.cut(["solid"], ((-1.0, 0.3), (2.0, 0.6)))
    parts = figure.cut(parts, ((0.5, -1.0), (0.5, 2.0)))
    assert len(parts) == 4
    np.testing.assert_allclose(sum(figure.area(name) for name in parts), 1.0, rtol=1e-14)
    assert all(figure.area(name) > 0 for name in parts)
    inner = [edge for edge in figure.edges() if edge.right is not None]
    assert len(inner) == 4  # two cuts, each halved by the other
    assert figure.cut(parts, ((0.6, 0.7), (0.8, 0.9))) == parts  # does not reach from side to side


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (((0.5, 0.0), (0.6, 1.2), (1.2, 0.0)), r"outside the channel.*\(0.6, 1.2\)"),
        (((0.5, 0.1), (0.6, 0.3), (1.2, 0.0)), r"end of the outline.*\(0.5, 0.1\)"),
        (((1.2, 0.0), (0.6, 0.3), (0.5, 0.0)), r"direction.*\(1.2, 0\)"),
        (((0.5, 0.0), (0.6, -0.1), (1.2, 0.0)), r"outside the channel.*\(0.6, -0.1\)"),
        (((0.5, 0.0), (1.0, 0.4), (0.6, 0.4), (1.1, 0.1), (1.2, 0.0)), "cross"),
        (((0.5, 0.0), (2.5, 0.4), (2.6, 0.0)), "outline"),
    ],
)
def test_bad_outlines_are_refused_with_the_place(points, message):
    with pytest.raises(InvalidInput, match=message):
        check_outline(Interface.polyline(np.array(points)), Channel())


@pytest.mark.parametrize(
    "options",
    [{"points": ((0.5, 0.0), (1.2, 0.0))}, {"nodes": 3}, {"nodes": None, "spline": True}],
)
def test_degenerate_descriptions_are_refused(options):
    with pytest.raises(InvalidInput):
        Outline(**options)


@pytest.mark.parametrize("options", [{"length": 0.0}, {"height": float("nan")}, {"height": float("inf")}])
def test_bad_channels_are_refused(options):
    with pytest.raises(InvalidInput, match=next(iter(options))):
        Channel(**options)


@pytest.mark.parametrize(
    "markers",
    [
        THREE.markers[:2],
        (*THREE.markers[:2], (0.1, 0.9)),
        (THREE.markers[0], THREE.markers[0], THREE.markers[2]),
    ],
)
def test_markers_must_name_each_part_once(markers):
    with pytest.raises(InvalidInput, match="marker"):
        subdivide(Outline().interface(), Channel(), Partition(THREE.lines, markers))
