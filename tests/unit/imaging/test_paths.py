"""Paths: typed ones, those of Fiji and napari from files written byte by byte, and clicks with their file."""

import json
import struct

import numpy as np
import pytest

from strandline.foundations import InvalidInput
from strandline.foundations.refusals import LARGEST
from strandline.imaging.clicks import Clicks, ScaleBar, as_json, read_clicks
from strandline.imaging.paths import read_path, typed_path

POINTS = [(30, 40), (50, 20), (90, 25)]
FINE = [(30.25, 40.5), (50.0, 20.125), (90.75, 25.0)]
POLYGON, RECTANGLE, FREELINE, POLYLINE, FREEHAND, TRACED = 0, 1, 4, 5, 7, 8


def roi(kind, fine=None, *, large=False, shapes=0):
    """Return a .roi file: header, coordinates relative to the bounding box, and perhaps the same ones as floats."""
    (left, top), (right, bottom), number = np.min(POINTS, axis=0), np.max(POINTS, axis=0), len(POINTS)
    header = struct.pack(">4shBxhhhhH", b"Iout", 228, kind, top, left, bottom, right, 0 if large else number)
    header += struct.pack(">i", number if large else 0).ljust(18, b"\0") + struct.pack(">i", shapes)
    header = header.ljust(50, b"\0") + struct.pack(">h", 128 if fine else 0)
    body = (np.array(POINTS) - [left, top]).T.astype(">i2").tobytes()
    if fine:
        body += np.array(fine).T.astype(">f4").tobytes()
    return header.ljust(64, b"\0") + body + b"name and colours follow"


def read(folder, content, name="edge.roi"):
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_path(path)


def listed(path):
    return [tuple(row) for row in path.points.tolist()]


def test_selections_of_fiji(tmp_path):
    """Numbers of lines are centres of pixels, those of areas corners; floats are taken where there are some."""
    for kind, area in ((POLYLINE, 0), (FREELINE, 0), (POLYGON, 1), (FREEHAND, 1), (TRACED, 1)):
        for fine, points in ((None, POINTS), (FINE, FINE)):
            found = read(tmp_path, roi(kind, fine))
            assert listed(found) == [(x - 0.5 * area, y - 0.5 * area) for x, y in points]
            assert found.closed == bool(area)
    assert listed(read(tmp_path, roi(POLYLINE, FINE, large=True))) == FINE


