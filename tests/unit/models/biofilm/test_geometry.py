"""Outlines, channels, partitions and their meshes; element sizes in narrow gaps and at sharp bends."""

import ngsolve as ng
import numpy as np
import pytest
from tests.unit.models.biofilm.cells import LAYER

from strandline.models.biofilm.mesh import geometry
from strandline.models.biofilm.mesh.geometry import (
    MESHES,
    MeshSize,
    Partition,
    is_adapted,
    mesh_flow_cell,
    segment_sizes,
)
from strandline.models.biofilm.mesh.outline import Channel, Outline

COARSE, ROUGH = MESHES["coarse"], MeshSize(0.3, 0.1, 0.1, 0.5)
STUDY = Outline().interface()
CHANNEL = Channel()
THREE = Partition.PRESETS["three_parts"]
BUMP = ((0.5, 0.0), (0.6, 0.3), (0.9, 0.35), (1.2, 0.0))
BOUNDARIES = {"base", "side", "inlet", "outlet", "top", "interface"}


def polygon(*points):
    return Outline(tuple(points), spline=False, nodes=None).interface()


def shoelace(points):
    x, y = points.T
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


def areas(mesh):
    one = ng.CF(1)
    return {name: ng.Integrate(one, mesh, definedon=mesh.Materials(name)) for name in set(mesh.GetMaterials())}


def points_on(mesh, boundary):
    numbers = {v.nr for e in mesh.Elements(ng.BND) if e.mat == boundary for v in e.vertices}
    return np.array([mesh.vertices[nr].point for nr in numbers])


def arrays(mesh):
    points = np.array([vertex.point for vertex in mesh.vertices])
    corners = np.array([[vertex.nr for vertex in element.vertices] for element in mesh.Elements(ng.VOL)])
    return points.tobytes() + corners.tobytes()


def test_an_outline_is_kept_or_gets_nodes_between_its_ends_and_has_its_area_in_the_mesh():
    np.testing.assert_array_equal(Outline(BUMP, spline=False, nodes=None).interface().points, BUMP)
    outline = Outline(BUMP, spline=False, nodes=31).interface()
    assert len(outline.points) == 31
    np.testing.assert_array_equal(outline.points[[0, -1]], [BUMP[0], BUMP[-1]])
    found = areas(mesh_flow_cell(outline, COARSE, Channel(length=3.0, height=0.8)))
    np.testing.assert_allclose(found["solid"], shoelace(outline.points), rtol=1e-12)
    np.testing.assert_allclose(found["fluid"], 2.4 - found["solid"], rtol=1e-12)


def test_a_layer_may_cover_the_floor_or_end_on_it():
    """It starts on one end of the channel; the floor is bare beyond its foot. Ends close to a wall are on it."""
    points, whole = [(0.0, 0.2), (0.7, 0.3), (1.4, 0.0)], [(0.0, 0.2), (0.7, 0.3), (2.0, 0.1)]
    off, turned = [(1e-12, 0.2), (0.7, 0.3), (1.4, -1e-12)], [(2.0 - x, y) for x, y in reversed(points)]
    for given in (points, off, turned, whole):
        mesh = mesh_flow_cell(polygon(*given), ROUGH)
        assert set(mesh.GetBoundaries()) == BOUNDARIES | (set() if given is whole else {"floor"})
        found, rest = areas(mesh), 0.5 * 1.3 * 0.4 if given is whole else 0.5 * 0.7 * 0.3
        np.testing.assert_allclose(found["solid"], 0.5 * 0.7 * 0.5 + rest, rtol=1e-9)
        np.testing.assert_allclose(found["fluid"] + found["solid"], 2.0, rtol=1e-12)


def test_three_parts_fill_the_specimen_and_are_numbered_as_in_the_study():
    mesh = mesh_flow_cell(STUDY, COARSE, CHANNEL, THREE)
    found = areas(mesh)
    assert set(found) == {"fluid", "solid1", "solid2", "solid3"}
    parts = [found[f"solid{k}"] for k in (1, 2, 3)]
    np.testing.assert_allclose(sum(parts), shoelace(STUDY.points), rtol=1e-12)
    assert np.argmax(parts) == 1
    heights = {name: [] for name in found}
    for element in mesh.Elements(ng.VOL):
        heights[element.mat].append(np.mean([mesh.vertices[v.nr].point[1] for v in element.vertices]))
    assert max(heights["solid3"]) < min(np.mean(heights["solid1"]), np.mean(heights["solid2"]))


@pytest.mark.parametrize(("name", "partition"), [("coarse", THREE), ("default", Partition())])
def test_the_meshes_of_the_study_are_those_of_fixed_sizes(name, partition, monkeypatch):
    """To the bit, in each run: `posterior.nc` of the published studies depends on it."""
    size = MESHES[name]
    found = arrays(mesh_flow_cell(STUDY, size, CHANNEL, partition))
    fixed = np.full(65, size.interface)
    fixed[[0, -1]] = size.foot
    monkeypatch.setattr(geometry, "segment_sizes", lambda interface, size: fixed)
    monkeypatch.setattr(geometry, "gap_sizes", lambda interface, size, channel: np.empty((0, 3)))
    assert arrays(mesh_flow_cell(STUDY, size, CHANNEL, partition)) == found
    assert not is_adapted(STUDY, size, CHANNEL)


@pytest.mark.parametrize("name", ["coarse", "default"])
def test_a_narrow_gap_has_elements_across(name):
    """As many as half a millimetre would have without the rule, and four at least."""
    slit = Outline(((0.0, 0.8), (1.0, 0.8), (2.0, 0.8)), spline=False).interface()
    top = np.sort(points_on(mesh_flow_cell(slit, MESHES[name], CHANNEL), "top")[:, 0])
    assert np.diff(top).max() <= 1.2 * 0.2 * min(0.25, MESHES[name].far / 0.5)


def test_sharp_bends_have_several_elements_a_segment():
    outline = polygon((0.6, 0.0), (0.7, 0.3), (1.0, 0.4), (1.3, 0.0))
    mesh = mesh_flow_cell(outline, COARSE, CHANNEL)
    vertices = np.array([v.point for v in mesh.vertices])
    start, end = outline.points[1:3]
    along = (vertices - start) @ (end - start) / np.sum((end - start) ** 2)
    (dx, dy), (x, y) = end - start, (vertices - start).T
    on = (np.abs(dx * y - dy * x) < 1e-9) & (along > -1e-9) & (along < 1 + 1e-9)
    assert on.sum() >= 5
    np.testing.assert_array_equal(segment_sizes(LAYER.interface(), COARSE)[1:-1], COARSE.interface)
