"""Interfaces in meshes; meshio writes the files, the shapes are known."""

import sys

import meshio
import numpy as np
import pytest
from tests.unit.readers.reads import read, refused

from strandline.foundations import InvalidInput
from strandline.readers import READERS, Unreadable
from strandline.readers.cells import Chain, _directed
from strandline.readers.vtk_xml import _parts

NX, NY = 4, 2
TOP = np.stack([np.arange(NX + 1.0), np.full(NX + 1, float(NY))], axis=1)
BENT = TOP + np.stack([np.zeros(NX + 1), 0.2 * np.arange(NX + 1.0)], axis=1)
TETRA = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
LINE = {"cells": {"region": 7}}
VTP_ASCII = """<VTKFile type="PolyData" version="0.1"><PolyData>
<Piece NumberOfPoints="4" NumberOfVerts="1" NumberOfLines="2" NumberOfPolys="0">
<Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 2 1 0 3 1 0</DataArray></Points>
<Verts><DataArray type="Int32" Name="connectivity">0</DataArray><DataArray type="Int32" Name="offsets">1</DataArray>
</Verts>
<Lines><DataArray type="Int32" Name="connectivity">3 2 0 1 2</DataArray>
<DataArray type="Int32" Name="offsets">2 5</DataArray></Lines>
<CellData><DataArray type="Int32" Name="part">0 1 2</DataArray></CellData>
</Piece></PolyData></VTKFile>"""


def grid(kind="triangle"):
    """A rectangle 4 by 2 of triangles or quads, its region 1 below, 2 above; line cells along its top, shuffled."""
    x, y = np.meshgrid(np.arange(NX + 1.0), np.arange(NY + 1.0))
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    corner = np.array([j * (NX + 1) + i for j in range(NY) for i in range(NX)])
    cells, region = corner[:, None] + np.array([0, 1, NX + 2, NX + 1]), np.repeat([1, 2], NX)
    if kind == "triangle":
        cells, region = np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]]), np.concatenate([region, region])
    top = NY * (NX + 1) + np.arange(NX)
    lines = np.stack([top, top + 1], axis=1)[[2, 0, 3, 1]]
    lines[0] = lines[0, ::-1]
    moved = np.stack([0 * points[:, 0], 0.1 * points[:, 0] * points[:, 1], 0 * points[:, 0]], axis=1)
    return meshio.Mesh(
        points,
        [(kind, cells), ("line", lines)],
        point_data={"du": moved, "top": (points[:, 1] == NY).astype(float)},
        cell_data={"region": [region, np.full(NX, 7)]},
    )


def vtu(folder, mesh, **options):
    path = folder / "mesh.vtu"
    meshio.vtu.write(str(path), mesh, **options)
    return path


def cells_of(folder, points, kind, cells):
    return vtu(folder, meshio.Mesh(np.array(points, float), [(kind, cells)]))


def pvd(folder):
    """Write a series of three times, at which the displacements are 0, 1 and 2 times those of the grid."""
    entries, mesh = "", grid()
    (folder / "steps").mkdir(exist_ok=True)
    for k in range(3):
        mesh.point_data["du"] = k * grid().point_data["du"]
        meshio.vtu.write(str(folder / "steps" / f"{k}.vtu"), mesh)
        entries += f'<DataSet timestep="{k}.0" part="0" file="steps/{k}.vtu"/>'
    path = folder / "series.pvd"
    path.write_text(f'<?xml version="1.0"?><VTKFile type="Collection"><Collection>{entries}</Collection></VTKFile>')
    return path


