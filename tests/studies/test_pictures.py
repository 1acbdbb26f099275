"""A picture as the observation of a study: where the edge is, its errors, and every bad input."""

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.patches import Rectangle
from PIL import Image
from scipy.special import ndtr

from strandline.calibration import Observer
from strandline.cli import main
from strandline.cli.run import _doubting
from strandline.discrepancy import ClosestPoint, Currents
from strandline.errors import InvalidInput
from strandline.imaging import Clicks, ScaleBar, write_clicks
from strandline.interface import PointErrors, UnknownErrors
from strandline.report.plots.picture import off_smooth, plot_picture
from strandline.runs import InProcess, RunRecord
from strandline.studies import Study, load_study, run_study
from strandline.studies.measure_doubts import measure_lines
from strandline.studies.pictures.behind import _small
from strandline.studies.pictures.picture_files import described, write_pictures
from strandline.studies.read_how import read_how
from strandline.testing.studies import write_study

PIXEL, SIZE, ORIGIN = 0.01, (220, 160), (10.0, 120.0)
CLICKS = [[12, 98], [60, 62], [110, 50], [160, 60], [208, 97]]


def height(x: np.ndarray) -> np.ndarray:
    """Return the true edge: row over column, in pixels; the solid is below it."""
    return 50 + 0.005 * (x - 110) ** 2


def picture(folder: Path, *, noise: float = 6.0, seed: int = 1) -> Path:
    """Write a picture of a dark hump on a bright ground, blurred over 1.5 pixels."""
    x, y = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    inside = (y - height(x)) / np.sqrt(1 + (0.01 * (x - 110)) ** 2)
    grey = 200 - 150 * ndtr(inside / 1.5) + noise * np.random.default_rng(seed).standard_normal(x.shape)
    Image.fromarray(np.clip(np.round(grey), 0, 255).astype(np.uint8)).save(folder / "hump.png")
    return folder / "hump.png"


def written(folder: Path, *, noise: Any = None, **changes: Any) -> Path:
    """Write a study whose observation is the picture; None removes a key of it."""
    folder.mkdir(exist_ok=True)
    if not (folder / "hump.png").exists():
        picture(folder)
    image: dict[str, Any] = {
        "file": "hump.png",
        "pixel": {"size": 1e3 * PIXEL, "unit": "um"},
        "frame": {"origin": list(ORIGIN)},
        "path": CLICKS,
        "solid": "dark",
    }
    image = {key: value for key, value in {**image, **changes}.items() if value is not None}
    stated = noise or {"sd": "image", "unit": "um", "unknown": {"shift": 5}}
    inferred: dict[str, Any] = {"surrogate": {"field": {}}} if "model_error" in stated else {}
    return write_study(
        folder, observation={"image": image}, discrepancy={"normal_offset": {}}, noise=stated, **inferred
    )


def loaded(folder: Path, **changes: Any) -> Study:
    return load_study(written(folder, **changes))


@pytest.mark.parametrize("size", [(90, 130), (1001, 700)])
def test_a_picture_made_smaller_covers_the_same_place(size: tuple[int, int]) -> None:
    """A step at 40 % of the width stays there: without the mean of pixels, half a large one is lost."""
    columns = np.arange(size[1]) + 0.5
    small = np.asarray(_small(np.tile((columns > 0.4 * size[1]) * 1.0, (size[0], 1)), 100), float) / 255
    assert max(small.shape) <= 100
    assert 1 - small.mean() == pytest.approx(0.4, abs=0.5 / size[1] + 1 / 255)


@pytest.mark.parametrize(
    ("unknown", "warned"),
    [({"shift": 2, "scale": 0.01}, "by 11.4 µm, but shift allows 2 µm"), ({"shift": 20, "scale": 0.01}, None),
     ({"shift": 2, "rotation": 1}, "an error of rotation about the origin"), ({"shift": 10, "rotation": 1}, None)],
)  # fmt: skip
def test_check_warns_of_a_shift_that_holds_a_wrong_scale_in_place(
    unknown: dict[str, float], warned: str | None, tmp_path: Path
) -> None:
    """The middle of the hump is 1.14 mm from the clicked origin."""
    study = loaded(tmp_path / "hump", noise={"sd": "image", "unit": "um", "unknown": unknown})
    record = RunRecord("key", {}, "ok", {"": study.observed[""]})
    (seen,) = study.observations(study.observed)
    np.testing.assert_allclose(np.hypot(*seen.interface.points.mean(axis=0)), 1.14, atol=0.01)
    lines = [line for line in measure_lines(study, record) if "contradict" in line]
    assert [warned is not None and warned in line for line in lines] == ([] if warned is None else [True])


