"""Interfaces in meshes; meshio writes the files, the shapes are known."""

import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.unit.readers.meshes import BENT, FACES, NX, NY, TETRA, TOP, VTP_ASCII, cells_of, grid, pvd, read, vtu

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.readers import READERS, Unreadable


def test_line_cells_in_any_order_with_a_displacement(tmp_path: Path) -> None:
    for options in (
        {"binary": False},
        {"binary": True, "compression": None},
        {"binary": True, "compression": "zlib"},
        {"binary": True, "compression": "lzma"},
    ):
        found = read(vtu(tmp_path, grid(), **options), cells={"region": 7}, field="u", start=[0, 2])
        np.testing.assert_array_equal(found.points, BENT)
        assert not found.closed
    for suffix in (".xdmf", ".xmf"):
        meshio.xdmf.write(str(tmp_path / f"mesh{suffix}"), grid(), data_format="XML")
        found = read(tmp_path / f"mesh{suffix}", cells={"region": 7}, field="u", start=[0, 2])
        np.testing.assert_array_equal(found.points, BENT)
    for suffix in (".vtu", ".vtk"):
        meshio.write(str(tmp_path / f"mesh{suffix}"), grid())
        found = read(tmp_path / f"mesh{suffix}", cells={"region": 7}, start=[4000, 2000], unit="m")
        np.testing.assert_array_equal(found.points, TOP[::-1] * 1000)


def test_the_boundary_of_a_region_is_closed_and_counter_clockwise(tmp_path: Path) -> None:
    for kind in ("triangle", "quad"):
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
    found = read(cells_of(tmp_path, points, "triangle6", [[0, 1, 2, 3, 4, 5]]), start=[0, 0])
    np.testing.assert_array_equal(found.points, points[[0, 3, 1, 4, 2, 5], :2])
    found = read(cells_of(tmp_path, points, "line3", [[1, 6, 7], [0, 1, 3]]), start=[0, 0])
    np.testing.assert_array_equal(found.points, points[[0, 3, 1, 7, 6], :2])


def test_another_plane(tmp_path: Path) -> None:
    mesh = grid()
    mesh.points = mesh.points[:, [0, 2, 1]]
    path = vtu(tmp_path, mesh)
    np.testing.assert_array_equal(read(path, cells={"region": 7}, plane="xz", start=[0, 2]).points, TOP)
    with pytest.raises(Unreadable, match="leaves its plane"):
        read(path, cells={"region": [7]}, block="line", plane="yz")


def test_pieces_and_branches_are_refused_with_their_places_or_one_piece_is_chosen(tmp_path: Path) -> None:
    points = [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 1, 0], [5.5, 1, 0]]
    path = cells_of(tmp_path, points, "line", [[3, 4], [1, 2], [0, 1]])
    with pytest.raises(Unreadable, match=r"in 2 pieces: got \(0, 0\) to \(2, 0\), \(5, 1\) to \(5\.5, 1\) mm"):
        read(path)
    assert read(path, keep="longest").points[-1].tolist() == [2.0, 0.0]
    assert read(path, near=[5, 0.9]).points.tolist() == [[5.0, 1.0], [5.5, 1.0]]
    points = [[0.0, 0, 0], [1, 0, 0], [2, 0.5, 0], [2, -0.5, 0]]
    with pytest.raises(Unreadable, match=r"branches at \(1, 0\) mm: got 3 segments"):
        read(cells_of(tmp_path, points, "line", [[0, 1], [1, 2], [1, 3]]))


def test_most_line_cells_give_the_direction(tmp_path: Path) -> None:
    points = np.array([[float(k), 0.1 * k * k, 0] for k in range(5)])
    found = read(cells_of(tmp_path, points, "line", [[1, 0], [2, 1], [2, 3], [4, 3]]))
    np.testing.assert_array_equal(found.points, points[::-1, :2])


def assert_outward(found: Interface, *, area: float) -> None:
    assert found.closed
    assert found.areas.sum() == pytest.approx(area)
    assert (found.normals * (found.centres - found.points.mean(axis=0))).sum(axis=1).min() > 0


def test_surfaces(tmp_path: Path) -> None:
    for suffix in (".stl", ".ply", ".vtu"):
        path = tmp_path / f"surface{suffix}"
        meshio.write_points_cells(str(path), TETRA, [("triangle", FACES)])
        found = read(path, unit="um")
        assert len(found.points) == 4
        assert_outward(found, area=(1.5 + np.sqrt(3) / 2) * 1e-6)


CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
SIDES = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
SOLIDS: list[tuple[str, Any, float]] = [
    ("tetra", TETRA, 1.5 + np.sqrt(3) / 2),
    ("tetra10", np.concatenate([TETRA, [(TETRA[a] + TETRA[b]) / 2 for a, b in SIDES]]), 1.5 + np.sqrt(3) / 2),
    ("hexahedron", CUBE, 6.0),
    ("hexahedron20", np.concatenate([CUBE, [(CUBE[a] + CUBE[b]) / 2 for a, b in EDGES]]), 6.0),
    ("wedge", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], float), 3 + np.sqrt(2)),
    ("pyramid", np.concatenate([CUBE[:4], [[0.5, 0.5, 0.5]]]), 1 + np.sqrt(2)),
]