def test_line_cells_in_any_order_with_a_displacement(tmp_path):
    for options in ({"binary": False}, {"compression": None}, {"compression": "zlib"}, {"compression": "lzma"}):
        found = read(vtu(tmp_path, grid(), **options), **LINE, field="du", start=[0, 2])
        np.testing.assert_array_equal(found.points, BENT)
        assert not found.closed
    for suffix in (".xdmf", ".xmf"):
        meshio.xdmf.write(str(tmp_path / f"mesh{suffix}"), grid(), data_format="XML")
        found = read(tmp_path / f"mesh{suffix}", **LINE, field="du", start=[0, 2])
        np.testing.assert_array_equal(found.points, BENT)
    for suffix in (".vtu", ".vtk"):
        meshio.write(str(tmp_path / f"mesh{suffix}"), grid())
        found = read(tmp_path / f"mesh{suffix}", **LINE, start=[4000, 2000], unit="m")
        np.testing.assert_array_equal(found.points, TOP[::-1] * 1000)
    path = tmp_path / "line.vtp"
    path.write_text(VTP_ASCII)
    np.testing.assert_array_equal(read(path, start=[0, 0]).points, [[0, 0], [1, 0], [2, 1], [3, 1]])
    np.testing.assert_array_equal(read(path, cells={"part": 2}).points, [[0, 0], [1, 0], [2, 1]])


def test_the_boundary_of_a_region_is_closed_and_counter_clockwise(tmp_path):
    for kind in ("triangle", "quad"):
        found = read(vtu(tmp_path, grid(kind)), cells={"region": 2}, start=[0, 1])
        assert found.closed
        assert len(found.points) == 2 * NX + 2
        assert found.lengths.sum() == pytest.approx(2 * NX + 2)
        np.testing.assert_array_equal(found.points[:3], [[0, 1], [1, 1], [2, 1]])


def test_a_box_and_point_data_choose_a_part_of_a_boundary(tmp_path):
    path = vtu(tmp_path, grid())
    for part in ({"block": "triangle", "select": {"y": [1.9, 2.1]}}, {"block": 0, "points": {"top": 1}}):
        np.testing.assert_array_equal(read(path, **part, field="du", start=[0, 2]).points, BENT)


def test_quadratic_cells_keep_their_middle_nodes(tmp_path):
    points = np.array(
        [[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 0.1, 0], [1.2, 1.2, 0], [0, 1, 0], [3, 0, 0], [2.5, 0.1, 0]]
    )
    for kind, cells, order in (
        ("triangle6", [[0, 1, 2, 3, 4, 5]], [0, 3, 1, 4, 2, 5]),
        ("line3", [[1, 6, 7], [0, 1, 3]], [0, 3, 1, 7, 6]),
    ):
        found = read(cells_of(tmp_path, points, kind, cells), start=[0, 0])
        np.testing.assert_array_equal(found.points, points[order, :2])


def test_another_plane(tmp_path):
    mesh = grid()
    mesh.points = mesh.points[:, [0, 2, 1]]
    path = vtu(tmp_path, mesh)
    np.testing.assert_array_equal(read(path, **LINE, plane="xz", start=[0, 2]).points, TOP)
    refused("leaves its plane", path, cells={"region": [7]}, block="line", plane="yz")


def test_pieces_and_branches_are_refused_with_their_places_or_one_piece_is_chosen(tmp_path):
    points = [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 1, 0], [5.5, 1, 0]]
    path = cells_of(tmp_path, points, "line", [[3, 4], [1, 2], [0, 1]])
    refused(r"in 2 pieces: got \(0, 0\) to \(2, 0\), \(5, 1\) to \(5\.5, 1\) mm", path)
    assert read(path, keep="longest").points[-1].tolist() == [2.0, 0.0]
    assert read(path, near=[5, 0.9]).points.tolist() == [[5.0, 1.0], [5.5, 1.0]]
    same = cells_of(tmp_path, [*points[:3], [5, 1, 0], [6, 1 + 1e-9, 0]], "line", [[3, 4], [1, 2]])
    refused("2 of the same size.*instead", same, keep="longest")
    points = [[0.0, 0, 0], [1, 0, 0], [2, 0.5, 0], [2, -0.5, 0]]
    path = cells_of(tmp_path, points, "line", [[0, 1], [1, 2], [1, 3]])
    refused(r"branches at \(1, 0\) mm: got 3 segments", path)
    points = np.array([[float(k), 0.1 * k * k, 0] for k in range(5)])  # most cells give the direction
    found = read(cells_of(tmp_path, points, "line", [[1, 0], [2, 1], [2, 3], [4, 3]]))
    np.testing.assert_array_equal(found.points, points[::-1, :2])


