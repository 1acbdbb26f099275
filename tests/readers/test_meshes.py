"""Interfaces in meshes; meshio writes the files, the shapes are known."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.readers import READERS, Reading, Unreadable, read_interface

NX, NY = 4, 2


def read(path: Path, **options: Any) -> Interface:
    return read_interface(path, Reading.from_options({"file": path.name, "unit": "mm", **options}, "result"))


def grid(kind: str = "triangle") -> meshio.Mesh:
    """A rectangle 4 by 2 of triangles or quads, its region 1 below, 2 above; line cells along its top, shuffled."""
    x, y = np.meshgrid(np.arange(NX + 1.0), np.arange(NY + 1.0))
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    corner = np.array([j * (NX + 1) + i for j in range(NY) for i in range(NX)])
    quads = corner[:, None] + np.array([0, 1, NX + 2, NX + 1])
    region = np.repeat([1, 2], NX)
    if kind == "triangle":
        cells = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        region = np.concatenate([region, region])
    else:
        cells = quads
    top = NY * (NX + 1) + np.arange(NX)
    lines = np.stack([top, top + 1], axis=1)[[2, 0, 3, 1]]
    lines[0] = lines[0, ::-1]
    moved = np.stack([0 * points[:, 0], 0.1 * points[:, 0] * points[:, 1], 0 * points[:, 0]], axis=1)
    return meshio.Mesh(
        points,
        [(kind, cells), ("line", lines)],
        point_data={"u": moved, "top": (points[:, 1] == NY).astype(float)},
        cell_data={"region": [region, np.full(NX, 7)]},
    )


TOP = np.stack([np.arange(NX + 1.0), np.full(NX + 1, float(NY))], axis=1)
BENT = TOP + np.stack([np.zeros(NX + 1), 0.2 * np.arange(NX + 1.0)], axis=1)


def vtu(tmp_path: Path, mesh: meshio.Mesh, **options: Any) -> Path:
    path = tmp_path / "mesh.vtu"
    meshio.vtu.write(str(path), mesh, **options)
    return path


@pytest.mark.parametrize(
    "options",
    [{"binary": False}, {"binary": True, "compression": None}, {"binary": True, "compression": "zlib"},
     {"binary": True, "compression": "lzma"}],
    ids=["ascii", "base64", "zlib", "lzma"],
)  # fmt: skip
def test_line_cells_in_any_order_with_a_displacement(tmp_path: Path, options: dict[str, Any]) -> None:
    found = read(vtu(tmp_path, grid(), **options), cells={"region": 7}, field="u", start=[0, 2])
    np.testing.assert_array_equal(found.points, BENT)
    assert not found.closed


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
def test_formats_of_meshes(tmp_path: Path, suffix: str) -> None:
    path, mesh = tmp_path / f"mesh{suffix}", grid()
    meshio.write(str(path), mesh)
    found = read(path, cells={"region": 7}, start=[4000, 2000], unit="m")
    np.testing.assert_array_equal(found.points, TOP[::-1] * 1000)


@pytest.mark.parametrize("kind", ["triangle", "quad"])
def test_the_boundary_of_a_region_is_closed_and_counter_clockwise(tmp_path: Path, kind: str) -> None:
    found = read(vtu(tmp_path, grid(kind)), cells={"region": 2}, start=[0, 1])
    assert found.closed
    assert len(found.points) == 2 * NX + 2
    assert found.lengths.sum() == pytest.approx(2 * NX + 2)
    np.testing.assert_array_equal(found.points[:3], [[0, 1], [1, 1], [2, 1]])


def test_a_box_and_point_data_choose_a_part_of_a_boundary(tmp_path: Path) -> None:
    path = vtu(tmp_path, grid())
    by_box = read(path, block="triangle", select={"y": [1.9, 2.1]}, field="u", start=[0, 2])
    by_data = read(path, block=0, points={"top": 1}, field="u", start=[0, 2])
    np.testing.assert_array_equal(by_box.points, BENT)
    np.testing.assert_array_equal(by_data.points, BENT)


def test_quadratic_cells_keep_their_middle_nodes(tmp_path: Path) -> None:
    points = np.array(
        [[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 0.1, 0], [1.2, 1.2, 0], [0, 1, 0], [3, 0, 0], [2.5, 0.1, 0]]
    )
    mesh = meshio.Mesh(points, [("triangle6", [[0, 1, 2, 3, 4, 5]])])
    found = read(vtu(tmp_path, mesh), start=[0, 0])
    np.testing.assert_array_equal(found.points, points[[0, 3, 1, 4, 2, 5], :2])
    lines = meshio.Mesh(points, [("line3", [[1, 6, 7], [0, 1, 3]])])
    np.testing.assert_array_equal(read(vtu(tmp_path, lines), start=[0, 0]).points, points[[0, 3, 1, 7, 6], :2])


def test_another_plane(tmp_path: Path) -> None:
    mesh = grid()
    mesh.points = mesh.points[:, [0, 2, 1]]
    path = vtu(tmp_path, mesh)
    np.testing.assert_array_equal(read(path, cells={"region": 7}, plane="xz", start=[0, 2]).points, TOP)
    with pytest.raises(Unreadable, match="leaves its plane"):
        read(path, cells={"region": [7]}, block="line", plane="yz")


def pieces(tmp_path: Path) -> Path:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 1, 0], [5.5, 1, 0]])
    return vtu(tmp_path, meshio.Mesh(points, [("line", [[3, 4], [1, 2], [0, 1]])]))


def test_pieces_are_refused_with_their_places_or_one_is_chosen(tmp_path: Path) -> None:
    path = pieces(tmp_path)
    with pytest.raises(Unreadable, match=r"in 2 pieces: got \(0, 0\) to \(2, 0\), \(5, 1\) to \(5\.5, 1\) mm"):
        read(path)
    assert read(path, keep="longest").points[-1].tolist() == [2.0, 0.0]
    assert read(path, near=[5, 0.9]).points.tolist() == [[5.0, 1.0], [5.5, 1.0]]


def test_a_branch_is_refused_with_its_place(tmp_path: Path) -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0.5, 0], [2, -0.5, 0]])
    path = vtu(tmp_path, meshio.Mesh(points, [("line", [[0, 1], [1, 2], [1, 3]])]))
    with pytest.raises(Unreadable, match=r"branches at \(1, 0\) mm: got 3 segments"):
        read(path)


def test_most_line_cells_give_the_direction(tmp_path: Path) -> None:
    points = np.array([[float(k), 0.1 * k * k, 0] for k in range(5)])
    mesh = meshio.Mesh(points, [("line", [[1, 0], [2, 1], [2, 3], [4, 3]])])
    np.testing.assert_array_equal(read(vtu(tmp_path, mesh)).points, points[::-1, :2])


TETRA = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".vtu"])
def test_surfaces(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"surface{suffix}"
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    meshio.write_points_cells(str(path), TETRA, [("triangle", faces)])
    found = read(path, unit="um")
    assert found.closed
    assert len(found.points) == 4
    assert found.areas.sum() == pytest.approx((1.5 + np.sqrt(3) / 2) * 1e-6)
    assert (found.normals * (found.centres - found.points.mean(axis=0))).sum(axis=1).min() > 0


@pytest.mark.parametrize(
    ("kind", "extra"),
    [("tetra", []), ("tetra10", [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])],
)
def test_the_boundary_of_solids_faces_outwards(tmp_path: Path, kind: str, extra: list[tuple[int, int]]) -> None:
    points = np.concatenate([TETRA, [(TETRA[a] + TETRA[b]) / 2 for a, b in extra]]) if extra else TETRA
    path = vtu(tmp_path, meshio.Mesh(points, [(kind, [list(range(len(points)))])]))
    assert_outward(read(path), area=1.5 + np.sqrt(3) / 2)


CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]


@pytest.mark.parametrize(
    ("kind", "points", "area"),
    [
        ("hexahedron", CUBE, 6.0),
        ("hexahedron20", np.concatenate([CUBE, [(CUBE[a] + CUBE[b]) / 2 for a, b in EDGES]]), 6.0),
        ("wedge", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], float), 3 + np.sqrt(2)),
        ("pyramid", np.concatenate([CUBE[:4], [[0.5, 0.5, 0.5]]]), 1 + np.sqrt(2)),
    ],
)
def test_all_faces_of_solids(tmp_path: Path, kind: str, points: Any, area: float) -> None:
    assert_outward(read(vtu(tmp_path, meshio.Mesh(points, [(kind, [list(range(len(points)))])]))), area=area)


def assert_outward(found: Interface, *, area: float) -> None:
    assert found.closed
    assert found.areas.sum() == pytest.approx(area)
    assert (found.normals * (found.centres - found.points.mean(axis=0))).sum(axis=1).min() > 0


def test_two_solids_lose_the_face_between_them(tmp_path: Path) -> None:
    points = np.concatenate([CUBE, CUBE[4:] + np.array([0, 0, 1])])
    path = vtu(tmp_path, meshio.Mesh(points, [("hexahedron", [list(range(8)), list(range(4, 12))])]))
    assert read(path).areas.sum() == pytest.approx(10.0)


@pytest.mark.parametrize("suffix", [".xdmf", ".xmf"])
def test_xdmf(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"mesh{suffix}"
    meshio.xdmf.write(str(path), grid(), data_format="XML")
    np.testing.assert_array_equal(read(path, cells={"region": 7}, field="u", start=[0, 2]).points, BENT)


TIMES: list[tuple[Any, float]] = [(None, 2.0), ("last", 2.0), ({"index": 0}, 0.0), ({"value": 1.0}, 1.0)]


@pytest.mark.parametrize(("time", "factor"), TIMES)
@pytest.mark.parametrize("data_format", ["XML", "HDF"])
def test_times_of_xdmf(
    tmp_path: Path, time: Any, factor: float, data_format: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = grid()
    monkeypatch.chdir(tmp_path)
    with meshio.xdmf.TimeSeriesWriter("series.xdmf", data_format=data_format) as writer:
        writer.write_points_cells(mesh.points, mesh.cells[1:])
        for at in (0.0, 1.0, 2.0):
            writer.write_data(at, point_data={"u": at * mesh.point_data["u"]})
    found = read(tmp_path / "series.xdmf", block="line", field="u", start=[0, 2], **({"time": time} if time else {}))
    np.testing.assert_allclose(found.points, TOP + factor * (BENT - TOP), rtol=1e-15)


def pvd(tmp_path: Path) -> Path:
    entries, mesh = [], grid()
    for k, at in enumerate((0.0, 1.0, 2.0)):
        mesh.point_data["u"] = at * grid().point_data["u"]
        (tmp_path / "steps").mkdir(exist_ok=True)
        meshio.vtu.write(str(tmp_path / "steps" / f"{k}.vtu"), mesh)
        entries.append(f'<DataSet timestep="{at}" part="0" file="steps/{k}.vtu"/>')
    path = tmp_path / "series.pvd"
    path.write_text(
        f'<?xml version="1.0"?><VTKFile type="Collection"><Collection>{"".join(entries)}</Collection></VTKFile>'
    )
    return path


@pytest.mark.parametrize(("time", "factor"), TIMES)
def test_times_of_pvd(tmp_path: Path, time: Any, factor: float) -> None:
    options = {"time": time} if time else {}
    found = read(pvd(tmp_path), cells={"region": 7}, field="u", start=[0, 2], **options)
    np.testing.assert_allclose(found.points, TOP + factor * (BENT - TOP), rtol=1e-15)


@pytest.mark.parametrize("time", [{"index": 3}, {"value": 1.5}])
def test_a_time_that_is_not_there(tmp_path: Path, time: Any) -> None:
    with pytest.raises(Unreadable, match=r"has no time of .*: got 3 times from 0 to 2"):
        read(pvd(tmp_path), time=time)


@pytest.mark.parametrize("source", ["../other.vtu", "/etc/hostname", "link/other.vtu"])
def test_a_series_does_not_lead_out_of_its_folder(tmp_path: Path, source: str) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "link").symlink_to(tmp_path)
    meshio.vtu.write(str(tmp_path / "other.vtu"), grid())
    path = inner / "series.pvd"
    path.write_text(f'<VTKFile><Collection><DataSet timestep="0" file="{source}"/></Collection></VTKFile>')
    with pytest.raises(Unreadable, match="outside of its folder"):
        read(path)


def test_parallel_pieces_are_joined_without_a_seam(tmp_path: Path) -> None:
    mesh = grid("quad")
    whole = mesh.cells[0].data
    for k, half in enumerate((whole[:NX], whole[NX:])):
        used = np.unique(half)
        part = meshio.Mesh(mesh.points[used], [("quad", np.searchsorted(used, half))])
        meshio.vtu.write(str(tmp_path / f"p{k}.vtu"), part)
    path = tmp_path / "all.pvtu"
    path.write_text(
        '<VTKFile type="PUnstructuredGrid"><PUnstructuredGrid><Piece Source="p0.vtu"/><Piece Source="p1.vtu"/>'
        "</PUnstructuredGrid></VTKFile>"
    )
    found = read(path)
    assert found.closed
    assert found.lengths.sum() == pytest.approx(2 * (NX + NY))


def truncated(whole: bytes, share: float) -> bytes:
    return whole[: int(len(whole) * share)]


DAMAGES: list[Callable[[bytes], bytes]] = [
    lambda whole: b"",
    lambda whole: truncated(whole, 0.2),
    lambda whole: truncated(whole, 0.6),
    lambda whole: truncated(whole, 0.97),
    lambda whole: bytes(range(256)) * 8,
    lambda whole: b"<VTKFile/>",
    lambda whole: b"solid nothing\nendsolid nothing\n",
]


@pytest.mark.parametrize("suffix", sorted(set(READERS) - {".csv", ".tsv", ".txt", ".dat", ".npy", ".pvtu", ".pvtp"}))
@pytest.mark.parametrize("damage", range(len(DAMAGES)))
def test_damaged_files_are_one_clear_error(
    tmp_path: Path, suffix: str, damage: int, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"mesh{suffix}"
    if suffix == ".pvd":
        path = pvd(tmp_path)
    elif suffix == ".vtp":
        path.write_text(VTP_ASCII)
    elif suffix in (".xdmf", ".xmf"):
        meshio.xdmf.write(str(path), grid(), data_format="XML")
    elif suffix in (".stl", ".ply"):
        meshio.write_points_cells(str(path), TETRA, [("triangle", [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])])
    else:
        meshio.write(str(path), grid())
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    with pytest.raises(Unreadable, match=path.name) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert caught.value.kind in ("result_unreadable", "invalid_interface")
    assert capsys.readouterr().out == ""


VTP_ASCII = """<VTKFile type="PolyData" version="0.1"><PolyData>
<Piece NumberOfPoints="4" NumberOfVerts="1" NumberOfLines="2" NumberOfPolys="0">
<Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 2 1 0 3 1 0</DataArray></Points>
<Verts><DataArray type="Int32" Name="connectivity">0</DataArray><DataArray type="Int32" Name="offsets">1</DataArray>
</Verts>
<Lines><DataArray type="Int32" Name="connectivity">3 2 0 1 2</DataArray>
<DataArray type="Int32" Name="offsets">2 5</DataArray></Lines>
<CellData><DataArray type="Int32" Name="part">0 1 2</DataArray></CellData>
</Piece></PolyData></VTKFile>"""


def test_polylines_of_vtp(tmp_path: Path) -> None:
    path = tmp_path / "line.vtp"
    path.write_text(VTP_ASCII)
    np.testing.assert_array_equal(read(path, start=[0, 0]).points, [[0, 0], [1, 0], [2, 1], [3, 1]])
    np.testing.assert_array_equal(read(path, cells={"part": 2}).points, [[0, 0], [1, 0], [2, 1]])


def test_nan_in_a_mesh(tmp_path: Path) -> None:
    mesh = grid()
    mesh.point_data["u"][NX + 1 + NX + 1 + 1, 1] = np.nan
    path = vtu(tmp_path, mesh)
    with pytest.raises(Unreadable, match="not finite") as caught:
        read(path, cells={"region": 7}, field="u")
    assert caught.value.kind == "non_finite"
    assert len(read(path, cells={"region": 7}).points) == NX + 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"cells": {"regoin": 7}}, "no cell data regoin: got region"),
        ({"cells": {"region": 9}}, "no such cells: got region = 9"),
        ({"field": "v", "block": "line"}, "no point data v: got"),
        ({"field": "top", "block": "line"}, "expected one vector per point"),
        ({"points": {"bottom": 1}}, "no point data bottom"),
        ({"block": 5}, "no block 5: got 2 blocks"),
        ({"block": "hexahedron"}, "no cells of the kind hexahedron: got triangle, line"),
        ({"select": {"x": [10, 11]}}, "nothing in the selection"),
        ({"cells": {"region": 7}, "count": 9}, "number of points: got 5; expected 9"),
    ],
)
def test_selections_that_are_not_there(tmp_path: Path, options: dict[str, Any], words: str) -> None:
    with pytest.raises(Unreadable) as caught:
        read(vtu(tmp_path, grid()), **options)
    assert words in str(caught.value)


def test_a_missing_extra_names_its_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "surface.stl"
    meshio.write_points_cells(str(path), TETRA, [("triangle", [[0, 2, 1]])])
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(InvalidInput, match=r"pip install 'strandline\[vtu\]'") as caught:
        read(path)
    assert not isinstance(caught.value, Unreadable)
    vtp = tmp_path / "line.vtp"
    vtp.write_text(VTP_ASCII)
    assert len(read(vtp, keep="longest").points) == 4  # VTK's own formats need no extra
