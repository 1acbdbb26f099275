"""`strandline forward`: one run, as words, JSON and a table."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.unit.cli.command_line import ALL_SET, Shown, contents, ends, printed

from strandline.testing.studies import beam, write_study

INPUTS = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
TOO_FAR = ("--set", "E=400", "--set", "tilt=0.5", "--set", "load=1")


def test_a_run_as_json_and_table(tmp_path: Path, capsys: Shown) -> None:
    folder, csv = write_study(tmp_path / "study"), tmp_path / "interface.csv"
    found = json.loads(printed(capsys, "forward", str(folder), *ALL_SET, "--csv", str(csv), "--json"))
    assert found["inputs"] == INPUTS
    assert (found["state"], found["failure"], found["csv"]) == ("ok", None, str(csv))
    assert found["tip"] == pytest.approx(0.12)
    assert found["seconds"] >= 0
    points = np.loadtxt(csv, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(points, beam(INPUTS, tmp_path).interface.points)
    assert csv.read_text().startswith("x,y\n")
    assert list(contents(folder)) == ["study.yaml"]


def test_a_run_in_words_with_a_fixed_quantity_set(tmp_path: Path, capsys: Shown) -> None:
    options = ["--set", "E=400", "--set", " tilt = 0", "--set", "load=2e-5"]
    shown = printed(capsys, "forward", str(write_study(tmp_path)), *options)
    assert shown.startswith("ok in 0.0")
    assert shown.endswith(": tip 0.2\n")


def test_the_table_can_be_observed(tmp_path: Path, capsys: Shown) -> None:
    folder = write_study(tmp_path / "study")
    printed(capsys, "forward", str(folder), *ALL_SET, "--csv", str(folder / "observed.csv"))
    write_study(folder, observation={"file": "observed.csv", "unit": "mm"})
    assert "tracked_points: log-likelihood -" in printed(capsys, "check", str(folder))


def test_a_run_that_fails_is_an_answer_too(tmp_path: Path, capsys: Shown) -> None:
    folder, csv = str(write_study(tmp_path / "study")), tmp_path / "interface.csv"
    found = json.loads(printed(capsys, "forward", folder, *TOO_FAR, "--json", "--csv", str(csv)))
    assert found["state"] == "failed"
    assert found["failure"]["kind"] == "large_deflection"
    assert found["failure"]["message"].startswith("the tip would move by 1e+04 mm")
    assert found["tip"] == pytest.approx(10000.5)
    assert found["csv"] is None
    assert not csv.exists()
    assert ends("forward", folder, *TOO_FAR) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "large_deflection: the tip would move by 1e+04 mm" in shown.err
    assert len(shown.err.splitlines()) == 1