def assert_outward(found, *, area):
    assert found.closed
    assert found.areas.sum() == pytest.approx(area)
    assert (found.normals * (found.centres - found.points.mean(axis=0))).sum(axis=1).min() > 0


CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
SIDES = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
TETRA_AREA = 1.5 + np.sqrt(3) / 2
SOLIDS = [
    ("tetra", TETRA, TETRA_AREA),
    ("tetra10", np.concatenate([TETRA, TETRA[np.array(SIDES)].mean(axis=1)]), TETRA_AREA),
    ("hexahedron", CUBE, 6.0),
    ("hexahedron20", np.concatenate([CUBE, CUBE[np.array(EDGES)].mean(axis=1)]), 6.0),
    ("wedge", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], float), 3 + np.sqrt(2)),
    ("pyramid", np.concatenate([CUBE[:4], [[0.5, 0.5, 0.5]]]), 1 + np.sqrt(2)),
]


def test_surfaces_and_all_faces_of_solids_face_outwards(tmp_path):
    for suffix in (".stl", ".ply", ".vtu"):
        path = tmp_path / f"surface{suffix}"
        meshio.write_points_cells(str(path), TETRA, [("triangle", FACES)])
        found = read(path, unit="um")
        assert len(found.points) == 4
        assert_outward(found, area=TETRA_AREA * 1e-6)
    for kind, points, area in SOLIDS:
        assert_outward(read(cells_of(tmp_path, points, kind, [list(range(len(points)))])), area=area)
    points = np.concatenate([CUBE, CUBE[4:] + np.array([0, 0, 1])])
    two = read(cells_of(tmp_path, points, "hexahedron", [list(range(8)), list(range(4, 12))]))
    assert two.areas.sum() == pytest.approx(10.0)  # without the face between them


@pytest.mark.parametrize("data_format", ["XML", "HDF", "pvd"])
def test_times_of_a_series(tmp_path, data_format, monkeypatch):
    mesh, path, options = grid(), tmp_path / "series.xdmf", {"block": "line"}
    monkeypatch.chdir(tmp_path)
    if data_format == "pvd":
        path, options = pvd(tmp_path), LINE
    else:
        with meshio.xdmf.TimeSeriesWriter("series.xdmf", data_format=data_format) as writer:
            writer.write_points_cells(mesh.points, mesh.cells[1:])
            for at in (0.0, 1.0, 2.0):
                writer.write_data(at, point_data={"du": at * mesh.point_data["du"]})
    for time, factor in ((None, 2.0), ("last", 2.0), ({"index": 0}, 0.0), ({"value": 1.0}, 1.0)):
        found = read(path, **options, field="du", start=[0, 2], time=time)
        np.testing.assert_allclose(found.points, TOP + factor * (BENT - TOP), rtol=1e-15)
    for time in ({"index": 3}, {"value": 1.5}):
        refused("has no time of .*: got 3 times from 0 to 2", path, time=time)


def test_a_series_does_not_lead_out_of_its_folder(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "link").symlink_to(tmp_path)
    meshio.vtu.write(str(tmp_path / "other.vtu"), grid())
    for source in ("../other.vtu", "/etc/hostname", "link/other.vtu"):
        text = f'<VTKFile><Collection><DataSet timestep="0" file="{source}"/></Collection></VTKFile>'
        (inner / "series.pvd").write_text(text)
        refused("outside of its folder", inner / "series.pvd")


def test_parallel_pieces_are_joined_without_a_seam(tmp_path):
    mesh, pieces = grid("quad"), ""
    for k, half in enumerate(np.split(mesh.cells[0].data, 2)):
        used = np.unique(half)
        part = meshio.Mesh(mesh.points[used], [("quad", np.searchsorted(used, half))])
        meshio.vtu.write(str(tmp_path / f"p{k}.vtu"), part)
        pieces += f'<Piece Source="p{k}.vtu"/>'
    root = "PUnstructuredGrid"
    (tmp_path / "all.pvtu").write_text(f'<VTKFile type="{root}"><{root}>{pieces}</{root}></VTKFile>')
    found = read(tmp_path / "all.pvtu")
    assert found.closed
    assert found.lengths.sum() == pytest.approx(2 * (NX + NY))


