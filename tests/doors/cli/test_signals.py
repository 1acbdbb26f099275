"""Signals: one line, 128 + n, no process left, finished runs kept, and the same command goes on."""

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.unit.cli.command_line import Shown, printed
from verification.validation.command_faults import MARKER, processes_with

from strandline.cli import main
from strandline.runs import Ledger
from strandline.testing.studies import write_study

SLOW_MODEL = """
import time
from pathlib import Path
from strandline.testing.studies import undeclared_beam

def slow(inputs, workdir):
    time.sleep(0.0 if Path(__file__).with_name("hurry").exists() else 0.3)
    return undeclared_beam(inputs, workdir)
"""
ENDLESS = """
version: 1
name: endless
model:
  command:
    templates: {{in.j2: in.txt}}
    files: [run.sh]
    command: ["/bin/sh", "run.sh"]
    environment: {{{marker}: "{text}"}}
    result: {{file: out.csv, unit: mm}}
inputs: {{E: {{prior: {{uniform: [1, 2]}}, unit: Pa}}}}
observation: {{file: seen.csv, unit: mm}}
discrepancy: {{closest_point: {{}}}}
noise: {{sd: 0.1}}
design: {{sobol: {{runs: 8}}}}
executor: {{local: {{workers: 2}}}}
"""


def until(what: Callable[[], bool], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def finished_runs(folder: Path) -> int:
    path = folder / "ledger.sqlite"
    if not path.is_file():
        return 0
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return ledger.counts().ok


def test_a_run_that_was_interrupted_goes_on(tmp_path: Path, capsys: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "slow_beam.py").write_text(SLOW_MODEL)
    monkeypatch.syspath_prepend(tmp_path)
    folder = write_study(
        tmp_path / "study",
        model={"python": {"function": "slow_beam:slow"}},
        design={"sobol": {"runs": 32}},
        sampler={"smc": {"particles": 1000, "rejuvenation_steps": 4, "zeta": 0.5}},
        draft=True,
        report="none",
    )
    driver = subprocess.Popen(
        [sys.executable, "-m", "strandline", "run", str(folder), "--quiet"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        start_new_session=True,
    )
    until(lambda: finished_runs(folder) >= 4)
    os.killpg(driver.pid, signal.SIGINT)
    out, err = driver.communicate(timeout=30)
    message = "strandline: interrupted; what is finished is kept; run the same command again to go on\n"
    assert (driver.returncode, out, err) == (130, "", message)
    kept = finished_runs(folder) - 1  # one run is the synthetic observation
    assert 3 <= kept < 32
    assert f"{kept} of 32 runs" in printed(capsys, "status", str(folder))
    (tmp_path / "hurry").touch()
    main(["run", str(folder), "--workers", "1", "--json"])
    shown = capsys.readouterr()
    runs = json.loads(shown.out)["runs"]
    assert (runs["ok"], runs["new"], runs["reused"]) == (32, 32 - kept, kept)
    assert "  32/32 32 ok, 0 failed" in shown.err


@pytest.fixture
def marker() -> Iterator[str]:
    text = uuid.uuid4().hex
    yield text
    for pid in processes_with(text):
        os.kill(pid, signal.SIGKILL)


@pytest.fixture
def endless(tmp_path: Path, marker: str) -> Path:
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "study.yaml").write_text(ENDLESS.format(marker=MARKER, text=marker))
    (folder / "in.j2").write_text("{{ E }}")
    (folder / "seen.csv").write_text("0,0\n1,1\n2,0\n")
    (folder / "run.sh").write_text("trap '' TERM HUP INT; sleep 600 & sleep 600; sleep 600")
    return folder


@pytest.mark.skipif(sys.platform != "linux", reason="processes are looked for in /proc")
@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        pytest.param(signal.SIGHUP, marks=pytest.mark.long),
        pytest.param(signal.SIGINT, marks=pytest.mark.long),
    ],
)
def test_a_signal_ends_a_run_and_all_its_children(
    endless: Path, marker: str, number: signal.Signals, tmp_path: Path
) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    driver = subprocess.Popen(
        [sys.executable, "-m", "strandline", "run", "--quiet", str(endless)],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    try:
        until(lambda: len(processes_with(marker)) >= 8)  # of each run, supervisor, sh, two sleep
        assert driver.poll() is None
        driver.send_signal(number)
        _, said = driver.communicate(timeout=30.0)
    finally:
        driver.kill()
        driver.wait()
    assert driver.returncode == 128 + number
    assert said.count("\n") == 1
    assert said.startswith("strandline: interrupted")
    assert number == signal.SIGINT or number.name in said
    until(lambda: not processes_with(marker), 10.0)
    assert list(temporary.glob("strandline-*")) == []
    with Ledger.open(endless / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().open == 0
        assert [(record.state, record.failure_kind) for record in ledger] == [("killed", "interrupted")] * 2
        assert [ledger.attempts(record.key) for record in ledger] == [0, 0]
