"""The subcommands on a small study: what they print, write, and leave alone."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.cli import main
from strandline.interface import Noise, PointErrors, UnknownErrors
from strandline.runs import Ledger
from strandline.studies import load_study
from strandline.testing.studies import BEAM_STUDY, beam, undeclared_beam, write_study

COMMAND = [sys.executable, "-c", "from strandline.cli import main; main()"]
INPUTS = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
SMALL: dict[str, Any] = {
    "design": {"sobol": {"runs": 32}},
    "sampler": {"smc": {"particles": 200, "rejuvenation_steps": 2, "zeta": 0.5}},
}
SLOW_MODEL = """
import time
from pathlib import Path
from strandline.testing.studies import undeclared_beam

def slow(inputs, workdir):
    time.sleep(0.0 if Path(__file__).with_name("hurry").exists() else 1.0)
    return undeclared_beam(inputs, workdir)
"""


def listing(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    main(list(arguments))
    shown = capsys.readouterr()
    assert shown.err == ""
    return shown.out


class TestForward:
    def test_json_and_csv(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        folder, csv = write_study(tmp_path / "study"), tmp_path / "interface.csv"
        options = ["--set", "E=400", "--set", "tilt=0.02", "--csv", str(csv), "--json"]
        found = json.loads(printed(capsys, "forward", str(folder), *options))
        assert found["inputs"] == INPUTS
        assert (found["state"], found["failure"], found["csv"]) == ("ok", None, str(csv))
        assert found["tip"] == pytest.approx(0.12)
        assert found["seconds"] >= 0
        points = np.loadtxt(csv, delimiter=",", skiprows=1)
        np.testing.assert_array_equal(points, beam(INPUTS, tmp_path).interface.points)
        assert csv.read_text().startswith("x,y\n")
        assert listing(folder) == ["study.yaml"]

    def test_the_csv_can_be_observed(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        folder = write_study(tmp_path / "study")
        csv = folder / "observed.csv"
        printed(capsys, "forward", str(folder), "--set", "E=400", "--set", "tilt=0.02", "--csv", str(csv))
        write_study(folder, observation={"file": "observed.csv", "unit": "mm"})
        shown = printed(capsys, "check", str(folder))
        assert "tracked_points: log-likelihood -" in shown

    def test_fixed_quantities_can_be_set(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        options = ["--set", "E=400", "--set", " tilt = 0", "--set", "load=2e-5", "--json"]
        found = json.loads(printed(capsys, "forward", str(write_study(tmp_path)), *options))
        assert found["tip"] == pytest.approx(0.2)

    def test_in_words(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        shown = printed(capsys, "forward", str(write_study(tmp_path)), "--set", "E=400", "--set", "tilt=0.02")
        assert shown.startswith("ok in 0.0")
        assert shown.endswith(": tip 0.12\n")

    def test_a_failure_as_json(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        csv = tmp_path / "interface.csv"
        options = ["--set", "E=400", "--set", "tilt=0.5", "--set", "load=1", "--json", "--csv", str(csv)]
        found = json.loads(printed(capsys, "forward", str(write_study(tmp_path)), *options))
        assert found["state"] == "failed"
        assert found["failure"]["kind"] == "large_deflection"
        assert found["failure"]["message"].startswith("the tip would move by 1e+04 mm")
        assert found["tip"] == pytest.approx(10000.5)
        assert found["csv"] is None
        assert not csv.exists()

    def test_a_failure_in_words(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        options = ["--set", "E=400", "--set", "tilt=0.5", "--set", "load=1"]
        with pytest.raises(SystemExit) as ended:
            main(["forward", str(write_study(tmp_path)), *options])
        assert ended.value.code == 1
        shown = capsys.readouterr()
        assert shown.out == ""
        assert "large_deflection: the tip would move by 1e+04 mm" in shown.err
        assert len(shown.err.splitlines()) == 1


class TestCheckOfAnchors:
    @pytest.mark.parametrize(
        ("rate", "expected"), [(100, "anchors: 16 of the 16"), (99, "warning: anchors: 0 of the 16")]
    )
    def test_it_says_how_many_runs_start_from_them(
        self,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        monkeypatch: pytest.MonkeyPatch,
        rate: int,
        expected: str,
    ) -> None:
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
        anchors = {"E": [400, 700], "nu": 0.3, "V_in": 100}
        folder = write_study(
            tmp_path / "study",
            model={"biofilm": {"mesh": "coarse", "anchors": anchors}},
            fixed={"V_in": rate, "nu": 0.3},
            inputs={"E": {"prior": {"uniform": [400, 700]}, "unit": "Pa"}},
            observation={"synthetic": {"E": 500, "nu": 0.3, "V_in": rate}},
            design={"sobol": {"runs": 16}},
        )
        assert f"{expected} planned runs start from them" in printed(capsys, "check", str(folder))


class TestCheck:
    def test_one_run_and_nothing_written(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        calls: list[Any] = []

        def noted(inputs: Any, workdir: Path) -> Any:
            calls.append(inputs)
            return undeclared_beam(inputs, workdir)

        monkeypatch.setattr("strandline.testing.studies.undeclared_beam", noted)
        folder = write_study(tmp_path / "study")
        shown = printed(capsys, "check", str(folder))
        assert calls == [{"load": 1e-5, "E": 430.0, "tilt": 0.02}]
        assert listing(folder) == ["study.yaml"]
        assert "beam: study.yaml is sound" in shown
        assert "64 forward runs planned, 0 of them known already" in shown
        assert "E [Pa]: Uniform(low=300.0, high=560.0)" in shown

    def test_a_cut_prior_and_known_runs_are_told(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        E = {"prior": {"lognormal": [6.0, 0.2]}, "box": [300, 560], "unit": "Pa"}
        folder = write_study(tmp_path / "study", inputs={**BEAM_STUDY["inputs"], "E": E})
        Ledger.open(folder / "ledger.sqlite", model="test:beam-1").close()
        shown = printed(capsys, "check", str(folder))
        assert "11.98% of its mass cut off by the box" in shown
        assert "0 of them known already" in shown


class TestInit:
    def test_what_it_writes_is_accepted(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        folder = tmp_path / "my first study"
        shown = printed(capsys, "init", str(folder))
        assert shown.startswith(f"wrote {folder}/study.yaml\nnext: strandline check '{folder}'")
        assert listing(folder) == ["study.yaml"]
        assert "name: my-first-study\n" in (folder / "study.yaml").read_text()
        shown = printed(capsys, "check", str(folder))
        assert "my-first-study: study.yaml is sound" in shown
        assert "max_displacement" in shown

    def test_it_never_overwrites(self, tmp_path: Path) -> None:
        printed_before = (write_study(tmp_path) / "study.yaml").read_bytes()
        with pytest.raises(SystemExit) as ended:
            main(["init", str(tmp_path)])
        assert ended.value.code == 2
        assert (tmp_path / "study.yaml").read_bytes() == printed_before


class Typed(io.StringIO):
    """Answers typed at a terminal."""

    def isatty(self) -> bool:
        return True


class TestInitWithAnObservation:
    @pytest.fixture
    def seen(self, tmp_path: Path) -> Path:
        x = np.linspace(0.3, 0.9, 40)
        np.savetxt(tmp_path / "my edge.csv", np.stack([x, x * (1.2 - x)], axis=1), delimiter=",")
        return tmp_path / "my edge.csv"

    def noise(self, folder: Path) -> PointErrors | UnknownErrors | Noise:
        study = load_study(folder)
        assert list(study.observed) == [""]
        assert list(study.discrepancies) == ["normal_offset"]
        return study.noise

    def test_errors_that_are_stated(self, seen: Path, tmp_path: Path) -> None:
        stated = ["--unit", "mm", "--sd", "3", "--length", "15", "--rotation", "0.5", "--scale", "0.005"]
        main(["init", str(tmp_path / "a" / "b"), "--observed", str(seen), *stated])
        assert self.noise(tmp_path / "a" / "b") == PointErrors(0.003, 0.015, rotation=0.5, scale=0.005)

    def test_errors_that_are_asked_for(self, seen: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("sys.stdin", Typed("inch\nmm\n-3\n2.5\n10\n8\n\n\n1\n"))
        main(["init", str(tmp_path / "b"), "--observed", str(seen)])
        assert self.noise(tmp_path / "b") == PointErrors(0.0025, 0.01, shift=0.008, offset=0.001)

    def test_errors_that_nobody_knows(self, seen: Path, tmp_path: Path) -> None:
        main(["init", str(tmp_path / "b"), "--observed", str(seen), "--unit", "mm", "--sd", "unknown"])
        assert self.noise(tmp_path / "b") == UnknownErrors(None, 0.0)

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (["--sd", "3"], "--sd describes an observed interface: got none; expected --observed FILE too."),
            (["--observed", "none.csv", "--unit", "mm", "--sd", "3"], "--observed: got none.csv; expected a file"),
            (["--observed", "SEEN", "--sd", "3"], "--unit of the observed interface: got nothing"),
            (["--observed", "SEEN", "--unit", "mm"], "--sd of the observed interface: got nothing"),
            (["--observed", "SEEN", "--unit", "mm", "--sd", "0"], "--sd: got 0; expected a number above 0"),
            (
                ["--observed", "SEEN", "--unit", "mm", "--sd", "-1"],
                "Invalid value for '--sd': -1.0 is not in the range",
            ),
            (["--observed", "SEEN", "--unit", "mm", "--sd", "few"], "Invalid value for '--sd': 'few' is not a valid"),
        ],
    )
    def test_bad_input_leaves_no_folder(
        self, options: list[str], words: str, seen: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        with pytest.raises(SystemExit) as ended:
            main(["init", str(tmp_path / "b"), *(str(seen) if word == "SEEN" else word for word in options)])
        said = capsys.readouterr().err
        assert (ended.value.code, len(said.splitlines())) == (2, 1)
        assert words in said
        assert not (tmp_path / "b").exists()


def interrupted_run(folder: Path) -> subprocess.CompletedProcess[str]:
    """Start `strandline run` in a process of its own, press Ctrl-C after a few runs, and return how it ended."""
    process = subprocess.Popen(
        [*COMMAND, "run", str(folder), "--quiet"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(folder.parent)},
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while finished_runs(folder) < 4 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=30)
    return subprocess.CompletedProcess([], process.returncode, out, err)


def test_run_interrupted_run_status_and_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The life of a small study with worker processes: Ctrl-C, the rest, its status, its results anew."""
    (tmp_path / "slow_beam.py").write_text(SLOW_MODEL)
    monkeypatch.syspath_prepend(tmp_path)
    folder = write_study(tmp_path / "study", model={"python": {"function": "slow_beam:slow"}}, **SMALL)

    ended = interrupted_run(folder)
    message = "strandline: interrupted; what is finished is kept; run the same command again to go on\n"
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", message)
    kept = finished_runs(folder) - 1  # one run is the synthetic observation
    assert 3 <= kept < 32
    assert f"{kept} of 32 runs" in printed(capsys, "status", str(folder))

    (tmp_path / "hurry").touch()
    main(["run", str(folder), "--workers", "1"])
    shown = capsys.readouterr()
    assert f"beam: 32 forward runs ok, 0 failed ({32 - kept} new, {kept} reused)" in shown.out
    assert f"report: {folder}/report.html" in shown.out
    stages = ["observation …", "forward runs …", "surrogate …", "sampling …", "checks …"]
    assert [line for line in shown.err.splitlines() if line in stages] == stages
    assert "  32/32 32 ok, 0 failed" in shown.err
    summary = json.loads((folder / "summary.json").read_text())
    for name, item in summary["inputs"].items():
        row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name])
        for figure in ("mean", "sd", "median", "q05", "q95", "map"):
            assert f"{item[figure]:.4g}" in row

    shown_status = printed(capsys, "status", str(folder))
    assert "beam: 32 of 32 runs of the design done" in shown_status
    assert "results: written" in shown_status

    (folder / "summary.json").unlink()
    monkeypatch.setattr("strandline.studies.run.write_report", lambda *_, folder, **__: folder / "report.html")
    assert "(0 new, 32 reused)" in printed(capsys, "report", str(folder), "--quiet")
    assert json.loads((folder / "summary.json").read_text())["inputs"] == summary["inputs"]


def test_status_tells_of_failures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_study(tmp_path / "study", fixed={"load": 1.0}, design={"sobol": {"runs": 4}})
    assert "0 of 4 runs of the design done" in printed(capsys, "status", str(folder))
    with pytest.raises(SystemExit):
        main(["run", str(folder), "--quiet"])
    capsys.readouterr()
    shown = printed(capsys, "status", str(folder))
    assert "ok 0, failed 4, under way 0, to do 0\n" in shown
    assert "no driver at work" in shown
    assert "4 × large_deflection; e.g. E = 300, tilt = 0: the tip would move by" in shown
    assert "results: not yet" in shown


def finished_runs(folder: Path) -> int:
    path = folder / "ledger.sqlite"
    if not path.is_file():
        return 0
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return ledger.counts().ok
