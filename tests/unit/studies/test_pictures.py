"""A picture as the observation of a study: where the edge is, its errors, and every bad input."""

import hashlib
import json
import shutil
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.unit.studies.hump import CLICKS, ORIGIN, PIXEL, SIZE, loaded, off, picture, seen, written
from tests.unit.studies.test_refusals import message_of, not_refused

from strandline.calibration import Observer
from strandline.cli import main
from strandline.cli.run import _doubting
from strandline.discrepancy import ClosestPoint, Currents
from strandline.imaging import Clicks, Frame, ScaleBar
from strandline.imaging.clicks import as_json
from strandline.interface import UnknownErrors
from strandline.report.plots.picture import off_smooth
from strandline.runs import InProcess, RunRecord
from strandline.studies import load_study
from strandline.studies.foresight.measure_doubts import measure_lines
from strandline.studies.load.photographed import frame_note
from strandline.studies.write.shown import _along, _small, described, picture_png, read_how, write_pictures
from strandline.testing.studies import TWO_LOADS_STUDY, write_study

IMAGE = {"sd": "image", "unit": "um"}


def image(capsys, folder, *options):
    """Return what `strandline image` says of a folder, or its error."""
    with suppress(SystemExit):
        main(["image", str(folder), *options])
    shown = capsys.readouterr()
    return shown.err or shown.out


def check(capsys, folder):
    main(["check", str(folder)])
    return capsys.readouterr().out


def test_a_picture_made_smaller_covers_the_same_place():
    """A step at 40 % of the width stays there: without the mean of pixels, half a large one is lost."""
    columns = np.arange(130) + 0.5
    small = np.asarray(_small(np.tile((columns > 0.4 * 130) * 1.0, (90, 1)), 100), float) / 255
    assert max(small.shape) <= 100
    assert 1 - small.mean() == pytest.approx(0.4, abs=0.5 / 130 + 1 / 255)


def test_check_warns_of_errors_of_place_and_size_that_contradict_each_other_or_are_not_stated(tmp_path):
    """The middle of the hump is 1.14 mm from the clicked origin: a small shift holds a wrong scale in place."""
    for unknown, warned in (
        ({"shift": 2, "scale": 0.01}, "by 11.4 µm, but shift allows 2 µm"),
        ({"shift": 20, "scale": 0.01}, ""),
        ({"shift": 2, "rotation": 1}, "an error of rotation about the origin"),
        ({"shift": 10, "rotation": 1}, ""),
        ({"offset": 2}, "no error of place and size is stated"),
    ):
        study = loaded(tmp_path, noise={**IMAGE, "unknown": unknown})
        doubts = measure_lines(study, RunRecord("key", {}, "ok", study.observed))
        lines = [line for line in doubts if "contradict" in line or "no error of place" in line]
        assert [warned in line for line in lines] == [True] * bool(warned)


def test_the_first_run_of_a_campaign_shows_a_picture_that_lies_wrong(tmp_path, capsys):
    """Ends anywhere near the model's are no reason: other inputs may move them there."""
    study, notes = loaded(tmp_path), []
    seen = study.observed[""]

    def told(study, *shifts):
        notes.clear()
        with _doubting(study, InProcess(), Observer(note=notes.append)) as observer:
            for shift in shifts:
                line = replace(seen, points=seen.points + np.array([0.0, shift * seen.lengths.sum()]))
                observer.run(RunRecord("key", {"E": 400.0}, "ok", {"": line}), None)
        return notes

    assert told(study, 0.0) == told(study, 0.15) == []
    (line,) = told(study, 0.4, 0.4)
    assert line.startswith("warning: the ends of the observed interface and of the run at E = 400 lie 0.")
    other = "warning: in hump.png the body lies on the other side of the interface"
    assert told(loaded(tmp_path, solid="bright"), 0.0)[0].startswith(other)
    for solid in ("dark", "bright"):  # the beam runs from left to right, with the body on its right, below
        assert (other in check(capsys, written(tmp_path, solid=solid))) == (solid == "bright")


