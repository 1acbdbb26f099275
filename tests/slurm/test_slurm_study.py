"""A study whose runs are jobs of a SLURM array, from the command line."""

import json
import signal
import subprocess
import sys
import time

import pytest

from strandline.cli import main
from strandline.runs import InProcess, Ledger
from strandline.studies import load_study, run_study
from strandline.testing.studies import write_study

SMALL = {
    "design": {"sobol": {"runs": 12}},
    "sampler": {"smc": {"particles": 200, "rejuvenation_steps": 2, "zeta": 0.5}},
    "executor": {"slurm_array": {"poll": 0.3, "timeout": 50, "walltime": "00:05:00"}},
}
COMMAND = [sys.executable, "-m", "strandline", "run", "--quiet"]


def test_detached_and_collected(slurm, tmp_path, capsys):
    folder = write_study(tmp_path / "study", **SMALL)
    main(["run", "--quiet", "--detach", str(folder)])
    shown = capsys.readouterr().out
    assert shown.startswith("13 runs are with SLURM")
    assert f"strandline run {folder}" in shown
    assert not (folder / "summary.json").exists()
    main(["status", str(folder)])
    assert "ok 0, failed 0, under way (or lost) 12" in capsys.readouterr().out
    main(["run", "--quiet", str(folder)])
    summary = json.loads((folder / "summary.json").read_text())
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert {ledger.attempts(record.key) for record in ledger} == {1}
    here = run_study(load_study(write_study(tmp_path / "here", **SMALL)), executor=InProcess())
    assert summary["inputs"] == json.loads(json.dumps(here.summary["inputs"]))
    capsys.readouterr()
    main(["run", "--quiet", "--detach", str(folder)])
    assert "12 forward runs ok, 0 failed (0 new, 12 reused)" in capsys.readouterr().out, "nothing has changed"
    (folder / "summary.json").unlink()
    main(["run", "--quiet", "--detach", str(folder)])
    assert "every run of the design is done" in capsys.readouterr().out


def test_ctrl_c_says_what_goes_on(slurm, tmp_path):
    held = {"slurm_array": {"poll": 0.3, "extra": ["--hold"]}}
    folder = write_study(tmp_path / "study", **{**SMALL, "executor": held})
    with subprocess.Popen([*COMMAND, str(folder)], stderr=subprocess.PIPE, text=True) as driver:
        deadline = time.monotonic() + 60
        while not list(folder.glob("slurm/*/job")) and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(0.5)
        driver.send_signal(signal.SIGINT)
        _, stderr = driver.communicate(timeout=30)
    assert driver.returncode == 130
    assert "runs that go on in SLURM: 1 (`scancel --name=strandline-" in stderr
    assert len(slurm.command("squeue", "--noheader", "--array").splitlines()) == 1


def test_a_timeout_above_the_walltime_ends_with_exit_code_2(tmp_path, capsys):
    bad = {"slurm_array": {"timeout": 300, "walltime": "00:05:00"}}
    folder = write_study(tmp_path / "study", **{**SMALL, "executor": bad})
    with pytest.raises(SystemExit) as ended:
        main(["run", str(folder)])
    assert ended.value.code == 2
    assert "at most 240 s" in capsys.readouterr().err
    assert [path.name for path in folder.iterdir()] == ["study.yaml"]


def test_detach_wants_an_executor_that_can(tmp_path, capsys):
    folder = write_study(tmp_path / "study", **{**SMALL, "executor": {"in_process": {}}})
    with pytest.raises(SystemExit) as ended:
        main(["run", "--detach", str(folder)])
    assert ended.value.code == 2
    assert "executor: {slurm_array: …}" in capsys.readouterr().err
