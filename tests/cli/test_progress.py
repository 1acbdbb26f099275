"""Progress: bars on a terminal, plain lines elsewhere, nothing when quiet."""

import os
import pty
import subprocess
import sys

import pytest

from strandline.calibration import progress_text
from strandline.cli import progress
from strandline.cli.progress import observing
from strandline.design.active import BatchReport
from strandline.runs import Progress as Runs
from strandline.runs import RunRecord
from strandline.smc import StepInfo

RECORD = RunRecord("key", {"E": 1.0}, "ok")
STEP = StepInfo(1.0, 1234.5, 0.25, False, 0.0, 1.0)
SCRIPT = """
from strandline.cli.progress import observing
from strandline.runs import Progress, RunRecord
with observing() as observer:
    observer.stage("forward")
    for i in range(1, 4):
        observer.run(RunRecord("key", {}, "ok"), Progress(3, i, i, 0, 0, float(i)))
    observer.stage("surrogate")
"""


def state(finished: int, *, reused: int = 0, elapsed: float = 1.0) -> Runs:
    return Runs(total=100, finished=finished, ok=finished - 1, failed=1, reused=reused, elapsed=elapsed)


def test_plain_lines(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    with observing() as observer:
        observer.stage("forward")
        observer.run(RECORD, state(1))
        clock[0] += progress.SECONDS_BETWEEN_LINES + 1
        observer.run(RECORD, state(50, elapsed=70.0))
        observer.run(RECORD, state(51))
        observer.run(RECORD, state(100))
        observer.stage("sampling")
        observer.step(StepInfo(0.5, 1000.0, 0.3, False, 0.0, 1.0))
        observer.step(STEP)
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.splitlines() == [
        "forward runs …",
        "  50/100 49 ok, 1 failed, 1 min 10 s left",
        "  100/100 99 ok, 1 failed",
        "sampling …",
        "  tempering exponent 1.0000, ESS 1234, accepted 25%",
    ]


def test_a_choice_that_takes_long_says_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    with observing() as observer:
        observer.stage("choice")
        observer.step(StepInfo(0.5, 1000.0, 0.3, False, 0.0, 1.0))
        observer.step(STEP)
        observer.stage("choice")
        clock[0] += progress.SECONDS_BETWEEN_LINES + 1
        observer.step(StepInfo(0.01, 1000.0, 0.3, False, 0.0, 1.0))
        observer.step(STEP)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["next batch …", "next batch …", "  tempering exponent 0.0100, ESS 1000, accepted 30%"]


def test_each_batch_of_an_active_design_has_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    with observing() as observer:
        observer.batch(BatchReport(3, ("E 396 ± 31",), 0.05, "check"))
    assert capsys.readouterr().err.splitlines() == ["  batch 3: E 396 ± 31, moved 0.05 sd; next: check"]


def test_parts_of_a_stage(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    with observing() as observer:
        observer.stage("replicates")
        observer.part(state(10))
        clock[0] += progress.SECONDS_BETWEEN_LINES + 1
        observer.part(state(50, elapsed=70.0))
        observer.part(state(100))
    assert capsys.readouterr().err.splitlines() == ["replicates …", "  50 of 100, 1 min 10 s left", "  100 of 100"]


def test_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    with observing(quiet=True) as observer:
        observer.stage("forward")
        observer.run(RECORD, state(100))
        observer.step(STEP)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0 s"), (59.4, "59 s"), (60.0, "1 min 00 s"), (3599.9, "1 h 00 min"), (7265.0, "2 h 01 min")],
)
def test_durations(seconds: float, text: str) -> None:
    assert progress_text._duration(seconds) == text


def test_bars_fit_a_terminal_of_80_columns() -> None:
    """In a real pseudo-terminal."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "COLUMNS": "80", "TERM": "xterm"}
    environment.pop("NO_COLOR", None)
    process = subprocess.Popen([sys.executable, "-c", SCRIPT], stderr=theirs, env=environment)
    os.close(theirs)
    shown = b""
    try:
        while part := os.read(ours, 4096):
            shown += part
    except OSError:  # how Linux tells that the other end is closed
        pass
    os.close(ours)
    assert process.wait(30) == 0
    text = shown.decode()
    assert "forward runs" in text
    assert "3 ok, 0 failed" in text
    assert "surrogate" in text
    assert "…" not in text
    assert "0:00:0" in text
