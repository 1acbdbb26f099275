"""A study whose runs are jobs of a SLURM array, from the command line."""

import json
import signal
import subprocess
import sys

from tests.doors.runs.processes import wait_until
from tests.unit.runs.fakes import attempts

from strandline.cli import main
from strandline.runs import InProcess
from strandline.studies import load_study, run_study
from strandline.testing.studies import write_study

SMALL = {
    "draft": True,
    "report": "none",
    "design": {"sobol": {"runs": 6}},
    "sampler": {"smc": {"particles": 200, "rejuvenation_steps": 2, "zeta": 0.5}},
    "executor": {"slurm_array": {"poll": 0.3, "timeout": 50, "walltime": "00:05:00"}},
}


def test_detached_and_collected(slurm, tmp_path, capsys):
    folder = write_study(tmp_path / "study", **SMALL)
    main(["run", "--quiet", "--detach", str(folder)])
    assert capsys.readouterr().out.startswith("7 runs are with SLURM")
    assert not (folder / "summary.json").exists()
    main(["status", str(folder)])
    assert "ok 0, failed 0, under way (or lost) 6" in capsys.readouterr().out
    main(["run", "--quiet", str(folder)])
    summary = json.loads((folder / "summary.json").read_text())
    assert set(attempts(folder / "ledger.sqlite")) == {1}
    here = run_study(load_study(write_study(tmp_path / "here", **SMALL)), executor=InProcess())
    assert summary["inputs"] == json.loads(json.dumps(here.summary["inputs"]))
    capsys.readouterr()
    (folder / "summary.json").unlink()
    main(["run", "--quiet", "--detach", str(folder)])
    assert "every run of the design is done" in capsys.readouterr().out


def test_ctrl_c_says_what_goes_on(slurm, tmp_path):
    held = {"slurm_array": {"poll": 0.3, "extra": ["--hold"]}}
    folder = write_study(tmp_path / "study", **{**SMALL, "executor": held})
    command = [sys.executable, "-m", "strandline", "run", "--quiet", str(folder)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as driver:
        assert wait_until(lambda: list(folder.glob("slurm/*/job")), 60)
        wait_until(lambda: False, 0.2)
        driver.send_signal(signal.SIGINT)
        _, stderr = driver.communicate(timeout=30)
    assert driver.returncode == 130
    assert "runs that go on in SLURM: 1 (`scancel --name=strandline-" in stderr
    assert len(slurm.command("squeue", "--noheader", "--array").splitlines()) == 1
