"""The first steps: `strandline init` and `noise` begin a study, `check` and `forward` make one run."""

import io
import json
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import yaml
from tests.unit.cli.command_line import ALL_SET, contents, ends, printed, refused

from strandline.calibration import Observer
from strandline.cli import main
from strandline.cli.forward import told_if_slow
from strandline.cli.run import _doubting
from strandline.interface import Interface, PointErrors, UnknownErrors
from strandline.models.biofilm.model import Biofilm
from strandline.runs import LocalProcesses
from strandline.studies import load_study
from strandline.studies.keys.folder import is_result
from strandline.studies.keys.observation import StudyNoise
from strandline.studies.keys.template import EXAMPLES, FOLDERS
from strandline.studies.load.observed import build_noise
from strandline.testing.studies import beam, undeclared_beam, write_study

ROOT = Path(__file__).parents[3]


def test_a_new_study_is_sound(tmp_path, capsys):
    folder = tmp_path / "my first study"
    shown = printed(capsys, "init", str(folder))
    assert shown.startswith(f"wrote {folder}/study.yaml\nnext: strandline check '{folder}'")
    assert list(contents(folder)) == ["study.yaml"]
    assert load_study(folder).name == "my-first-study"
    for item in Biofilm().inputs:
        assert f"# {item.meaning}" in (folder / "study.yaml").read_text("utf-8")


def test_a_study_of_an_observed_interface(tmp_path, monkeypatch, capsys):
    """Its errors are stated, asked for, or unknown."""
    x = np.linspace(0.3, 0.9, 40)
    np.savetxt(tmp_path / "my edge.csv", np.stack([x, x * (1.2 - x)], axis=1), delimiter=",")
    typed = io.StringIO("inch\nmm\n-3\n2.5\n10\n8\n\n\n1\n")
    typed.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", typed)
    stated = ["--unit", "mm", "--sd", "3", "--length", "15", "--shift", "0", "--rotation", "0.5", "--scale", "0.005"]
    for options, noise in (
        ([*stated, "--offset", "0"], PointErrors(0.003, 0.015, rotation=0.5, scale=0.005)),
        ([], PointErrors(0.0025, 0.01, shift=0.008, offset=0.001)),
    ):
        folder = tmp_path / "a" / f"b{len(options)}"
        main(["init", str(folder), "--observed", str(tmp_path / "my edge.csv"), *options])
        study = load_study(folder)
        assert (list(study.observed), list(study.discrepancies)) == ([""], ["normal_offset"])
        assert study.noise == noise
    monkeypatch.setattr("sys.stdin", io.StringIO())
    for name in ("command", "python"):
        main(["init", str(tmp_path / name), "--example", name, "--observed", str(tmp_path / "my edge.csv"), *stated])
        study = load_study(tmp_path / name)
        assert study.observed[""].points.shape == (40, 2)
        assert study.noise == PointErrors(0.003, 0.015, rotation=0.5, scale=0.005)
        assert "observed.csv" not in contents(tmp_path / name)
        assert contents(tmp_path / name)["my edge.csv"] == (tmp_path / "my edge.csv").read_bytes()
        text = (tmp_path / name / "study.yaml").read_text("utf-8")
        assert text.startswith("# Your observed interface")
        assert "../" not in text
    assert "\nadapt there: model, fixed and inputs " in capsys.readouterr().out
    edge = str(tmp_path / "my edge.csv")
    words = refused(capsys, "init", str(tmp_path / "d"), "--example", "oct", "--observed", edge)
    assert "one of biofilm, python, command" in words
    unknown = ["--observed", edge, "--unit", "mm", "--sd", "unknown"]
    main(["init", str(tmp_path / "c"), *unknown])
    assert load_study(tmp_path / "c").noise == UnknownErrors(None, 0.0)
    assert "length: 0" not in (tmp_path / "c" / "study.yaml").read_text()


def test_all_files_of_an_example_are_written(tmp_path, capsys, monkeypatch):
    for name in EXAMPLES:
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        shown = printed(capsys, "init", "my one", "--example", name)
        assert shown.endswith("next: strandline check 'my one', then strandline run 'my one'\n")
        written = contents(Path("my one"))
        text = (written["study.yaml"] or b"").decode()
        assert "\nname: my-one\n" in text
        assert "strandline run my one" in text or "strandline check my one" in text
        source = ROOT / "examples" / FOLDERS.get(name, name)
        files = (one for one in source.iterdir() if one.is_file() and not is_result(one))
        shipped = {one.name: one.read_bytes() for one in files}
        assert {**written, "study.yaml": shipped["study.yaml"]} == shipped


def test_no_example_overwrites_anything(tmp_path, capsys):
    (tmp_path / "strip.py").write_text("mine")
    assert "already" in refused(capsys, "init", str(tmp_path), "--example", "python")
    assert contents(tmp_path) == {"strip.py": b"mine"}


TRUE, ANGLE = PointErrors(0.002, 0.012), np.linspace(0.0, np.pi, 2000)
ARCH = Interface.polyline(np.stack([-0.5 * np.cos(ANGLE), 0.4 * np.sin(ANGLE)], axis=1)).resampled(300)
"""Open, 1.4 mm long."""


def contours(folder, number, errors=TRUE):
    folder.mkdir()
    random = np.random.default_rng(1)
    for k in range(number):
        seen = 1e3 * errors.draw(ARCH, random).points
        np.savetxt(folder / f"contour-{k}.csv", seen, delimiter=",", header="x,y", comments="")
    return folder