@pytest.mark.parametrize(
    ("unknown", "warned"), [({}, True), ({"offset": 2}, True), ({"scale": 0.01, "shift": 20}, False)]
)
def test_check_warns_if_no_error_of_place_and_size_is_stated(
    unknown: dict[str, float], warned: bool, tmp_path: Path
) -> None:
    study = loaded(tmp_path / "hump", noise={"sd": "image", "unit": "um", "unknown": unknown})
    record = RunRecord("key", {}, "ok", {"": study.observed[""]})
    said = "no error of place and size is stated"
    assert any(said in line for line in measure_lines(study, record)) is warned


def test_check_predicts_widths_beside_an_error_of_the_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Planted: noise of unknown size, for which there is nothing to predict them from."""
    noise = {"sd": "image", "unit": "um", "unknown": {"shift": 20}, "model_error": True}
    main(["check", str(written(tmp_path / "known", noise=noise)), "--widths"])
    shown = capsys.readouterr().out
    assert "more runs, without a model error): " in shown
    assert "will be inferred" not in shown
    main(
        [
            "check",
            str(written(tmp_path / "unknown", noise=noise | {"sd": "unknown", "unknown": {"shift": 20, "offset": 1}})),
            "--widths",
        ]
    )
    shown = capsys.readouterr().out
    assert "the noise will be inferred; this check assumes an sd of " in shown
    assert "expected posterior" not in shown


def test_the_first_run_of_a_campaign_shows_a_picture_that_lies_wrong(tmp_path: Path) -> None:
    """Ends anywhere near the model's are no reason: other inputs may move them there."""
    study, noted = loaded(tmp_path / "hump"), []
    seen = study.observed[""]

    def told(study: Study, *shifts: float) -> list[str]:
        noted.clear()
        observer = _doubting(study, Observer(note=noted.append))
        for shift in shifts:
            line = replace(seen, points=seen.points + np.array([0.0, shift * seen.lengths.sum()]))
            observer.run(RunRecord("key", {}, "ok", {"": line}), None)
        return noted

    assert told(study, 0.0) == told(study, 0.15) == []
    (line,) = told(study, 0.4, 0.4)
    assert line.startswith("warning: the ends of the observed interface and of this run lie 0.")
    (line,) = told(loaded(tmp_path / "hump", solid="bright"), 0.0)
    assert line.startswith("warning: in hump.png the body lies on the other side")