def test_the_edge_is_where_it_is_and_its_errors_are_its_own(tmp_path):
    study = loaded(tmp_path)
    errors, noise = off(study), study.noise_of("")
    assert abs(errors.mean()) < 0.05
    assert errors.std() < 0.3
    assert noise.sd == pytest.approx(PIXEL * errors.std(), rel=0.4)
    assert noise.offset >= 0.1 * PIXEL
    assert 0 < noise.length < 3 * PIXEL
    assert loaded(tmp_path, noise={**IMAGE, "unknown": {"offset": 7}}).noise_of("").offset == pytest.approx(0.007)
    erring = loaded(tmp_path, noise={**IMAGE, "unknown": {"shift": 5}, "model_error": True}).noise_of("")
    assert erring == UnknownErrors(noise.sd, noise.length, shift=noise.shift, offset=noise.offset, model_error=True)


def test_a_folder_of_frames_is_averaged_and_the_larger_errors_count(tmp_path, capsys):
    """Nine frames: the noise of the edge is a third; other files in the folder are no frames, nor is a copy of one."""
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "notes.txt").write_text("taken on a Monday")
    for seed in range(9):
        picture(tmp_path, noise=18.0, seed=seed).rename(tmp_path / "frames" / f"{seed}.png")
    many, one = loaded(tmp_path, file="frames"), loaded(tmp_path, file="frames/0.png")
    assert many.pictures[""].picture.notes[-1] == "mean of 9 frames"
    sds = [study.pictures[""].edge.errors.sd for study in (one, many)]
    assert sds[0] / sds[1] == pytest.approx(3.0, rel=0.25)
    (tmp_path / "twice").mkdir()
    assert "folder twice: got no picture in it" in message_of(written(tmp_path, file="twice"))
    for name in ("0", "1"):
        shutil.copy(tmp_path / "frames" / "0.png", tmp_path / "twice" / f"{name}.png")
    found = loaded(tmp_path, file="twice").pictures[""]
    assert found.repeated is None
    assert found.notes[-1] == "no errors from the frames, for contours of one state: identical contours"
    folder = written(tmp_path, file="frames")
    assert "from 9 frames: sd" in image(capsys, folder)
    content = json.loads((folder / "image" / "edge.json").read_text("utf-8"))
    frames, alone = content["frames"]["mean"], content["frames"]["picture_alone"]
    assert frames["sd"] == pytest.approx(alone["sd"], rel=0.4)
    used = max((frames, alone), key=lambda one: one["sd"] ** 2 * one["length"])
    assert content["frames"]["used"] == ("frames" if used is frames else "picture")
    noise = load_study(folder).noise_of("")
    assert (noise.sd, noise.length) == (used["sd"], used["length"]) == (content["sd"], content["length"])
    # The normals point out of the solid, also where the model's y points down.
    up = loaded(tmp_path).observed[""]
    down = loaded(tmp_path, frame={"origin": list(ORIGIN), "y": "down"}).observed[""]
    bright = loaded(tmp_path, solid="bright").observed[""]
    assert up.normals[:, 1].min() > 0
    assert max(down.normals[:, 1].max(), bright.normals[:, 1].max()) < 0


def test_marks_of_a_file_stand_for_path_scale_and_origin(tmp_path, capsys):
    sha = loaded(tmp_path).pictures[""].picture.sha256
    bar = ScaleBar((20.0, 150.0), (120.0, 150.0), 100 * PIXEL)
    box = np.array([[90.0, 30.0], [130.0, 30.0], [130.0, 70.0], [90.0, 70.0]])
    clicks = Clicks("hump.png", sha, SIZE, np.array(CLICKS, float), scale=bar, origin=ORIGIN, exclude=(box,))
    (tmp_path / "hump.path.json").write_text(json.dumps(as_json(clicks)))
    marked = {"path": "hump.path.json", "pixel": None, "frame": None}
    study = loaded(tmp_path, **marked)
    points = study.observed[""].points
    assert not ((points[:, 0] > 0.82) & (points[:, 0] < 1.18)).any()
    assert abs(off(study).mean()) < 0.05
    assert "at pixel (10, 120) from the marks in hump.path.json" in " ".join(study.pictures[""].notes)
    for origin, remark in (([12, 120], ", not the marked (10, 120) of hump.path.json"), ([10.3, 120], "")):
        other = loaded(tmp_path, **marked | {"frame": {"origin": origin}}).pictures[""]
        assert f"at pixel ({origin[0]}, 120) from the study{remark}; its axes" in " ".join(other.notes)
        assert [remark in one for one in other.ignored] == [True] * bool(remark)
    both = written(tmp_path, **marked | {"pixel": {"size": 1030 * PIXEL, "unit": "um"}})
    (warning,) = (line for line in check(capsys, both).splitlines() if "warning: hump.png" in line)
    assert f", not the marked {1000 * PIXEL:g} µm of the scale bar in hump.path.json" in warning
    picture(tmp_path, seed=2)
    assert "hump" in message_of(tmp_path)


