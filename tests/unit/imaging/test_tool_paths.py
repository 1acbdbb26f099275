"""Outlines in pixels of labelme, GeoJSON, Cellpose, OpenDrop and ImageJ, and arrays of ilastik."""

import json
import struct

import h5py
import numpy as np
import pytest

from strandline.foundations import InvalidInput
from strandline.imaging.formats import read_hdf5
from strandline.imaging.paths import is_of_clicks, read_path
from strandline.imaging.picture import PictureReading

SQUARE = [[10, 5], [20, 5], [20, 15], [10, 15]]


def labelme(*shapes):
    drawn = [{"label": "a", "points": points, "shape_type": kind} for kind, points in shapes]
    return json.dumps({"version": "6.3.1", "flags": {}, "shapes": drawn, "imagePath": "a.png"})


def found(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_path(path)


def test_paths_with_the_pixels_that_their_tools_count(tmp_path):
    """An object on the pixels 10 to 19 and 5 to 14: corners of pixels begin at 9.5, centres at 10."""
    corners = [[x - 0.5, y - 0.5] for x, y in SQUARE]
    ring = {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [[*SQUARE, SQUARE[0]]]}}
    for name, content, points, closed in (
        ("a.json", labelme(("polygon", SQUARE), ("point", [[0, 0]])), corners, True),
        ("a.json", labelme(("linestrip", SQUARE)), corners, False),
        ("a.geojson", json.dumps(ring), corners, True),
        ("a_cp_outlines.txt", "10,5,19,5,19,14,10,14\n", [[10, 5], [19, 5], [19, 14], [10, 14]], True),
    ):
        path = found(tmp_path, name, content)
        assert not is_of_clicks(tmp_path / name)
        assert (path.points.tolist(), path.closed) == (points, closed)


def test_paths_that_are_refused(tmp_path):
    rows = "".join(f"{100 - k:.1f},{k:.1f}\n{100 + k:.1f},{k:.1f}\n" for k in range(1, 40))
    for name, content, words in (
        ("a.json", labelme(("polygon", SQUARE), ("polygon", SQUARE)), "number of outlines: got 2"),
        ("a.json", labelme(("point", [[1, 1]])), "number of outlines: got 0"),
        ("a.json", labelme()[:-9], "cannot be read"),
        ("a_cp_outlines.txt", "10,5,19,5,19,14\n40,5,49,5,49,14\n", "number of outlines: got 2"),
        ("extracted.csv", rows, "jumps to and fro.*fit.csv"),
    ):
        with pytest.raises(InvalidInput, match=words):
            found(tmp_path, name, content)


def test_coordinates_of_imagej_beyond_32767(tmp_path):
    """As ij.io.RoiEncoder writes them: 16 bits, of which the sign is lost."""
    points = np.array([[40000, 10], [40010, 12], [40020, 40]])
    header = struct.pack(">4shBxHHHHH", b"Iout", 228, 5, 10, 40000, 40, 40020, 3).ljust(64, b"\0")
    body = (points - [40000, 10]).T.astype(">u2").tobytes()
    assert found(tmp_path, "a.roi", header + body).points.tolist() == points.tolist()


def opened(path, values, **attributes):
    with h5py.File(path, "w") as file:
        file["exported_data"] = values
        file["exported_data"].attrs.update(attributes)
    return read_hdf5(path, PictureReading(), path.name)


def tags(keys):
    return json.dumps({"axes": [{"key": key, "typeFlags": 2} for key in keys]})


def test_channels_that_an_array_of_hdf5_names_as_its_last_axis(tmp_path):
    rng = np.random.default_rng(1)
    for keys, shape, frames, frame in (
        ("yxc", (4, 5, 1), 1, lambda v: v[..., 0]), ("zyxc", (2, 4, 5, 1), 2, lambda v: v[1, ..., 0]),
        ("yxc", (4, 5, 3), 1, lambda v: v), ("zyx", (2, 4, 5), 2, lambda v: v[1]),
    ):  # fmt: skip
        values = rng.integers(0, 9, shape)
        file = opened(tmp_path / "a.h5", values, axistags=tags(keys))
        assert (file.shape, file.frames) == ((4, 5), frames)
        np.testing.assert_array_equal(file.load(frames - 1), frame(values))
        file.close()
    for shape, attributes in (
        ((4, 5, 2), {"axistags": tags("yxc")}), ((5, 4), {"axistags": tags("xy")}),
        ((4, 5, 2), {"DIMENSION_LABELS": ["y", "x", "channel"]}),
    ):  # fmt: skip
        with pytest.raises(InvalidInput, match=r"axes.*Save one channel"):
            opened(tmp_path / "b.h5", np.ones(shape), **attributes)
