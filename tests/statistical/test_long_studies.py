"""Whole studies that take minutes: an example, a killed driver."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from strandline.posterior import read
from strandline.runs import InProcess, Ledger
from strandline.studies import load_study, run_study
from strandline.testing.studies import TWO_LOADS_STUDY, write_study

pytestmark = pytest.mark.long
EXAMPLES = Path(__file__).parents[2] / "examples"
ACTIVE = {
    **TWO_LOADS_STUDY,
    "design": {"active": {"runs": 50, "batch": 4, "check": 20}},
    "noise": {"sd": 0.05},
    "sampler": {"smc": {"particles": 400, "rejuvenation_steps": 5, "zeta": 0.5}},
}


def test_the_example_finds_stiffness_and_poissons_ratio(tmp_path):
    folder = tmp_path / "s"
    folder.mkdir()
    for name in ("study.yaml", "undeformed.png", "deformed.png"):
        shutil.copy(EXAMPLES / "oct-biofilm" / name, folder)
    outcome = run_study(load_study(folder), executor=InProcess())
    posterior, of = outcome.calibration.posterior, outcome.summary["undeformed_outline"]
    assert (np.abs(posterior.mean - [400.0, 0.3]) < 2.5 * posterior.sd).all()
    assert posterior.sd[0] < 60
    assert 1.02 < of["expected_sd"]["E"] / of["expected_sd_without"]["E"] < 2
    assert of["expected_sd"]["E"] == pytest.approx(posterior.sd[0], rel=0.4)


def ended_runs(folder):
    study = load_study(folder)
    if not study.ledger_path.is_file():
        return 0
    with Ledger.open(study.ledger_path, model=None, read_only=True) as ledger:
        return sum(1 for _ in ledger)


def test_a_killed_study_goes_on_to_the_same_posterior(tmp_path):
    """The driver is killed with -9 among its first runs and in a later batch; one worker."""
    whole, killed = (write_study(tmp_path / name, **ACTIVE) for name in ("whole", "killed"))
    command = [sys.executable, "-m", "strandline", "run", "--quiet"]
    subprocess.run([*command, str(whole)], check=True, capture_output=True)
    for after in (3, 9):
        driver = subprocess.Popen([*command, str(killed)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while driver.poll() is None and ended_runs(killed) < after:
            time.sleep(0.02)
        assert driver.poll() is None
        driver.send_signal(signal.SIGKILL)
        driver.wait()
    subprocess.run([*command, str(killed)], check=True, capture_output=True)
    assert read(whole / "posterior.nc").identical(read(killed / "posterior.nc"))
    one, other = (json.loads((folder / "summary.json").read_text()) for folder in (whole, killed))
    assert one["certificate"] == other["certificate"]
