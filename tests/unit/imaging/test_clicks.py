"""Clicks: the file keeps them digit by digit, and every mistake in it is one line that says what and where."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.imaging.clicks import Clicks, ScaleBar
from strandline.imaging.clicks_file import LARGEST, as_json, read_clicks, write_clicks

SHA = "0123456789abcdef" * 4
SQUARE = [[10.0, 10.0], [20.0, 10.0], [20.0, 20.0], [10.0, 20.0]]


def clicks(**changes: Any) -> Clicks:
    given: dict[str, Any] = {
        "image": "scan.tif",
        "sha256": SHA,
        "size": (100, 80),
        "path": np.array([[5.0, 40.0], [1 / 3, 20.123456789], [99.5, 79.5]]),
        "scale": ScaleBar((10.0, 70.0), (40.0, 30.0), 0.2),
        "origin": (-30.0, 200.0),
        "exclude": (np.array(SQUARE),),
        "fixed": (np.array(SQUARE) + 40, np.array(SQUARE[:3])),
    }
    return Clicks(**{**given, **changes})


def written(folder: Path, **changes: Any) -> Path:
    """Write a file with some of its keys changed; a value of ... removes the key."""
    content = {**as_json(clicks()), **changes}
    path = folder / "scan.path.json"
    path.write_text(json.dumps({key: value for key, value in content.items() if value is not ...}))
    return path


def test_a_file_keeps_every_digit(tmp_path: Path) -> None:
    path, before = tmp_path / "scan.path.json", clicks(closed=True)
    write_clicks(before, path)
    after = read_clicks(path)
    assert as_json(after) == as_json(before)
    assert after.path.tobytes() == before.path.tobytes()
    assert (after.closed, after.scale, after.origin, after.size) == (True, before.scale, before.origin, (100, 80))
    assert [p.name for p in tmp_path.iterdir()] == ["scan.path.json"]
    assert after.first_path.closed
    np.testing.assert_array_equal(after.first_path.points, before.path)
    assert after.pixel_mm == pytest.approx(0.2 / 50)  # the scale bar has 30 by 40 pixels


def test_what_is_optional_may_be_missing(tmp_path: Path) -> None:
    found = read_clicks(written(tmp_path, scale=..., origin=..., closed=..., exclude=..., fixed=...))
    assert (found.scale, found.origin, found.closed, found.exclude, found.fixed) == (None, None, False, (), ())
    assert found.pixel_mm is None
    assert read_clicks(written(tmp_path, scale=None, origin=None, exclude=None)).scale is None
    found = read_clicks(written(tmp_path, path=[], fixed=[SQUARE]))  # such a picture needs no path
    assert (len(found.path), len(found.fixed)) == (0, 1)
    whole = [[-0.5, -0.5], [99.5, -0.5], [99.5, 79.5], [-0.5, 79.5]]  # corners of pixels at the border
    assert read_clicks(written(tmp_path, exclude=[whole])).exclude[0].tolist() == whole


def test_another_picture_is_refused() -> None:
    clicks().require_picture(SHA, (100, 80))
    clicks().require_picture(SHA.upper(), (100, 80))
    with pytest.raises(InvalidInput, match=r"scan.tif were made on another picture.*fedc.*0123"):
        clicks().require_picture(SHA[::-1], (100, 80))
    with pytest.raises(InvalidInput, match="another size: got 80 × 100 px; expected 100 × 80 px"):
        clicks().require_picture(SHA, (80, 100))


BAR = {"from": [1, 1], "to": [5, 1], "length_mm": 1}
MISTAKES: list[tuple[dict[str, Any], str]] = [
    ({"path": ...}, "path is missing"),
    ({"sha256": ...}, "sha256 is missing"),
    ({"version": ...}, "version is missing"),
    ({"version": 2}, "version of the file: got 2; expected 1"),
    ({"exlude": []}, "unknown key: got exlude; .*Did you mean exclude"),
    ({"image": 3}, "image: got 3; expected a text"),
    ({"sha256": "abc"}, "checksum of the picture: got abc"),
    ({"size": [100]}, "size of the picture"),
    ({"size": [100.0, 80.0]}, "size of the picture"),
    ({"size": [0, 80]}, "size of the picture"),
    ({"closed": "yes"}, "closed: got yes; expected true or false"),
    ({"path": [], "fixed": []}, "the path has too few points: got 0; expected at least 3"),
    ({"path": [[1, 1], [2, 2]]}, "too few points: got 2"),
    ({"path": "abc"}, "the path: got abc"),
    ({"path": [[1, 1], [2, 2, 2], [3, 3]]}, r"the path: point 2: got \[2, 2, 2\]"),
    ({"path": [[1, 1], ["a", 2], [3, 3]]}, "the path: point 2"),
    ({"path": [[1, 1], [True, 2], [3, 3]]}, "the path: point 2"),
    ({"path": [[1, 1], [2, float("nan")], [3, 3]]}, "the path: point 2 is not finite"),
    ({"path": [[1, 1], [2, 10**400], [3, 3]]}, "the path: point 2 is not finite"),
    ({"path": [[1, 1], [2, 2], [2, 2], [3, 1]]}, "points 2 and 3 coincide"),
    ({"path": [[1, 1], [9, 2], [4, 8], [1, 1]], "closed": True}, "points 4 and 1 coincide"),
    ({"path": [[1, 1], [2, 2], [99.6, 3]]}, r"point 3 is outside the picture: .*-0.5 to 99.5 and y from -0.5 to 79.5"),
    ({"path": [[1, -0.6], [2, 2], [3, 3]]}, "point 1 is outside the picture"),
    ({"path": [[10, 10], [20, 20], [20, 10], [10, 20]]}, r"crosses or touches itself: got \(15, 15\) px"),
    ({"path": [[10, 10], [20, 20], [10, 20], [20, 10.5]], "closed": True}, "crosses or touches itself"),
    ({"path": [[10, 10], [20, 10], [12, 10]]}, "crosses or touches itself"),
    ({"origin": [1]}, "origin: point 1"),
    ({"origin": [1, float("nan")]}, "origin: point 1 is not finite"),
    ({"scale": [1, 2]}, "scale bar: got"),
    ({"scale": {"from": [1, 1], "to": [5, 1]}}, "scale bar: length_mm is missing"),
    ({"scale": {**BAR, "to": [1, 1]}}, "scale bar of no length"),
    ({"scale": {**BAR, "length_mm": 0}}, "length of the scale bar: got 0"),
    ({"scale": {**BAR, "length_mm": "1 mm"}}, "length of the scale bar: got 1 mm"),
    ({"scale": {**BAR, "length_mm": True}}, "length of the scale bar: got True"),
    ({"scale": {**BAR, "length_mm": float("inf")}}, "length of the scale bar: got inf"),
    ({"scale": {**BAR, "length_mm": 10**400}}, "length of the scale bar: got inf"),
    ({"scale": {**BAR, "to": [500, 1]}}, "scale bar: point 2 is outside"),
    ({"exclude": 3}, "exclude: got 3"),
    ({"exclude": [SQUARE, SQUARE[:2]]}, "exclude: region 2 has too few points: got 2"),
    ({"fixed": [[[1, 1], [2, 2], [3, float("nan")]]]}, "fixed: region 1: point 3 is not finite"),
    ({"fixed": [[[1, 1], [2, 2], [300, 3]]]}, "fixed: region 1: point 3 is outside"),
]


def test_a_mistake_is_one_line(tmp_path: Path) -> None:
    for changes, message in MISTAKES:
        with pytest.raises(InvalidInput, match=message) as caught:
            read_clicks(written(tmp_path, **changes))
        assert str(caught.value).startswith("scan.path.json: ")
        assert "\n" not in str(caught.value)


def test_files_that_cannot_hold_clicks_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "scan.path.json"
    path.mkdir()
    with pytest.raises(InvalidInput, match="cannot be read: got Is a directory"):
        read_clicks(path)
    path.rmdir()
    for content, said in (
        (b"", "is not JSON"),
        (b"\xff\xfe", "is not JSON"),
        (b"[" * 100_000, "is not JSON"),
        (b'{"path": 1' + b"0" * 5000 + b"}", "is not JSON"),
        (b"[1]", "is no file of clicks: got a list"),
        (b" " * (LARGEST + 1), r"(?!.*JSON).*size of the file"),
    ):
        path.write_bytes(content)
        with pytest.raises(InvalidInput, match=f"scan.path.json: {said}"):
            read_clicks(path)


def test_a_missing_file_is_looked_for_beside(tmp_path: Path) -> None:
    for number, (there, said) in enumerate(
        (
            ((), "the folder has no file of clicks; expected a file of clicks, PICTURE.path.json"),
            (("IMG_1.path.json", "notes.txt"), "has IMG_1.path.json; expected .* Did you mean IMG_1.path.json"),
            (("other.path.json", "scans.path.json"), "has other.path.json, scans.*; .* Did you mean scans.path.json"),
            (("IMG_20260817.path.json", "IMG_20260818.path.json"), "has IMG_2.* Move it there"),
        )
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        for name in there:
            (folder / name).touch()
        with pytest.raises(InvalidInput, match=f"^scan.path.json: cannot be read: .*{said}"):
            read_clicks(folder / "scan.path.json")
