"""`strandline run --verbose` shows what the progress leaves out, on the terminal and in the log."""

import re
from pathlib import Path

import pytest

from strandline.cli import main
from strandline.cli.details import detailed, set_aside_lines
from strandline.runs import InProcess, Progress, RunRecord
from strandline.studies import load_study
from strandline.testing.studies import write_study

SMALL = {
    "sampler": {"smc": {"particles": 300, "rejuvenation_steps": 2, "zeta": 0.5}},
    "design": {"sobol": {"runs": 12}},
    "inputs": {
        "E": {"prior": {"uniform": [30, 560]}, "unit": "Pa"},
        "tilt": {"prior": {"uniform": [0.0, 0.04]}},
    },
}


def test_each_run_step_and_setting_is_shown_and_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
    write_study(tmp_path / "beam", **SMALL)
    main(["run", str(tmp_path / "beam"), "--verbose", "--log", str(tmp_path / "log")])
    shown = capsys.readouterr().err
    runs = re.findall(r"^  run [0-9a-f]{12} (\S+)(?: \(\S+\))? in \S+ s at ", shown, re.MULTILINE)
    assert len(runs) == 12
    assert {*runs} == {"ok", "failed"}
    assert re.search(r"failed \(large_deflection\) in .*; no folder is kept\n    the tip would move by", shown)
    assert "  12 runs by LocalProcesses: workers 1, timeout 60.0\n" in shown
    assert "  of the log-likelihood, kernel matern32\n" in shown
    assert "  300 particles, seed 1, SMCSettings: " in shown
    assert len(re.findall(r"^  step to tempering exponent \S+: ESS \d+, accepted ", shown, re.MULTILINE)) >= 2
    logged = (tmp_path / "log").read_text()
    assert len(re.findall(r" run [0-9a-f]{12} ", logged)) == 12
    assert "12 runs by LocalProcesses" in logged


def test_without_it_runs_are_counted_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
    write_study(tmp_path / "beam", **SMALL)
    main(["run", str(tmp_path / "beam")])
    shown = capsys.readouterr().err
    assert "12/12" in shown
    assert not re.search(r"run [0-9a-f]{12} |step to tempering exponent|SMCSettings", shown)


def test_folders_origins_and_reasons(tmp_path: Path) -> None:
    study, lines = load_study(write_study(tmp_path, **SMALL)), list[str]()
    for attempt in (1, 2, 10):
        (tmp_path / "runs" / f"{'a' * 12}-{attempt}").mkdir(parents=True)
    observer, state = detailed(study, InProcess(), lines.append), Progress(3, 1, 1, 0, 0, 1.0)
    observer.run(RunRecord("a" * 64, {"E": 400.0}, "ok", seconds=1.25, origin="../other/ledger.sqlite"), state)
    observer.run(
        RunRecord("b" * 64, {}, "timeout", failure_kind="timeout", message="too long\nits folder: /kept/b-1"), state
    )
    kept = tmp_path / "runs" / f"{'a' * 12}-10"
    assert lines == [
        f"  run aaaaaaaaaaaa ok in 1.25 s at E = 400; its folder: {kept}; taken over from ../other/ledger.sqlite",
        "  run bbbbbbbbbbbb timeout (timeout) in 0 s at ; its folder: /kept/b-1",
        "    too long",
    ]
    one = {"key": "c" * 64, "kind": "flipped", "why": "the points run the other way"}
    assert set_aside_lines({"set_aside": [one]}) == [
        "  run cccccccccccc set aside (flipped): the points run the other way"
    ]


def test_it_excludes_quiet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_study(tmp_path / "beam", **SMALL)
    with pytest.raises(SystemExit) as ended:
        main(["run", str(tmp_path / "beam"), "--verbose", "--quiet"])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "got both; expected at most one of them. Leave one out" in line
    assert [path.name for path in (tmp_path / "beam").iterdir()] == ["study.yaml"]