@pytest.mark.parametrize("solid", ["dark", "bright"])
def test_check_warns_if_the_body_is_said_to_be_on_the_other_side(
    solid: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The beam runs from left to right, with the body on its right, below."""
    main(["check", str(written(tmp_path / "hump", solid=solid))])
    shown = capsys.readouterr().out
    assert ("warning: in hump.png the body lies on the other side of the interface" in shown) is (solid == "bright")
    assert "run opposite" not in shown


def off(study: Study) -> np.ndarray:
    """Return how far the observed points are from the true edge, in pixels along the vertical."""
    points = study.observed[""].points
    x, y = ORIGIN[0] + points[:, 0] / PIXEL, ORIGIN[1] - points[:, 1] / PIXEL
    return np.asarray(y - height(x))


def test_the_edge_is_where_it_is_and_its_errors_are_its_own(tmp_path: Path) -> None:
    study = loaded(tmp_path / "s")
    errors = off(study)
    assert abs(errors.mean()) < 0.05
    assert errors.std() < 0.3
    noise = study.noise_of("")
    assert isinstance(noise, PointErrors)
    assert noise.sd == pytest.approx(PIXEL * errors.std(), rel=0.4)
    assert noise.offset >= 0.1 * PIXEL
    assert noise.shift == pytest.approx(0.005)
    assert 0 < noise.length < 3 * PIXEL


def test_an_offset_that_is_stated_counts(tmp_path: Path) -> None:
    noise = loaded(tmp_path / "s", noise={"sd": "image", "unit": "um", "unknown": {"offset": 7}}).noise_of("")
    assert isinstance(noise, PointErrors)
    assert noise.offset == pytest.approx(0.007)


def test_a_folder_of_frames_is_averaged(tmp_path: Path) -> None:
    """Nine frames: the noise of the edge is a third; other files in the folder are no frames."""
    frames = tmp_path / "frames"
    frames.mkdir()
    for seed in range(9):
        picture(tmp_path, noise=18.0, seed=seed).rename(frames / f"{seed}.png")
    (frames / "notes.txt").write_text("taken on a Monday")
    many, one = loaded(tmp_path, file="frames"), loaded(tmp_path, file="frames/0.png")
    assert many.pictures[""].picture.notes[-1] == "mean of 9 frames"
    sds = [study.pictures[""].edge.errors.sd for study in (one, many)]
    assert sds[0] / sds[1] == pytest.approx(3.0, rel=0.25)
    assert np.abs(off(many)).max() < np.abs(off(one)).max()
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidInput, match="folder empty: got no picture in it"):
        loaded(tmp_path, file="empty")


def of_frames(folder: Path, number: int, *, noise: float = 18.0) -> Path:
    """Write frames of one state into a folder `frames`."""
    (folder / "frames").mkdir()
    for seed in range(number):
        picture(folder, noise=noise, seed=seed).rename(folder / "frames" / f"{seed}.png")
    return folder


def test_frames_show_their_own_errors_and_the_larger_ones_count(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written(of_frames(tmp_path, 4), file="frames")
    main(["image", str(folder)])
    shown = capsys.readouterr().out
    for words in ("from 4 frames: sd", "in one frame", "from their mean alone: sd", "set sd and length"):
        assert words in shown
    content = json.loads((folder / "image" / "edge.json").read_text("utf-8"))
    frames, alone = content["frames"]["mean"], content["frames"]["picture_alone"]
    assert frames["sd"] == pytest.approx(alone["sd"], rel=0.4)
    used = max((frames, alone), key=lambda one: one["sd"] ** 2 * one["length"])
    assert content["frames"]["used"] == ("frames" if used is frames else "picture")
    noise = load_study(folder).noise_of("")
    assert isinstance(noise, PointErrors)
    assert (noise.sd, noise.length) == (used["sd"], used["length"]) == (content["sd"], content["length"])


def test_frames_without_errors_are_noted(tmp_path: Path) -> None:
    """A picture that was copied is no second frame, and a single picture has none."""
    copies = of_frames(tmp_path, 1)
    shutil.copy(copies / "frames" / "0.png", copies / "frames" / "1.png")
    found = loaded(tmp_path, file="frames").pictures[""]
    assert found.repeated is None
    assert found.notes[-1] == "no errors from the frames, for contours of one state: identical contours"
    assert loaded(tmp_path, file="frames/0.png").pictures[""].repeated is None


def test_a_model_may_err_beside_the_errors_that_the_picture_shows(tmp_path: Path) -> None:
    known = loaded(tmp_path / "s").noise_of("")
    assert isinstance(known, PointErrors)
    stated = {"sd": "image", "unit": "um", "unknown": {"shift": 5}, "model_error": True}
    noise = loaded(tmp_path / "s", noise=stated).noise_of("")
    assert noise == UnknownErrors(known.sd, known.length, shift=known.shift, offset=known.offset, model_error=True)


def test_the_solid_sets_the_direction_in_every_frame(tmp_path: Path) -> None:
    """The normals point out of the solid, also where the model's y points down."""
    up = loaded(tmp_path / "up").observed[""]
    down = loaded(tmp_path / "down", frame={"origin": list(ORIGIN), "y": "down"}).observed[""]
    assert up.normals[:, 1].min() > 0
    assert down.normals[:, 1].max() < 0
    bright = loaded(tmp_path / "bright", solid="bright").observed[""]
    assert bright.normals[:, 1].max() < 0
    np.testing.assert_allclose(np.sort(down.points[:, 1]), np.sort(-up.points[:, 1]), atol=1e-9)


def test_marks_of_a_file_stand_for_path_scale_and_origin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    typed = loaded(tmp_path / "s")
    clicks = Clicks(
        "hump.png",
        typed.pictures[""].picture.sha256,
        SIZE,
        np.array(CLICKS, float),
        scale=ScaleBar((20.0, 150.0), (120.0, 150.0), 100 * PIXEL),
        origin=ORIGIN,
        exclude=(np.array([[90.0, 30.0], [130.0, 30.0], [130.0, 70.0], [90.0, 70.0]]),),
    )
    write_clicks(clicks, tmp_path / "s" / "hump.path.json")
    study = loaded(tmp_path / "s", path="hump.path.json", pixel=None, frame=None)
    points = study.observed[""].points
    assert not ((points[:, 0] > 0.82) & (points[:, 0] < 1.18)).any()
    assert abs(off(study).mean()) < 0.05
    notes = " ".join(study.pictures[""].notes)
    assert "scale bar in hump.path.json, as if pixels were square" in notes
    assert "at pixel (10, 120) from the marks in hump.path.json" in notes
    both = loaded(tmp_path / "s", path="hump.path.json", pixel={"size": 1030 * PIXEL, "unit": "um"})
    said = " ".join(both.pictures[""].notes)
    assert f"from the study, not {1000 * PIXEL:g} µm from the scale bar in hump.path.json" in said
    for origin, remark in (([12, 120], ", not (10, 120) from the marks in hump.path.json"), ([10.3, 120], "")):
        other = loaded(tmp_path / "s", path="hump.path.json", frame={"origin": origin})
        assert f"at pixel ({origin[0]}, 120) from the study{remark}; its axes" in " ".join(other.pictures[""].notes)
        ignored = other.pictures[""].ignored
        assert ignored == (
            ("the origin marked in hump.path.json lies 2 pixels from the one that the study states, and is ignored",)
            if remark
            else ()
        )
    capsys.readouterr()
    written(tmp_path / "s", path="hump.path.json", pixel={"size": 1030 * PIXEL, "unit": "um"})
    main(["check", str(tmp_path / "s")])
    bar = f"warning: hump.png: the scale bar in hump.path.json gives pixels of {1000 * PIXEL:g} µm, and is ignored"
    assert bar in capsys.readouterr().out
    picture(tmp_path / "s", seed=2)
    with pytest.raises(InvalidInput, match="hump"):
        load_study(tmp_path / "s")


@pytest.mark.parametrize(
    ("changes", "noise", "said"),
    [
        ({"pixel": None}, None, "pixel"),
        ({"frame": None}, None, "observation.image.frame.origin"),
        ({"frame": {"origin": [1, 2], "z": 3}}, None, "frame"),
        ({"file": "nothing.png"}, None, "nothing.png"),
        ({"path": "nothing.path.json"}, None, "nothing.path.json"),
        ({"path": "model"}, None, "observation.image.path"),
        ({"path": [[1, 2], [3, 4]]}, None, "at least three pixels"),
        ({"path": [[12, 98], [110, 50], [900, 97]]}, None, "path"),
        ({"path": [[12, 98], [208, 50], [208, 98], [12, 50]]}, None, "cross"),
        ({"page": 7}, None, "page"),
        ({"scale": "log"}, None, "scale"),
        ({"solid": "grey"}, None, "solid"),
        ({"trim": 0.49}, None, "points"),
        ({"edge": "erff"}, None, "observation.image.edge"),
        ({"edge": 3}, None, "observation.image.edge"),
        ({"edge": {"name": "erf"}}, None, "observation.image.edge: unknown option"),
        ({"edge": {"options": {}}}, None, "observation.image.edge.method"),
        ({"edge": {"method": "erf", "options": {"reach": 5}}}, None, "Remove the options"),
        ({"edge": "nowhere:Edge"}, None, "observation.image.edge"),
        ({"edge": {"method": "strandline.imaging.erf_step:ErfStep", "options": {"size": 5}}}, None, "size"),
        ({"edge": "strandline.imaging:Frame"}, None, "observation.image.edge"),
        ({"edge": "strandline.imaging:read_picture"}, None, "without bias, passes, locate"),
        ({"edge": {"method": "strandline.imaging.half_level:HalfLevel", "options": {"bias": 0.0}}}, None, "above 0"),
        ({"reader": "nowhere:read"}, None, "observation.image.reader"),
        ({"reader": "strandline.imaging:EDGES"}, None, "observation.image.reader"),
        ({"file": ["hump.png", "nothing.png"]}, None, "nothing.png"),
        ({}, {"sd": 2, "unit": "um"}, "noise.unknown.offset"),
        ({}, {"sd": "image", "unit": "um", "unknown": {"offset": 0}}, "noise.unknown.offset"),
        ({}, {"sd": "image", "unit": "um", "length": 3}, "noise.sd"),
        ({}, {"sd": "image", "unit": "um", "model_error": True, "unknown": {"shared": True}}, "noise.unknown.shared"),
    ],
)
def test_bad_input_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], noise: Any, said: str
) -> None:
    folder = written(tmp_path / "s", noise=noise, **changes)
    before = sorted(path.name for path in folder.iterdir())
    with pytest.raises(SystemExit) as ended:
        main(["image", str(folder)])
    shown = capsys.readouterr()
    assert (ended.value.code, shown.out) == (2, "")
    assert len(shown.err.splitlines()) == 1
    assert said in shown.err
    assert sorted(path.name for path in folder.iterdir()) == before


