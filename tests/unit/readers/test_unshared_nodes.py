"""Meshes whose cells have nodes of their own, and parts of surfaces."""

import meshio
import numpy as np
import pytest
from tests.unit.readers.reads import read, refused

CUBE = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
TETRA = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])


def written(path, points, kind, cells):
    meshio.write(path, meshio.Mesh(points, [(kind, cells)]))
    return path


@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("shaken", [0.0, 1e-13])
def test_inner_faces_are_no_surface_if_each_cell_repeats_its_nodes(tmp_path, inside_out, shaken):
    cells = TETRA[:, [0, 2, 1, 3]] if inside_out else TETRA
    points = CUBE[cells.ravel()] + shaken * np.random.default_rng(0).standard_normal((24, 3))
    found = read(written(tmp_path / "a.vtu", points, "tetra", np.arange(24).reshape(-1, 4)))
    assert (found.closed, len(found.points)) == (True, 8)
    assert found.areas.sum() == pytest.approx(6.0)
    middle = found.centres - 0.5
    assert (np.sum(middle * found.normals, axis=1) > 0).all()


@pytest.mark.parametrize(("apart", "area"), [(0.0, 10.0), (0.2, 12.0)])
def test_parts_that_repeat_the_nodes_between_them_are_one_unless_they_come_apart(tmp_path, apart, area):
    beside = CUBE + np.array([1, 0, 0])
    mesh = meshio.Mesh(np.concatenate([CUBE, beside]), [("tetra", np.concatenate([TETRA, TETRA + 8]))])
    mesh.point_data["u"] = np.repeat([[0.0, 0, 0], [apart, 0, 0]], 8, axis=0)
    meshio.write(tmp_path / "a.vtu", mesh)
    found = read(tmp_path / "a.vtu", field="u", **({"near": [0, 0, 0]} if apart else {}))
    assert (found.closed, found.areas.sum()) == (True, pytest.approx(area / (1 + (apart > 0))))


def test_a_repeated_node_rounded_otherwise_is_no_crack(tmp_path):
    triangles = CUBE.astype(np.float32)[[[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]]]
    triangles = np.concatenate([triangles, np.float32(1) - triangles])[[0, 1, 2, 3, 4, 5, 10, 11]]
    more = CUBE.astype(np.float32)[[[0, 4, 2], [4, 6, 2], [1, 3, 5], [3, 7, 5]]]
    points = np.concatenate([triangles, more]).reshape(-1, 3) + np.float32(1)
    points[4] = np.nextafter(points[4], np.float32(9))
    found = read(written(tmp_path / "a.stl", points, "triangle", np.arange(36).reshape(-1, 3)))
    assert len(found.points) == 8


def test_a_repeated_node_that_is_not_finite_is_named(tmp_path):
    points = CUBE[TETRA.ravel()]
    points[5] = np.nan
    path = written(tmp_path / "a.vtu", points, "tetra", np.arange(24).reshape(-1, 4))
    refused("the point with the number 6, counted from 1, is not finite", path, "non_finite")


def test_near_and_keep_choose_a_part_of_a_surface(tmp_path):
    points = np.concatenate([CUBE[[0, 1, 2, 4]], 2.0 * CUBE[[0, 1, 2, 4]] + 5.0])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    path = written(tmp_path / "a.stl", points, "triangle", np.concatenate([faces, faces + 4]))
    refused(r"2 surfaces apart.*`keep: longest`.*`near: \[x, y, z\]`", path)
    assert read(path, keep="longest").points.min() == 5.0
    assert read(path, near=[0, 0, 0]).points.max() == 1.0
    points[4:] = points[:4] + 7.1
    path = written(tmp_path / "a.stl", points, "triangle", np.concatenate([faces, faces + 4]))
    refused(r"`keep: longest` fits several pieces: got 2 of the same size.*`near: \[x, y\]`", path, keep="longest")
    assert read(path, near=[0, 0, 0]).points.max() == 1.0
