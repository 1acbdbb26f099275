"""SIGTERM and SIGHUP end a run as Ctrl-C does: one line, 128 + n, no process left, the runs under way not counted."""

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from verification.validation.command_faults import MARKER, processes_with

from strandline.cli import signals
from strandline.runs import Ledger

linux = pytest.mark.skipif(sys.platform != "linux", reason="processes are looked for in /proc")

STUDY = """
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


@pytest.fixture
def marker() -> Iterator[str]:
    text = uuid.uuid4().hex
    yield text
    for pid in processes_with(text):
        os.kill(pid, signal.SIGKILL)


@pytest.fixture
def study(tmp_path: Path, marker: str) -> Path:
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "study.yaml").write_text(STUDY.format(marker=MARKER, text=marker))
    (folder / "in.j2").write_text("{{ E }}")
    (folder / "seen.csv").write_text("0,0\n1,1\n2,0\n")
    (folder / "run.sh").write_text("trap '' TERM HUP INT; sleep 600 & sleep 600; sleep 600")
    return folder


@linux
@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        pytest.param(signal.SIGHUP, marks=pytest.mark.long),
        pytest.param(signal.SIGINT, marks=pytest.mark.long),
    ],
)
def test_a_signal_ends_a_run_and_all_its_children(
    study: Path, marker: str, number: signal.Signals, tmp_path: Path
) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    driver = subprocess.Popen(
        [sys.executable, "-m", "strandline", "run", "--quiet", str(study)],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    try:
        deadline = time.monotonic() + 60.0
        while len(processes_with(marker)) < 8 and time.monotonic() < deadline:  # of each run, supervisor, sh, two sleep
            assert driver.poll() is None
            time.sleep(0.05)
        driver.send_signal(number)
        _, said = driver.communicate(timeout=30.0)
    finally:
        driver.kill()
        driver.wait()
    assert driver.returncode == 128 + number
    assert said.count("\n") == 1
    assert said.startswith("strandline: interrupted")
    assert number == signal.SIGINT or number.name in said
    deadline = time.monotonic() + 10.0
    while processes_with(marker) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert processes_with(marker) == []
    assert list(temporary.glob("strandline-*")) == []
    with Ledger.open(study / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().open == 0
        assert [(record.state, record.failure_kind) for record in ledger] == [("killed", "interrupted")] * 2
        assert [ledger.attempts(record.key) for record in ledger] == [0, 0]


@pytest.fixture
def handlers() -> Iterator[None]:
    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    for number in numbers:
        signal.signal(number, signal.SIG_DFL)
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def test_the_first_signal_counts(handlers: None) -> None:
    signals.end_as_ctrl_c()
    with pytest.raises(KeyboardInterrupt) as caught:
        signal.raise_signal(signal.SIGHUP)
    assert isinstance(caught.value, signals.Ended)
    assert caught.value.number == signal.SIGHUP
    signal.raise_signal(signal.SIGTERM)  # while everything is put in order


def test_nohup_is_heeded(handlers: None) -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signals.end_as_ctrl_c()
    signal.raise_signal(signal.SIGHUP)
    with pytest.raises(signals.Ended):
        signal.raise_signal(signal.SIGTERM)
