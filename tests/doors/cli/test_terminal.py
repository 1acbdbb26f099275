"""What a person at a terminal sees: bars, and the address of the page."""

import os
import pty
import re
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from strandline.testing.studies import write_study

SCRIPT = """
from strandline.cli.progress import observing
from strandline.design.active import BatchReport
from strandline.runs import Progress, RunRecord
from strandline.smc import StepInfo
with observing() as observer:
    observer.stage("forward")
    for i in range(1, 4):
        observer.run(RunRecord("key", {}, "ok"), Progress(3, i, i, 0, 0, float(i)))
    observer.stage("sampling")
    observer.step(StepInfo(1.0, 1234.5, 0.25, False, 0.0, 1.0))
    observer.batch(BatchReport(3, ("E 396 ± 31",), 0.05, "check"))
    observer.stage("replicates")
    observer.part(Progress(100, 40, 40, 0, 0, 1.0))
    observer.note("a note [that stays]")
"""


@pytest.mark.smoke
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
    for words in (
        "forward runs",
        "3 ok, 0 failed",
        "sampling",
        "ESS 1234",
        "batch 3: E 396",
        "40 of 100",
        "[that stays]",
    ):
        assert words in text
    assert "…" not in text.partition("sampling")[0]
    assert "0:00:0" in text


@pytest.mark.smoke
def test_view_prints_its_address_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "beam")
    command = [sys.executable, "-m", "strandline", "view", str(folder), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.fullmatch(rf"{re.escape(str(folder))}: (http://127\.0\.0\.1:(\d+)/[\w-]+/)\n", line)
        assert found is not None
        assert f"ssh -L {found[2]}:localhost:{found[2]} THIS_MACHINE" in process.stdout.readline()
        assert httpx.get(found[1]).status_code == 200
        assert httpx.get(f"{found[1]}api/study").json()["name"] == "beam"
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
        assert process.stderr is not None
        assert process.stderr.read() == "stopped\n"
    assert sorted(path.name for path in folder.iterdir()) == ["study.yaml"]