def test_errors_of_a_picture_need_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_study(tmp_path / "s", discrepancy={"normal_offset": {}}, noise={"sd": "image", "unit": "um"})
    for arguments, said in ((["check"], "comes from a picture"), (["image"], "no picture")):
        if arguments == ["image"]:
            folder = write_study(tmp_path / "t")
        with pytest.raises(SystemExit):
            main([*arguments, str(folder)])
        assert said in capsys.readouterr().err


def test_what_the_command_writes_is_the_same_each_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(tmp_path / "s")
    main(["image", str(folder)])
    shown = capsys.readouterr().out
    files = {path.name: path.read_bytes() for path in (folder / "image").iterdir()}
    assert sorted(files) == ["edge.csv", "edge.json", "edge.png"]
    for words in ("pixel size 10 × 10 µm from the study", "fine: contrast over noise", "image/edge.csv"):
        assert words in shown
    assert "σ_N² for normal_offset: none needed" in shown
    study = load_study(folder)
    table = np.loadtxt(folder / "image" / "edge.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, :2], study.observed[""].points, atol=1e-6)
    assert (np.diff(table[:, 3]) > 0).all()
    content = json.loads(files["edge.json"])
    assert content["points"] == len(table)
    assert content["sd"] == pytest.approx(study.pictures[""].errors.sd)
    written(folder, file="hamp.png")
    with pytest.raises(SystemExit):
        main(["image", str(folder)])
    assert capsys.readouterr().err.endswith("Did you mean hump.png? (image/edge.png still shows an earlier edge.)\n")
    write_pictures(folder, study.pictures, measures=study.discrepancies)
    assert {path.name: path.read_bytes() for path in (folder / "image").iterdir()} == files


def test_every_check_is_shown_with_its_limit_and_refuses_beyond_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same numbers: what is shown near its limit is refused beyond it."""
    folder = written(tmp_path / "s", trim=0.41)
    main(["image", str(folder)])
    shown = capsys.readouterr().out
    checks = {one["name"]: one for one in json.loads((folder / "image/edge.json").read_text("utf-8"))["checks"]}
    assert list(checks) == ["points", "contrast over noise", "at the limit of the strip", "blur"]
    assert (checks["points"]["verdict"], checks["points"]["limit"]) == ("warned", 30)
    assert 30 <= checks["points"]["value"] < 45
    assert f"warned: points {checks['points']['value']:.0f} (at least 30, one per pixel)" in shown
    assert checks["blur"]["verdict"] == "fine"
    assert checks["blur"]["value"] == pytest.approx(1.5 / 100, rel=0.5)
    with pytest.raises(InvalidInput, match=r"number of points of the edge: got \d+; expected at least 30"):
        loaded(tmp_path / "s", trim=0.45)


def test_the_noise_variance_is_that_of_the_measures_of_the_study(tmp_path: Path) -> None:
    study = loaded(tmp_path / "s")
    one, wide = study.pictures[""], Currents(0.37)
    found = described(one, {"currents": wide, "closest_point": ClosestPoint(direction="symmetric")})["noise_variance"]
    (name, first), (_, second), (_, last) = found.items()
    assert name.startswith("currents, width 0.37")
    assert first == {"value": wide.noise_variance(one.errors, one.interface), "unit": "mm²", "note": None}
    assert (second["value"], second["unit"]) == (None, None)
    assert "a run of the study computes it" in second["note"]
    assert "none needed" in last["note"]


def test_the_residual_of_an_edge_has_its_sd_and_its_band_is_drawn(tmp_path: Path) -> None:
    one = loaded(tmp_path / "s").pictures[""]
    left = off_smooth(one.edge)
    assert left.shape == one.edge.arc.shape
    assert left.std() == pytest.approx(one.edge.errors.sd, rel=0.3)
    figure = plot_picture(one.picture, one.path, one.edge)
    whole, near, _, residual = figure.axes
    width = float(abs(np.subtract(*near.get_xlim())))
    assert width < 0.2 * float(abs(np.subtract(*whole.get_xlim())))
    assert 4 * one.edge.errors.sd / PIXEL > 0.03 * width
    np.testing.assert_allclose(residual.lines[-1].get_ydata(), 1e3 * left)
    (band,) = residual.patches
    assert isinstance(band, Rectangle)
    assert (band.get_y(), band.get_height()) == pytest.approx((-2e3 * one.edge.errors.sd, 4e3 * one.edge.errors.sd))


def test_how_a_picture_was_read_is_said_everywhere_with_its_origin(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written(tmp_path / "s", frame={"origin": list(ORIGIN), "x": "right", "rotation": 1})
    study = load_study(folder)
    (one,) = read_how(study)
    picture = study.pictures[""].picture
    assert (one["condition"], one["file"], one["sha256"]) == ("", "hump.png", picture.sha256)
    assert one["notes"] == [
        "pixel size 10 × 10 µm from the study",
        "grey values taken as intensity, because the study states no scale",
        "the model's (0, 0) at pixel (10, 120) from the study; its axes point x right, y up (default), turned by 1°",
        "5 % of the edge left out at either end (`trim`)",
    ]
    main(["check", str(folder)])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "hump.png" in line]
    assert line == f"  hump.png: {'; '.join(one['notes'])}; sha256 {picture.sha256[:12]}…"
    main(["image", str(folder)])
    shown = capsys.readouterr().out
    assert all(f"  {note}\n" in shown for note in [*one["notes"], f"sha256 {picture.sha256}"])


def test_a_page_to_mark_the_picture_needs_no_path_and_no_scale(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written(tmp_path / "s", path="hump.path.json", pixel=None, frame=None)
    main(["image", str(folder), "--edit"])
    assert "hump.mark.html" in capsys.readouterr().out
    page = (folder / "hump.mark.html").read_text("utf-8")
    assert "hump.path.json" in page
    with pytest.raises(SystemExit):
        main(["image", str(folder), "--edit", "--condition", "late"])
    assert "--condition" in capsys.readouterr().err


def test_the_picture_to_which_one_is_registered_is_marked_too_and_needs_no_path(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Fixed region, scale and origin come from marks on another picture, in which nobody marked the interface."""
    folder = tmp_path / "s"
    folder.mkdir()
    picture(folder, seed=2).rename(folder / "bare.png")
    registration = {"to": "bare.png", "marks": "bare.path.json"}
    main(["image", str(written(folder, registration=registration, frame=None, pixel=None)), "--edit", "--reference"])
    assert "bare.mark.html" in capsys.readouterr().out
    assert "bare.path.json" in (folder / "bare.mark.html").read_text("utf-8")
    sha = hashlib.sha256((folder / "bare.png").read_bytes()).hexdigest()
    region = np.array([[10.0, 60.0], [90.0, 40.0], [90.0, 110.0], [10.0, 130.0]])
    write_clicks(
        Clicks("bare.png", sha, SIZE, np.zeros((0, 2)), origin=ORIGIN, fixed=(region,)), folder / "bare.path.json"
    )
    study = loaded(folder, registration=registration, frame=None)
    assert study.pictures[""].registration is not None
    assert abs(off(study).mean()) < 0.2
    main(["image", str(folder), "--edit", "--reference"])  # the page opens the marks
    for changes, arguments, said in (
        ({"path": "bare.path.json", "file": "bare.png"}, [], "observation.image.path"),
        ({}, ["--edit", "--reference"], "without `registration`"),
    ):
        with pytest.raises(SystemExit):
            main(["image", str(written(folder, **changes)), *arguments])
        assert said in capsys.readouterr().err


def test_the_example_is_sound() -> None:
    folder = Path(__file__).parents[2] / "examples" / "pendant-drop"
    content = yaml.safe_load((folder / "study.yaml").read_text("utf-8"))
    assert content["noise"]["sd"] == "image"
    assert len((folder / "drop.py").read_text("utf-8").splitlines()) <= 60


@pytest.mark.long
def test_the_example_finds_the_surface_tension(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = Path(__file__).parents[2] / "examples" / "pendant-drop"
    monkeypatch.syspath_prepend(str(source))
    shutil.copytree(source, tmp_path / "drop", ignore=shutil.ignore_patterns("__pycache__"))
    posterior = run_study(load_study(tmp_path / "drop"), executor=InProcess()).calibration.posterior
    z = (posterior.mean[0] - 72.4) / posterior.sd[0]
    assert abs(z) < 3
    assert 0.3 < posterior.sd[0] < 1.5