def stated(shown):
    """Return the errors that the last line, put into a study, states."""
    (key,) = yaml.safe_load(shown.splitlines()[-1]).values()
    return build_noise(StudyNoise.model_validate(key), ())


def test_the_noise_of_repeats(tmp_path, capsys):
    shown = printed(capsys, "noise", str(contours(tmp_path / "seen", 8)), "--unit", "um")
    assert shown.startswith("8 contours, compared at ")
    found = stated(shown)
    assert found.sd == pytest.approx(TRUE.sd, rel=0.15)
    assert found.length == pytest.approx(TRUE.length, rel=0.5)
    folder = contours(tmp_path / "shifted", 8, PointErrors(0.002, 0.012, shift=0.03))
    shown = printed(capsys, "noise", *sorted(map(str, folder.iterdir())), "--unit", "um")
    assert "common to all points of a contour, sd over the contours: shift " in shown
    assert 0.008 < stated(shown).shift < 0.06


def test_the_noise_of_one_contour(tmp_path, capsys):
    path = contours(tmp_path / "seen", 1) / "contour-0.csv"
    shown = printed(capsys, "noise", str(path), "--unit", "um", "--window", "200")
    assert shown.startswith("1 contour of 300 points ")
    assert 0.6 * TRUE.sd < stated(shown).sd < 1.4 * TRUE.sd
    assert "independent" not in shown
    path = contours(tmp_path / "white", 1, PointErrors(0.002)) / "contour-0.csv"
    assert " (independent points: half their distance)\n" in printed(capsys, "noise", str(path), "--unit", "um")


INPUTS = {"E": 400.0, "tilt": 0.02, "load": 1e-5}


def test_it_makes_one_run_and_writes_nothing(tmp_path, capsys, monkeypatch):
    model = Mock(side_effect=undeclared_beam)
    monkeypatch.setattr("strandline.testing.studies.undeclared_beam", model)
    folder = write_study(tmp_path / "study")
    shown = printed(capsys, "check", str(folder))
    assert [one.args[0] for one in model.call_args_list] == [{"load": 1e-5, "E": 430.0, "tilt": 0.02}]
    assert list(contents(folder)) == ["study.yaml"]
    assert "beam: study.yaml is sound" in shown
    assert "64 forward runs planned, 0 of them known already" in shown
    assert "E [Pa]: Uniform(low=300.0, high=560.0)" in shown
    assert "add --widths to predict the widths of the posterior: 2 more runs" in shown


def test_what_is_waited_for_is_said_after_ten_seconds(tmp_path, capsys, monkeypatch):
    """By timers that have run down at once."""
    timers = []

    def timer(seconds, function, arguments):
        assert seconds == 10.0
        timers.append(Mock(start=lambda: function(*arguments)))
        return timers[-1]

    study = load_study(write_study(tmp_path / "study"))
    monkeypatch.setattr("strandline.cli.forward.told_if_slow", partial(told_if_slow, timer=timer))
    main(["check", str(study.folder)])
    told = capsys.readouterr().err
    assert told.startswith("still waiting for the run at load = 1e-05, E = 430, tilt = 0.02, 10 s after its start")
    for timeout in (None, 60.0):
        notes = []
        with _doubting(study, LocalProcesses(timeout=timeout), Observer(note=notes.append)) as observer:
            observer.stage("forward")
            observer.stage("surrogate")
        assert ["`timeout` of the executor" in one for one in notes] == [True] * (timeout is None)
    assert [one.cancel.call_count for one in timers] == [1, 1]


def test_a_check_as_json(tmp_path, capsys):
    folder = write_study(tmp_path / "study")
    found = json.loads(printed(capsys, "check", str(folder), "--json", "--widths"))
    assert found["run"]["inputs"]["E"] == pytest.approx(430.0)
    assert found["inputs"]["tilt"] == {"unit": "1", "box": [0.0, 0.04], "nuisance": False}
    assert (found["planned"], found["known"]) == (64, 0)
    assert any("2 more runs" in line for line in found["lines"])


def test_a_forward_run_in_words_as_json_and_as_a_table_that_can_be_observed(tmp_path, capsys):
    folder = write_study(tmp_path / "study")
    forward, csv = ["forward", str(folder)], folder / "observed.csv"
    shown = printed(capsys, *forward, "--set", "E=400", "--set", " tilt = 0", "--set", "load=2e-5")
    assert shown.startswith("ok in 0.0")
    assert shown.endswith(": tip 0.2\n")
    assert list(contents(folder)) == ["study.yaml"]
    found = json.loads(printed(capsys, *forward, *ALL_SET, "--csv", str(csv), "--json"))
    assert found["inputs"] == INPUTS
    assert (found["state"], found["failure"], found["csv"]) == ("ok", None, str(csv))
    assert found["tip"] == pytest.approx(0.12)
    assert csv.read_text().startswith("x,y\n")
    points = np.loadtxt(csv, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(points, beam(INPUTS, tmp_path).interface.points)
    write_study(folder, observation={"file": "observed.csv", "unit": "mm"})
    assert "tracked_points: log-likelihood -" in printed(capsys, "check", str(folder))


def test_a_forward_run_that_fails_is_an_answer_too(tmp_path, capsys):
    csv = tmp_path / "interface.csv"
    too_far = ["forward", str(write_study(tmp_path / "study")), *ALL_SET, "--set", "load=1"]
    found = json.loads(printed(capsys, *too_far, "--json", "--csv", str(csv)))
    assert (found["state"], found["failure"]["kind"], found["csv"]) == ("failed", "large_deflection", None)
    assert not csv.exists()
    assert ends(*too_far) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "large_deflection: the tip would move by 1e+04 mm" in line