def whole_file(folder, suffix):
    path = folder / f"mesh{suffix}"
    if suffix == ".pvd":
        return pvd(folder)
    if suffix == ".vtp":
        path.write_text(VTP_ASCII)
    elif suffix in (".xdmf", ".xmf"):
        meshio.xdmf.write(str(path), grid(), data_format="XML")
    elif suffix == ".msh":
        meshio.gmsh.write(str(path), grid(), fmt_version="2.2")
    elif suffix in (".stl", ".ply"):
        meshio.write_points_cells(str(path), TETRA, [("triangle", FACES)])
    else:
        meshio.write(str(path), grid())
    return path


GARBAGE = [bytes(range(256)) * 8, b"<VTKFile/>", b"solid nothing\nendsolid nothing\n"]
OTHERS = {".csv", ".tsv", ".txt", ".dat", ".npy", ".pvtu", ".pvtp", ".frd", ".json", ".geojson"}


@pytest.mark.parametrize("suffix", sorted(set(READERS) - OTHERS))
def test_damaged_files_are_one_clear_error(tmp_path, suffix, capsys):
    path = whole_file(tmp_path, suffix)
    whole = path.read_bytes()
    for content in (*(whole[: int(share * len(whole))] for share in (0.0, 0.2, 0.6, 0.97)), *GARBAGE):
        path.write_bytes(content)
        with pytest.raises(Unreadable, match=path.name) as caught:
            read(path)
        assert "\n" not in str(caught.value)
        assert caught.value.kind in ("result_unreadable", "invalid_interface")
    assert capsys.readouterr().out == ""


def test_selections_that_are_not_there_and_numbers_that_are_not_finite(tmp_path):
    mesh = grid()
    mesh.point_data["du"][NX + 1 + NX + 1 + 1, 1] = np.nan
    path = vtu(tmp_path, mesh)
    for options, words in (
        ({"cells": {"regoin": 7}}, "no cell data regoin: got region"),
        ({"field": "v", "block": "line"}, "no point data v: got"),
        ({"field": "top", "block": "line"}, "expected one vector per point"),
        ({**LINE, "count": 9}, "number of points: got 5; expected 9"),
    ):
        refused(words, path, **options)
    refused("not finite", path, "non_finite", **LINE, field="du")


def test_a_missing_extra_names_its_command(tmp_path, monkeypatch):
    path = tmp_path / "surface.stl"
    meshio.write_points_cells(str(path), TETRA, [("triangle", FACES[:1])])
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(
        InvalidInput, match=r'surface\.stl: got no module meshio.*pip install "strandline\[vtu\]"'
    ) as caught:
        read(path)
    assert not isinstance(caught.value, Unreadable)
    vtp = tmp_path / "line.vtp"
    vtp.write_text(VTP_ASCII)
    assert len(read(vtp, keep="longest").points) == 4  # VTK's own formats need no extra


def test_a_chain_runs_as_most_of_its_edges_do():
    chain = Chain(np.arange(6), closed=False)
    for forward, nodes in (({(0, 1), (1, 2)}, [5, 4, 3, 2, 1, 0]), ({(0, 1), (1, 2), (3, 4)}, [0, 1, 2, 3, 4, 5])):
        assert _directed(chain, forward).nodes.tolist() == nodes


def test_values_of_cells_are_numbers_all_of_them(tmp_path):
    with pytest.raises(InvalidInput, match=r"cells.*the name of data with a number"):
        read(tmp_path / "a.vtu", cells={"region": (1, "x")})


def test_a_polygon_is_a_fan_of_triangles():
    kind, found = _parts(7, np.array([4, 5, 6, 7, 8]))
    assert (kind, np.array(found).tolist()) == ("triangle", [[4, 5, 6], [4, 6, 7], [4, 7, 8]])


def test_a_small_outline_runs_counter_clockwise(tmp_path):
    corners = 0.1 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    x, y = read(cells_of(tmp_path, corners, "quad", np.array([[0, 1, 2, 3]]))).points.T
    assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) == pytest.approx(0.02)