REFUSED = """
path: 3; path: model; edge: erff; edge: 3; edge: nowhere:Edge; edge: strandline.imaging:Frame; reader: nowhere:read
path: [[1, 2], [3, 4]] | observation.image.path has too few points: got 2; expected at least 3
registration: {to: hump.png} | neither marks nor fixed; expected a region that does not move
path: [[12, 98], [208, 50], [208, 98], [12, 50]] | cross
file: nothing.png; file: [hump.png, nothing.png] | nothing.png
trim: 0.45 | number of points of the edge
edge: {method: erf, options: {reach: 5}} | Remove the options
edge: {method: 'strandline.imaging.edges.edge_methods:HalfLevel', options: {bias: 0.0}} | above 0
edge: strandline.imaging:read_picture | without bias, passes, locate
"""
OF_NOISE = """
noise: {sd: 2, unit: um}; noise: {sd: image, unit: um, unknown: {offset: 0}} | noise.unknown.offset
noise: {sd: image, unit: um, length: 3} | noise.sd
"""


def test_bad_input_is_one_line(tmp_path, capsys):
    content = json.loads((written(tmp_path) / "study.yaml").read_text())
    assert not_refused(tmp_path, REFUSED, "observation.image.", **content) == []
    assert not_refused(tmp_path, OF_NOISE, **content) == []
    assert "no picture" in image(capsys, write_study(tmp_path / "t"))


