"""The page of a study on the machine that submits its runs, while SLURM makes them."""

import json
import signal
import subprocess
import sys
import threading
import time

import httpx

from strandline.testing.studies import write_study

HELD = {
    "design": {"sobol": {"runs": 12}},
    "sampler": {"smc": {"particles": 200, "rejuvenation_steps": 2, "zeta": 0.5}},
    "executor": {"slurm_array": {"poll": 0.3, "timeout": 50, "walltime": "00:05:00", "extra": ["--hold"]}},
}
STRANDLINE = [sys.executable, "-m", "strandline"]


def released(slurm, until):
    """Let every job go on, as it comes, until the event is set."""
    while not until.wait(0.3):
        for job in slurm.command("squeue", "--noheader", "--format=%A").split():
            slurm.command("scontrol", "release", job, check=False)


def test_the_page_shows_runs_as_slurm_makes_them(slurm, tmp_path):
    """The page comes first: it has seen the study without a run."""
    folder, done = write_study(tmp_path / "study", **HELD), threading.Event()
    driver = subprocess.Popen([*STRANDLINE, "run", "--quiet", str(folder)], stderr=subprocess.DEVNULL)
    page = subprocess.Popen([*STRANDLINE, "view", "--no-browser", str(folder)], stdout=subprocess.PIPE, text=True)
    try:
        address = page.stdout.readline().split()[-1]
        with httpx.stream("GET", f"{address}events", timeout=60) as stream:
            told = (json.loads(line[6:]) for line in stream.iter_lines() if line.startswith("data: "))
            states = (one for one in told if "ok" in one)
            assert next(states)["ok"] == 0
            threading.Thread(target=released, args=(slurm, done), daemon=True).start()
            deadline = time.monotonic() + 120
            last = next(one for one in states if one["ok"] == 12 or time.monotonic() > deadline)
        assert (last["ok"], last["failed"]) == (12, 0)
        assert len(httpx.get(f"{address}api/runs", timeout=60).json()["state"]) == 13  # with that of the observation
        assert driver.wait(timeout=120) == 0
    finally:
        done.set()
        driver.terminate()
        page.send_signal(signal.SIGINT)
        page.communicate(timeout=60)
    assert (folder / "summary.json").is_file()