HEAD = "index,shape-type,vertex-index,axis-0,axis-1\n"
REFUSED = [
    ("edge.roi", roi(RECTANGLE), "no path: got rectangle"),
    ("edge.roi", roi(RECTANGLE, shapes=40), "no path: got composite selection"),
    ("edge.roi", roi(POLYLINE)[:70], "is cut off: got 70 bytes; expected 76, for 3 points"),
    ("edge.roi", roi(POLYLINE, FINE)[:99], "is cut off: got 99 bytes; expected 100"),
    ("edge.roi", roi(POLYLINE)[:40], "is no whole .roi file"),
    ("edge.txt", "1,2,255\n2,3,255\n30,9,255\n", "point 1, in line 1: got 1 2 255"),
    ("edge.txt", "x,y\n1,2\nnan,3\n30,9\n", "point 2, in line 3: got nan 3"),
    ("edge.txt", "0.1,0.2\n0.4,0.5\n0.9,0.1\n", "extent of the path: got 0.8; .*remove the scale"),
    ("edge.csv", "index,vertex-index,axis-0,axis-1\n0,0,1,2\n", "holds no shape: got no shape-type"),
    ("edge.csv", HEAD + "0,path,0,1,2\n1,path,0,3,4\n", "several shapes: got 2"),
    ("edge.csv", "1,2\n" * (LARGEST // 4 + 1), "size of the file"),
]


def test_other_selections_and_damaged_files_are_refused(tmp_path):
    for name, content, said in REFUSED:
        with pytest.raises(InvalidInput, match=rf"{name}: .*{said}"):
            read(tmp_path, content, name)
    path = tmp_path / "edge.roi"
    path.write_bytes(roi(POLYLINE))
    with pytest.raises(InvalidInput, match=r"edge\.roi: the path: point 3 is outside the picture"):
        read_path(path, size=(90, 50))


def test_coordinates_as_text(tmp_path):
    for text in (
        "X,Y\n30.25,40.5\n50,20.125\n90.75,25\n",
        " ,X,Y\n1,30.25,40.5\n2,50,20.125\n3,90.75,25\n",
        "30.25,40.5\n30.25,40.5\n50,20.125\n90.75,25\n",
        "".join(f"{x:.18e},{y:.18e}\n" for x, y in FINE),  # as OpenDrop writes it
    ):
        found = read(tmp_path, text, "edge.csv")
        assert (listed(found), found.closed) == (FINE, False)
    found = read(tmp_path, "0,0\n50,0\n50,50\n0,0\n", "edge.txt")
    assert (len(found.points), found.closed) == (3, True)


def test_a_shape_of_napari_has_rows_before_columns(tmp_path):
    """In a stack, the slice comes before both."""
    rows = "".join(f"0.0,path,{k}.0,{y},{x}\n" for k, (x, y) in enumerate(FINE))
    for kind in ("path", "polygon"):
        found = read(tmp_path, HEAD + rows.replace("path", kind), "edge.csv")
        assert (listed(found), found.closed) == (FINE, kind == "polygon")
    rows = "".join(f"0,path,{k},7,{y},{x}\n" for k, (x, y) in enumerate(FINE))
    assert listed(read(tmp_path, HEAD.replace("\n", ",axis-2\n") + rows, "edge.csv")) == FINE


def test_a_typed_path_is_a_list_of_pairs():
    found = typed_path([[1, 2], (3.5, 4), [0, 9]], closed=True, size=(10, 10))
    assert (listed(found), found.closed) == ([(1.0, 2.0), (3.5, 4.0), (0.0, 9.0)], True)
    assert listed(typed_path(np.array(FINE))) == FINE
    for points, said in (
        ("1 2, 3 4", "observation.path: got 1 2, 3 4; expected a list of points"),
        ([[0, 0], [9, 9], [9, 0], [0, 9]], r"crosses or touches itself: got \(4.5, 4.5\) px"),
    ):
        with pytest.raises(InvalidInput, match=said):
            typed_path(points, what="observation.path")


SHA = "0123456789abcdef" * 4
SQUARE = [[10.0, 10.0], [20.0, 10.0], [20.0, 20.0], [10.0, 20.0]]
CLICKS = {
    "image": "scan.tif",
    "sha256": SHA,
    "size": (100, 80),
    "path": np.array([[5.0, 40.0], [1 / 3, 20.123456789], [99.5, 79.5]]),
    "scale": ScaleBar((10.0, 70.0), (40.0, 30.0), 0.2),
    "origin": (-30.0, 200.0),
    "exclude": (np.array(SQUARE),),
    "fixed": (np.array(SQUARE) + 40, np.array(SQUARE[:3])),
}


def written(folder, **changes):
    """Write a file of clicks with some of its keys changed; a value of ... removes the key."""
    content = {**as_json(Clicks(**CLICKS)), **changes}
    path = folder / "scan.path.json"
    path.write_text(json.dumps({key: value for key, value in content.items() if value is not ...}))
    return path


def test_a_file_of_clicks_keeps_every_digit_and_what_is_optional_may_be_missing(tmp_path):
    path, before = tmp_path / "scan.path.json", Clicks(**CLICKS, closed=True)
    path.write_text(json.dumps(as_json(before)))
    after = read_clicks(path)
    assert as_json(after) == as_json(before)
    assert (after.closed, after.scale, after.origin, after.size) == (True, before.scale, before.origin, (100, 80))
    assert after.pixel_mm == pytest.approx(0.2 / 50)  # the scale bar has 30 by 40 pixels
    for nothing in (..., None):
        left_out = dict.fromkeys(("scale", "origin", "exclude", "fixed"), nothing)
        found = read_clicks(written(tmp_path, closed=..., **left_out))
        assert (found.scale, found.origin, found.closed, found.exclude, found.fixed) == (None, None, False, (), ())
        assert found.pixel_mm is None
    found = read_clicks(written(tmp_path, path=[], fixed=[SQUARE]))  # such a picture needs no path
    assert (len(found.path), len(found.fixed)) == (0, 1)


def test_clicks_on_another_picture_are_refused():
    clicks = Clicks(**CLICKS)
    clicks.require_picture(SHA.upper(), (100, 80))
    with pytest.raises(InvalidInput, match=r"scan.tif were made on another picture.*fedc.*0123"):
        clicks.require_picture(SHA[::-1], (100, 80))
    with pytest.raises(InvalidInput, match="another size: got 80 × 100 px; expected 100 × 80 px"):
        clicks.require_picture(SHA, (80, 100))


BAR = {"from": [1, 1], "to": [5, 1], "length_mm": 1}
MISTAKES = [
    ({"path": ...}, "path is missing"),
    ({"version": 2}, "version of the file: got 2; expected 1"),
    ({"exlude": []}, "unknown option: got exlude; .*Did you mean exclude"),
    ({"path": [], "fixed": []}, "the path has too few points: got 0; expected at least 3"),
    ({"path": [[1, 1], [2, 2, 2], [3, 3]]}, r"the path: point 2: got \[2, 2, 2\]"),
    ({"path": [[1, 1], [2, 2], [2, 2], [3, 1]]}, "points 2 and 3 coincide"),
    ({"path": [[1, 1], [9, 2], [4, 8], [1, 1]], "closed": True}, "points 4 and 1 coincide"),
    ({"path": [[1, 1], [2, 2], [99.6, 3]]}, r"point 3 is outside the picture: .*-0.5 to 99.5 and y from -0.5 to 79.5"),
    ({"path": [[1, 1], [2, 10**400], [3, 3]]}, "the path: point 2 is not finite"),
    ({"scale": {**BAR, "to": [1, 1]}}, "scale bar of no length"),
    ({"scale": {**BAR, "length_mm": 10**400}}, "length of the scale bar"),
    ({"scale": {"from": [1, 1], "length_mm": 1}}, "scale bar: to is missing"),
    ({"exclude": [SQUARE, SQUARE[:2]]}, "exclude: region 2 has too few points: got 2"),
]


def test_a_mistake_in_a_file_of_clicks_is_one_line(tmp_path):
    for changes, message in MISTAKES:
        with pytest.raises(InvalidInput, match=f"^scan.path.json: .*{message}") as caught:
            read_clicks(written(tmp_path, **changes))
        assert "\n" not in str(caught.value)
    path = tmp_path / "scan.path.json"
    for content, said in (
        (b"[" * 100_000, "is not JSON"),
        (b"[1]", r"clicks: got \[1\]"),
        (b" " * (LARGEST + 1), r"(?!.*JSON).*size of the file"),
    ):
        path.write_bytes(content)
        with pytest.raises(InvalidInput, match=f"scan.path.json: {said}"):
            read_clicks(path)
