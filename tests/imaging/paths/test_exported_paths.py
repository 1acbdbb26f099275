"""Paths of Fiji and napari, from files written here byte by byte."""

import struct
from pathlib import Path

import pytest

from strandline.errors import InvalidInput
from strandline.imaging.paths import PATHS, FirstPath, read_path
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


def read(folder: Path, content: bytes, name: str = "edge.roi") -> FirstPath:
    path = folder / name
    path.write_bytes(content)
    return read_path(path)


def listed(path: FirstPath) -> list[tuple[float, ...]]:
    return [tuple(row) for row in path.points.tolist()]


@pytest.mark.parametrize("kind", [POLYLINE, FREELINE])
def test_integers_of_a_line_are_centres_of_pixels(kind: int, tmp_path: Path) -> None:
    found = read(tmp_path, roi(kind))
    assert listed(found) == POINTS
    assert not found.closed


@pytest.mark.parametrize("kind", [POLYGON, FREEHAND, TRACED])
def test_integers_of_an_area_are_corners_of_pixels(kind: int, tmp_path: Path) -> None:
    found = read(tmp_path, roi(kind))
    assert listed(found) == [(x - 0.5, y - 0.5) for x, y in POINTS]
    assert found.closed


def test_floats_are_taken_where_there_are_some(tmp_path: Path) -> None:
    assert listed(read(tmp_path, roi(POLYLINE, FINE))) == FINE
    assert listed(read(tmp_path, roi(POLYGON, FINE))) == [(x - 0.5, y - 0.5) for x, y in FINE]


def test_the_number_of_points_may_be_in_its_second_place(tmp_path: Path) -> None:
    assert listed(read(tmp_path, roi(POLYLINE, FINE, large=True))) == FINE


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (roi(RECTANGLE), "no path: got rectangle"),
        (roi(POINT), "no path: got points"),
        (roi(77), "no path: got type 77"),
        (roi(RECTANGLE, shapes=40), "no path: got composite selection"),
        (roi(POLYLINE)[:70], "is cut off: got 70 bytes; expected 76, for 3 points"),
        (roi(POLYLINE, FINE)[:99], "is cut off: got 99 bytes; expected 100"),
        (roi(POLYLINE)[:40], "is no whole .roi file"),
        (b"PK\x03\x04 a set of selections", "several selections"),
    ],
)
def test_other_selections_and_damaged_files_are_refused(content: bytes, message: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=rf"edge.roi: .*{message}"):
        read(tmp_path, content)


@pytest.mark.parametrize(
    "text",
    [
        "X,Y\n30.25,40.5\n50,20.125\n90.75,25\n",
        "30.25\t40.5\n50\t20.125\n90.75\t25\n",
        "X\tY\r\n30.25\t40.5\r\n50\t20.125\r\n90.75\t25\r\n",
        " ,X,Y\n1,30.25,40.5\n2,50,20.125\n3,90.75,25\n",
        "30.25,40.5\n30.25,40.5\n50,20.125\n90.75,25\n",
    ],
)
def test_coordinates_as_text(text: str, tmp_path: Path) -> None:
    found = read(tmp_path, text.encode(), "edge.csv")
    assert listed(found) == FINE
    assert not found.closed


def test_a_profile_of_opendrop(tmp_path: Path) -> None:
    """Two columns with all digits and no names."""
    text = "".join(f"{x:.18e},{y:.18e}\n" for x, y in FINE)
    assert listed(read(tmp_path, text.encode(), "profile_extracted.csv")) == FINE


def test_an_outline_that_returns_to_its_first_point_is_closed(tmp_path: Path) -> None:
    found = read(tmp_path, b"0,0\n50,0\n50,50\n0,0\n", "edge.txt")
    assert found.closed
    assert len(found.points) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("X,Y,Value\n1,2,255\n2,3,255\n3,9,255\n", "names its columns: got X, Y, Value"),
        ("1,2,255\n2,3,255\n30,9,255\n", "no point in line 1: got 1 2 255"),
        ("1,2\n30,x\n3,9\n", "no point in line 2"),
        ("0.1,0.2\n0.4,0.5\n0.9,0.1\n", "extent of the path: got 0.8; .*remove the scale"),
        ("1,2\n30,4\n", "too few points"),
        ("", "too few points"),
        ("nan,2\n30,4\n5,7\n", "names its columns: got nan, 2"),
        ('{"path": []}', "is JSON"),
    ],
)
def test_text_without_a_path_is_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=rf"edge.txt: .*{message}"):
        read(tmp_path, text.encode(), "edge.txt")


HEAD = "index,shape-type,vertex-index,axis-0,axis-1\n"


def test_a_shape_of_napari_has_rows_before_columns(tmp_path: Path) -> None:
    rows = "".join(f"0.0,path,{k}.0,{y},{x}\n" for k, (x, y) in enumerate(FINE))
    found = read(tmp_path, (HEAD + rows).encode(), "edge.csv")
    assert listed(found) == FINE
    assert not found.closed
    closed = read(tmp_path, (HEAD + rows.replace("path", "polygon")).encode(), "edge.csv")
    assert closed.closed


def test_the_slice_of_a_stack_comes_before_row_and_column(tmp_path: Path) -> None:
    head = "index,shape-type,vertex-index,axis-0,axis-1,axis-2\n"
    rows = "".join(f"0,path,{k},7,{y},{x}\n" for k, (x, y) in enumerate(FINE))
    assert listed(read(tmp_path, (head + rows).encode(), "edge.csv")) == FINE


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD, "holds no shape"),
        ("index,vertex-index,axis-0,axis-1\n0,0,1,2\n", "no shape-type"),
        (HEAD + "0,path,0,1,2\n1,path,0,3,4\n", "several shapes: got 2"),
        (HEAD + "0,ellipse,0,1,2\n0,ellipse,1,3,4\n", "no path: got ellipse"),
        (HEAD + "0,path,0,1,2\n0,path,1,3,x\n", "no point in line 3: got x"),
        (HEAD + "0,path,0,1,2\n0,path,1,3\n", "no point in line 3"),
        (HEAD + "0,line,0,1,2\n0,line,1,3,4\n", "too few points"),
    ],
)
def test_other_layers_of_napari_are_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=rf"edge.csv: .*{message}"):
        read(tmp_path, text.encode(), "edge.csv")


def test_a_path_must_lie_in_the_picture(tmp_path: Path) -> None:
    path = tmp_path / "edge.roi"
    path.write_bytes(roi(POLYLINE))
    assert listed(read_path(path, size=(100, 50))) == POINTS
    with pytest.raises(InvalidInput, match=r"edge.roi: the path: point 3 is outside the picture"):
        read_path(path, size=(90, 50))


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"edge.roi: cannot be read: got No such file"):
        read_path(tmp_path / "edge.roi")
    (tmp_path / "edge.roi").write_bytes(roi(POLYLINE))
    with pytest.raises(InvalidInput, match=r"edge.csv: size of the file"):
        read(tmp_path, b"1,2\n" * (LARGEST // 4 + 1), "edge.csv")
    with pytest.raises(InvalidInput, match="format of the path: got fiji"):
        read_path(tmp_path / "edge.roi", form="fiji")


def test_every_format_has_its_reader() -> None:
    for target in PATHS.values():
        assert callable(imported(target, "reader"))