def test_all_faces_of_solids_face_outwards(tmp_path: Path) -> None:
    for kind, points, area in SOLIDS:
        assert_outward(read(cells_of(tmp_path, points, kind, [list(range(len(points)))])), area=area)
    points = np.concatenate([CUBE, CUBE[4:] + np.array([0, 0, 1])])
    two = read(cells_of(tmp_path, points, "hexahedron", [list(range(8)), list(range(4, 12))]))
    assert two.areas.sum() == pytest.approx(10.0)  # without the face between them


TIMES: list[tuple[Any, float]] = [(None, 2.0), ("last", 2.0), ({"index": 0}, 0.0), ({"value": 1.0}, 1.0)]


@pytest.mark.parametrize("data_format", ["XML", "HDF", "pvd"])
def test_times_of_a_series(tmp_path: Path, data_format: str, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, path, options = grid(), tmp_path / "series.xdmf", {"block": "line"}
    monkeypatch.chdir(tmp_path)
    if data_format == "pvd":
        path, options = pvd(tmp_path), {"cells": {"region": 7}}
    else:
        with meshio.xdmf.TimeSeriesWriter("series.xdmf", data_format=data_format) as writer:
            writer.write_points_cells(mesh.points, mesh.cells[1:])
            for at in (0.0, 1.0, 2.0):
                writer.write_data(at, point_data={"u": at * mesh.point_data["u"]})
    for time, factor in TIMES:
        found = read(path, **options, field="u", start=[0, 2], **({"time": time} if time else {}))
        np.testing.assert_allclose(found.points, TOP + factor * (BENT - TOP), rtol=1e-15)
    for time in ({"index": 3}, {"value": 1.5}):
        with pytest.raises(Unreadable, match=r"has no time of .*: got 3 times from 0 to 2"):
            read(path, time=time)


def test_a_series_does_not_lead_out_of_its_folder(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "link").symlink_to(tmp_path)
    meshio.vtu.write(str(tmp_path / "other.vtu"), grid())
    for source in ("../other.vtu", "/etc/hostname", "link/other.vtu"):
        text = f'<VTKFile><Collection><DataSet timestep="0" file="{source}"/></Collection></VTKFile>'
        (inner / "series.pvd").write_text(text)
        with pytest.raises(Unreadable, match="outside of its folder"):
            read(inner / "series.pvd")


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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("damaged")


def whole_file(folder: Path, suffix: str) -> Path:
    path = folder / f"mesh{suffix}"
    if suffix == ".pvd":
        return pvd(folder)
    if suffix == ".vtp":
        path.write_text(VTP_ASCII)
    elif suffix in (".xdmf", ".xmf"):
        meshio.xdmf.write(str(path), grid(), data_format="XML")
    elif suffix in (".stl", ".ply"):
        meshio.write_points_cells(str(path), TETRA, [("triangle", FACES)])
    else:
        meshio.write(str(path), grid())
    return path


GARBAGE = [bytes(range(256)) * 8, b"<VTKFile/>", b"solid nothing\nendsolid nothing\n"]
TABLES = {".csv", ".tsv", ".txt", ".dat", ".npy", ".pvtu", ".pvtp"}


@pytest.mark.parametrize("suffix", sorted(set(READERS) - TABLES))
def test_damaged_files_are_one_clear_error(folder: Path, suffix: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = whole_file(folder, suffix)
    whole = path.read_bytes()

    @settings(max_examples=8)
    @given(share=st.floats(0.0, 1.0))
    def is_read_or_refused(share: float) -> None:
        path.write_bytes(whole[: int(share * len(whole))])
        with suppress(Unreadable):
            read(path)

    is_read_or_refused()
    for content in (*(whole[: int(share * len(whole))] for share in (0.0, 0.2, 0.6, 0.97)), *GARBAGE):
        path.write_bytes(content)
        with pytest.raises(Unreadable, match=path.name) as caught:
            read(path)
        assert "\n" not in str(caught.value)
        assert caught.value.kind in ("result_unreadable", "invalid_interface")
    assert capsys.readouterr().out == ""


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


def test_selections_that_are_not_there(tmp_path: Path) -> None:
    path = vtu(tmp_path, grid())
    missing: list[tuple[dict[str, Any], str]] = [
        ({"cells": {"regoin": 7}}, "no cell data regoin: got region"),
        ({"cells": {"region": 9}}, "no such cells: got region = 9"),
        ({"field": "v", "block": "line"}, "no point data v: got"),
        ({"field": "top", "block": "line"}, "expected one vector per point"),
        ({"points": {"bottom": 1}}, "no point data bottom"),
        ({"block": 5}, "no block 5: got 2 blocks"),
        ({"block": "hexahedron"}, "no cells of the kind hexahedron: got triangle, line"),
        ({"select": {"x": [10, 11]}}, "nothing in the selection"),
        ({"cells": {"region": 7}, "count": 9}, "number of points: got 5; expected 9"),
    ]
    for options, words in missing:
        with pytest.raises(Unreadable, match=words):
            read(path, **options)


def test_a_missing_extra_names_its_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "surface.stl"
    meshio.write_points_cells(str(path), TETRA, [("triangle", FACES[:1])])
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(InvalidInput, match=r"pip install 'strandline\[vtu\]'") as caught:
        read(path)
    assert not isinstance(caught.value, Unreadable)
    vtp = tmp_path / "line.vtp"
    vtp.write_text(VTP_ASCII)
    assert len(read(vtp, keep="longest").points) == 4  # VTK's own formats need no extra