def test_what_the_command_writes_is_the_same_each_time_with_every_check_and_its_limit(tmp_path, capsys):
    folder = written(tmp_path)
    shown = image(capsys, folder)
    files = {path.name: path.read_bytes() for path in (folder / "image").iterdir()}
    assert sorted(files) == ["edge.csv", "edge.json", "edge.png"]
    assert "σ_N² for normal_offset: none needed" in shown
    assert f"  wrote {folder / 'image' / 'edge.csv'}\n" in shown
    study = load_study(folder)
    table = np.loadtxt(folder / "image" / "edge.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, :2], study.observed[""].points, atol=1e-6)
    assert (np.diff(table[:, 3]) > 0).all()
    assert json.loads(files["edge.json"])["sd"] == pytest.approx(study.pictures[""].errors.sd)
    earlier = f"Did you mean hump.png? ({folder / 'image' / 'edge.png'} still shows an earlier edge.)\n"
    assert image(capsys, written(folder, file="hamp.png")).endswith(earlier)
    write_pictures(study)
    assert {path.name: path.read_bytes() for path in (folder / "image").iterdir()} == files
    # Near the limit of the points: a little more trim is refused.
    shown = image(capsys, written(tmp_path, trim=0.41))
    checks = {one["name"]: one for one in json.loads((tmp_path / "image/edge.json").read_text("utf-8"))["checks"]}
    assert list(checks) == ["points", "contrast over noise", "at the limit of the strip", "blur"]
    assert f"warned: points {checks['points']['value']:.0f} (at least 30, one per pixel)" in shown


def test_the_noise_variance_and_the_residual_are_those_of_the_edge(tmp_path):
    one, wide = loaded(tmp_path).pictures[""], Currents(0.37)
    found = described(one, {"currents": wide, "closest_point": ClosestPoint(direction="symmetric")})["noise_variance"]
    (name, first), (_, second), (_, last) = found.items()
    assert name.startswith("currents, width 0.37")
    assert first == {"value": wide.noise_variance(one.errors, one.interface), "unit": "mm²", "note": None}
    assert second["value"] is None
    assert "a run of the study computes it" in second["note"]
    assert "none needed" in last["note"]
    assert off_smooth(one.edge).std() == pytest.approx(one.edge.errors.sd, rel=0.3)


def test_how_a_picture_was_read_is_said_everywhere_with_its_origin(tmp_path, capsys):
    folder = written(tmp_path, frame={"origin": list(ORIGIN), "x": "right", "rotation": 1})
    study = load_study(folder)
    (one,), picture = read_how(study), study.pictures[""].picture
    assert (one["condition"], one["file"], one["sha256"]) == ("", "hump.png", picture.sha256)
    assert one["notes"] == [
        "pixel size 10 × 10 µm from the study",
        "grey values taken as intensity, because the study states no scale",
        "the model's (0, 0) at pixel (10, 120) from the study; its axes point x right, y up (default), turned by 1°",
        "5 % of the edge left out at either end (`trim`)",
    ]
    assert f"\n  hump.png: {'; '.join(one['notes'])}; sha256 {picture.sha256[:12]}…\n" in check(capsys, folder)
    shown = image(capsys, folder)
    assert all(f"  {note}\n" in shown for note in [*one["notes"], f"sha256 {picture.sha256}"])


def test_each_condition_has_its_picture(tmp_path):
    """The second hump lies ten pixels to the right in the frame of the model."""
    written(tmp_path)
    moved = {"origin": [ORIGIN[0] - 10, ORIGIN[1]]}
    both = [{"condition": "light", **seen()}, {"condition": "heavy", **seen(frame=moved)}]
    changes = {"discrepancy": {"normal_offset": {}}, "noise": IMAGE, "observation": both}
    study = load_study(write_study(tmp_path, **TWO_LOADS_STUDY | changes))
    assert [(picture_png(study, name) or b"")[1:4] for name in ("light", "no such condition")] == [b"PNG", b""]
    middle = {name: one.points[:, 0].mean() for name, one in study.observed.items()}
    assert middle["heavy"] - middle["light"] == pytest.approx(10 * PIXEL)


def test_a_page_to_mark_the_picture_needs_no_path_and_no_scale(tmp_path, capsys):
    """Or the picture to which it is registered: fixed region, scale and origin come from marks on that one alone."""
    folder = written(tmp_path, path="hump.path.json", pixel=None, frame=None)
    assert "hump.mark.html" in image(capsys, folder, "--edit")
    assert "--condition" in image(capsys, folder, "--edit", "--condition", "late")
    picture(tmp_path, seed=2).rename(tmp_path / "bare.png")
    registration = {"to": "bare.png", "marks": "bare.path.json"}
    folder = written(tmp_path, registration=registration, frame=None, pixel=None)
    assert "bare.mark.html" in image(capsys, folder, "--edit", "--reference")
    sha = hashlib.sha256((tmp_path / "bare.png").read_bytes()).hexdigest()
    region = np.array([[10.0, 60.0], [90.0, 40.0], [90.0, 110.0], [10.0, 130.0]])
    marks = Clicks("bare.png", sha, SIZE, np.zeros((0, 2)), origin=ORIGIN, fixed=(region,))
    (tmp_path / "bare.path.json").write_text(json.dumps(as_json(marks)))
    study = loaded(tmp_path, registration=registration, frame=None)
    assert study.pictures[""].registration is not None
    assert abs(off(study).mean()) < 0.2
    assert "without `registration`" in image(capsys, written(tmp_path), "--edit", "--reference")


def test_a_frame_is_said_to_be_turned_if_it_is():
    for rotation, said in ((0.0, False), (3.0, True)):
        assert ("turned by" in frame_note(Frame((3.0, 4.0), (1.0, 1.0), rotation=rotation), None)) is said


@pytest.mark.stand_in
def test_arcs_of_a_picture_begin_at_zero_in_the_order_of_the_interface():
    edge = SimpleNamespace(sds=np.array([1.0, 2.0, 3.0]), arc=np.array([5.0, 6.0, 8.0]))
    for mirrors, sds, arc in ((True, [1.0, 2.0, 3.0], [0.0, 1.0, 3.0]), (False, [3.0, 2.0, 1.0], [0.0, 2.0, 3.0])):
        found = _along(SimpleNamespace(edge=edge, frame=SimpleNamespace(mirrors=mirrors)))
        assert [one.tolist() for one in found] == [sds, arc]
