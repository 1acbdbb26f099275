"""Paths: typed ones, checked like clicked ones, and those of Fiji and napari, from files written byte by byte."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.imaging.paths import PATHS, FirstPath, read_path, typed_path
from strandline.imaging.paths.first_path import MOST
from strandline.imaging.paths.read import LARGEST
from strandline.registry import imported

POINTS = [(30, 40), (50, 20), (90, 25)]
FINE = [(30.25, 40.5), (50.0, 20.125), (90.75, 25.0)]
POLYGON, RECTANGLE, FREELINE, POLYLINE, FREEHAND, TRACED, POINT = 0, 1, 4, 5, 7, 8, 10


def roi(kind: int, fine: list[tuple[float, float]] | None = None, *, large: bool = False, shapes: int = 0) -> bytes:
    """Return a .roi file: header, coordinates relative to the bounding box, and perhaps the same ones as floats."""
    left, top = min(x for x, _ in POINTS), min(y for _, y in POINTS)
    right, bottom = max(x for x, _ in POINTS), max(y for _, y in POINTS)
    number = len(POINTS)
    header = struct.pack(">4shBxhhhhH", b"Iout", 228, kind, top, left, bottom, right, 0 if large else number)
    header += struct.pack(">i", number if large else 0).ljust(18, b"\0") + struct.pack(">i", shapes)
    header = header.ljust(50, b"\0") + struct.pack(">h", 128 if fine else 0)
    body = struct.pack(f">{number}h", *(x - left for x, _ in POINTS))
    body += struct.pack(f">{number}h", *(y - top for _, y in POINTS))
    if fine:
        body += struct.pack(f">{number}f", *(x for x, _ in fine)) + struct.pack(f">{number}f", *(y for _, y in fine))
    return header.ljust(64, b"\0") + body + b"name and colours follow"


def read(folder: Path, content: bytes | str, name: str = "edge.roi") -> FirstPath:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_path(path)


def listed(path: FirstPath) -> list[tuple[float, ...]]:
    return [tuple(row) for row in path.points.tolist()]


def test_selections_of_fiji(tmp_path: Path) -> None:
    """Numbers of lines are centres of pixels, those of areas corners; floats are taken where there are some."""
    for kind in (POLYLINE, FREELINE):
        found = read(tmp_path, roi(kind))
        assert listed(found) == POINTS
        assert not found.closed
    for kind in (POLYGON, FREEHAND, TRACED):
        found = read(tmp_path, roi(kind))
        assert listed(found) == [(x - 0.5, y - 0.5) for x, y in POINTS]
        assert found.closed
    assert listed(read(tmp_path, roi(POLYLINE, FINE))) == FINE
    assert listed(read(tmp_path, roi(POLYGON, FINE))) == [(x - 0.5, y - 0.5) for x, y in FINE]
    assert listed(read(tmp_path, roi(POLYLINE, FINE, large=True))) == FINE


HEAD = "index,shape-type,vertex-index,axis-0,axis-1\n"
REFUSED: list[tuple[str, bytes | str, str]] = [
    ("edge.roi", roi(RECTANGLE), "no path: got rectangle"),
    ("edge.roi", roi(POINT), "no path: got points"),
    ("edge.roi", roi(77), "no path: got type 77"),
    ("edge.roi", roi(RECTANGLE, shapes=40), "no path: got composite selection"),
    ("edge.roi", roi(POLYLINE)[:70], "is cut off: got 70 bytes; expected 76, for 3 points"),
    ("edge.roi", roi(POLYLINE, FINE)[:99], "is cut off: got 99 bytes; expected 100"),
    ("edge.roi", roi(POLYLINE)[:40], "is no whole .roi file"),
    ("edge.roi", b"PK\x03\x04 a set of selections", "several selections"),
    ("edge.txt", "X,Y,Value\n1,2,255\n2,3,255\n3,9,255\n", "names its columns: got X, Y, Value"),
    ("edge.txt", "1,2,255\n2,3,255\n30,9,255\n", "no point in line 1: got 1 2 255"),
    ("edge.txt", "1,2\n30,x\n3,9\n", "no point in line 2"),
    ("edge.txt", "0.1,0.2\n0.4,0.5\n0.9,0.1\n", "extent of the path: got 0.8; .*remove the scale"),
    ("edge.txt", "1,2\n30,4\n", "too few points"),
    ("edge.txt", "", "too few points"),
    ("edge.txt", "nan,2\n30,4\n5,7\n", "names its columns: got nan, 2"),
    ("edge.txt", '{"path": []}', "is JSON"),
    ("edge.csv", HEAD, "holds no shape"),
    ("edge.csv", "index,vertex-index,axis-0,axis-1\n0,0,1,2\n", "no shape-type"),
    ("edge.csv", HEAD + "0,path,0,1,2\n1,path,0,3,4\n", "several shapes: got 2"),
    ("edge.csv", HEAD + "0,ellipse,0,1,2\n0,ellipse,1,3,4\n", "no path: got ellipse"),
    ("edge.csv", HEAD + "0,path,0,1,2\n0,path,1,3,x\n", "no point in line 3: got x"),
    ("edge.csv", HEAD + "0,path,0,1,2\n0,path,1,3\n", "no point in line 3"),
    ("edge.csv", HEAD + "0,line,0,1,2\n0,line,1,3,4\n", "too few points"),
    ("edge.csv", "1,2\n" * (LARGEST // 4 + 1), "size of the file"),
]


def test_other_selections_and_damaged_files_are_refused(tmp_path: Path) -> None:
    for name, content, said in REFUSED:
        with pytest.raises(InvalidInput, match=rf"{name}: .*{said}"):
            read(tmp_path, content, name)
    with pytest.raises(InvalidInput, match=r"none.roi: cannot be read: got No such file"):
        read_path(tmp_path / "none.roi")
    with pytest.raises(InvalidInput, match="format of the path: got fiji"):
        read_path(tmp_path / "edge.roi", form="fiji")
    assert all(callable(imported(target, "reader")) for target in PATHS.values())


def test_coordinates_as_text(tmp_path: Path) -> None:
    for text in (
        "X,Y\n30.25,40.5\n50,20.125\n90.75,25\n",
        "30.25\t40.5\n50\t20.125\n90.75\t25\n",
        "X\tY\r\n30.25\t40.5\r\n50\t20.125\r\n90.75\t25\r\n",
        " ,X,Y\n1,30.25,40.5\n2,50,20.125\n3,90.75,25\n",
        "30.25,40.5\n30.25,40.5\n50,20.125\n90.75,25\n",
        "".join(f"{x:.18e},{y:.18e}\n" for x, y in FINE),  # as OpenDrop writes it
    ):
        found = read(tmp_path, text, "edge.csv")
        assert listed(found) == FINE
        assert not found.closed
    found = read(tmp_path, "0,0\n50,0\n50,50\n0,0\n", "edge.txt")
    assert found.closed
    assert len(found.points) == 3


def test_a_shape_of_napari_has_rows_before_columns(tmp_path: Path) -> None:
    """In a stack, the slice comes before both."""
    rows = "".join(f"0.0,path,{k}.0,{y},{x}\n" for k, (x, y) in enumerate(FINE))
    found = read(tmp_path, HEAD + rows, "edge.csv")
    assert listed(found) == FINE
    assert not found.closed
    assert read(tmp_path, HEAD + rows.replace("path", "polygon"), "edge.csv").closed
    rows = "".join(f"0,path,{k},7,{y},{x}\n" for k, (x, y) in enumerate(FINE))
    assert listed(read(tmp_path, HEAD.replace("\n", ",axis-2\n") + rows, "edge.csv")) == FINE


def test_a_path_must_lie_in_the_picture(tmp_path: Path) -> None:
    (tmp_path / "edge.roi").write_bytes(roi(POLYLINE))
    assert listed(read_path(tmp_path / "edge.roi", size=(100, 50))) == POINTS
    with pytest.raises(InvalidInput, match=r"edge.roi: the path: point 3 is outside the picture"):
        read_path(tmp_path / "edge.roi", size=(90, 50))


def test_a_typed_path_is_a_list_of_pairs() -> None:
    found = typed_path([[1, 2], (3.5, 4), [0, 9]], closed=True, size=(10, 10))
    assert found.points.tolist() == [[1.0, 2.0], [3.5, 4.0], [0.0, 9.0]]
    assert found.closed
    assert typed_path(np.array([[1.0, 2.0], [3.0, 4.0], [0.0, 9.0]])).points.shape == (3, 2)
    many = np.stack([np.arange(MOST + 1.0), np.zeros(MOST + 1)], axis=1)
    refused: list[tuple[Any, dict[str, Any], str]] = [
        ("1 2, 3 4", {}, "observation.path: got 1 2, 3 4; expected a list of points"),
        ([1, 2, 3], {}, "observation.path: point 1: got 1"),
        ([[1, 2], [3, 4]], {}, "observation.path has too few points: got 2"),
        ([[1, 2], [3, 4], [30, 9]], {"size": (20, 20)}, "point 3 is outside the picture"),
        ([[0, 0], [9, 9], [9, 0], [0, 9]], {}, r"crosses or touches itself: got \(4.5, 4.5\) px"),
        (many, {}, "too many points: got 20001"),
    ]
    for points, options, said in refused:
        with pytest.raises(InvalidInput, match=said):
            typed_path(points, what="observation.path", **options)


def test_an_open_path_may_end_where_a_closed_one_would_cross() -> None:
    crossing = np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0], [8.0, 9.0]])
    assert not FirstPath(crossing).closed
    with pytest.raises(InvalidInput, match="crosses or touches itself"):
        FirstPath(crossing, closed=True)
