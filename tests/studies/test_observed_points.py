"""Observed interfaces from files of points."""

from pathlib import Path

import numpy as np
import pytest

from strandline.errors import InvalidStudy
from strandline.interface import Interface
from strandline.studies import load_study
from strandline.studies.observed import read_points, require_plausible
from strandline.testing.studies import write_study

POINTS = np.array([[0.0, 0.0], [0.5, 0.25], [1.0, -0.125]])


def written(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "observed.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@pytest.mark.parametrize(
    "text",
    [
        "0,0\n0.5,0.25\n1,-0.125\n",
        "x,y\n0,0\n0.5,0.25\n1,-0.125\n",
        "x [mm]; y [mm]\n0;0\n0.5;0.25\n1;-0.125\n",
        "0;0\n0.5;0.25\n1;-0.125\n",
        "0 0\n5e-1\t2.5E-1\n  1   -0.125",
        "# by hand\n\n0, 0\n# between\n0.5 , 0.25\n\n1,-0.125\n\n",
        b"\xef\xbb\xbfx,y\r\n0,0\r\n0.5,0.25\r\n1,-0.125\r\n",
    ],
    ids=["plain", "header", "header and semicolons", "semicolons", "blanks", "comments", "BOM and CRLF"],
)
def test_variants_of_one_table(tmp_path: Path, text: str | bytes) -> None:
    interface = read_points(written(tmp_path, text), "mm")
    np.testing.assert_array_equal(interface.points, POINTS)
    assert not interface.closed


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1.0), ("um", 1e-3), ("µm", 1e-3), ("m", 1e3)])
def test_units(tmp_path: Path, unit: str, factor: float) -> None:
    interface = read_points(written(tmp_path, "0,0\n0.5,0.25\n1,-0.125\n"), unit)
    np.testing.assert_allclose(interface.points, POINTS * factor, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "what", "value"),
    [
        ("", "observed.csv holds no points", None),
        ("x,y\n# nothing\n", "observed.csv holds no points", None),
        (",\n", "observed.csv holds no points", None),
        ("0,0\n", "too few points", "1 point(s)"),
        ("x,y\n\n0,0\n1,2,3\n", "no point in line 4", "1 2 3"),
        ("0,0\n1\n", "no point in line 2", "1"),
        ("0,0\n1,one\n", "no point in line 2", "1 one"),
        ("0,O\n1,1\n2,0\n", "no point in line 1", "0 O"),
        ("0,0\nnan,1\n2,0\n", "point 1 of the interface is not finite", None),
        ("0,0\n1,1\n1,1\n2,0\n", "segment 1 of the interface has no length", None),
        ("0,0\n1,1\n1,0\n0,1\n", "crosses itself: segments 0 and 2", "(0.5, 0.5) mm"),
        (b"0,0\n\xff,1\n", "observed.csv cannot be read", None),
    ],
)
def test_refused(tmp_path: Path, text: str | bytes, what: str, value: str | None) -> None:
    with pytest.raises(InvalidStudy) as caught:
        read_points(written(tmp_path, text), "mm")
    assert what in caught.value.what
    assert "observed.csv" in caught.value.what
    if value is not None:
        assert caught.value.value == value


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InvalidStudy, match=r"observation none\.csv is missing: got .*none\.csv"):
        read_points(tmp_path / "none.csv", "mm")
    with pytest.raises(InvalidStudy, match="cannot be read"):
        read_points(tmp_path, "mm")


@pytest.mark.parametrize(("scale", "fits"), [(1.0, True), (2.0, True), (1000.0, False), (1e-3, False)])
def test_a_wrong_unit_shows_in_the_size(scale: float, fits: bool) -> None:
    model, observed = Interface.polyline(POINTS), Interface.polyline(POINTS * scale)
    if fits:
        require_plausible("observation o.csv", observed, model, unit="mm")
    else:
        with pytest.raises(
            InvalidStudy,
            match=r"o\.csv, read in mm: got .* mm across, .* times the model.s interface; expected about 1 mm",
        ):
            require_plausible("observation o.csv", observed, model, unit="mm")


def test_options_of_reading_reach_the_observation(tmp_path: Path) -> None:
    (tmp_path / "o.csv").write_text("b,a\n0.12,1\n0.0,0\n")
    observation = {"file": "o.csv", "unit": "mm", "columns": ["a", "b"], "sort": "x"}
    study = load_study(write_study(tmp_path, observation=observation))
    np.testing.assert_array_equal(study.observed[""].points, [[0.0, 0.0], [1.0, 0.12]])
    with pytest.raises(InvalidStudy, match=r"observation o\.csv has no column c: got b, a"):
        load_study(write_study(tmp_path, observation=observation | {"columns": ["a", "c"]}))
    with pytest.raises(InvalidStudy, match=r"observation\.sort: got z"):
        load_study(write_study(tmp_path, observation=observation | {"sort": "z"}))
    with pytest.raises(InvalidStudy, match="only with a `file`"):
        load_study(write_study(tmp_path, observation={"synthetic": {"E": 400}, "sort": "x"}))


@pytest.mark.parametrize(
    ("begin", "kind"),
    [(b"\x89PNG\r\n\x1a\n", "PNG"), (b"\xff\xd8\xff\xe0", "JPEG"), (b"II*\x00", "TIFF"), (b"MM\x00*", "TIFF")],
)
@pytest.mark.parametrize("name", ["observed.png", "observed.csv", "observed.vtu"])
def test_a_picture_is_not_a_contour_yet(tmp_path: Path, begin: bytes, kind: str, name: str) -> None:
    (tmp_path / name).write_bytes(begin + bytes(range(256)))
    with pytest.raises(InvalidStudy, match=rf"{name} is a picture: got a {kind} image; .*observation: .image"):
        load_study(write_study(tmp_path, observation={"file": name, "unit": "mm"}))
