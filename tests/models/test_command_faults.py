"""Simulators that misbehave: each run ends as it must, harms no other, and leaves no process behind."""

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from validation.command_faults import FAULTS, MARKER, campaign, left_after, processes_with, zombies

from strandline.models.command.model import CommandModel
from strandline.models.command.process import LOG_LIMIT
from strandline.runs import InProcess, LocalProcesses, RunRecord, RunRequest

linux = pytest.mark.skipif(sys.platform != "linux", reason="processes are looked for in /proc")
pytestmark = linux

HANGING = """
import os, signal, time
for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
for _ in range(2):
    if os.fork() == 0:
        os.setsid()
        if os.fork() != 0:
            os._exit(0)
open("started", "w").close()
while True:
    time.sleep(600)
"""


@pytest.fixture
def marker() -> Iterator[str]:
    """A text in the environment of a test's processes; the test's own leftovers are ended after it."""
    text = uuid.uuid4().hex
    yield text
    for pid in processes_with(text):
        os.kill(pid, signal.SIGKILL)


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The folder and the records of one campaign of all faults, the processes left, and how many were seen before."""
    folder, marker = tmp_path_factory.mktemp("faults"), uuid.uuid4().hex
    records = campaign(folder, marker)
    return folder, dict(zip((fault.what for fault in FAULTS), records, strict=True)), left_after(marker)


@pytest.mark.parametrize("number", range(len(FAULTS)), ids=[fault.what for fault in FAULTS])
def test_each_fault_ends_as_it_must_and_leaves_nothing(ended: Any, number: int) -> None:
    fault, (folder, records, left) = FAULTS[number], ended
    record: RunRecord = records[fault.what]
    assert (record.state, record.failure_kind) == (fault.state, fault.kind), record.message
    assert left[number] == 0
    if not record.ok and fault.kind not in ("command_not_found", "template"):
        last = "yyyy" if "one line" in fault.what else f"this is {number}"
        assert last in str(record.message)
        assert last in record.log
    kept = list((folder / "runs").glob(f"{record.key[:12]}-*"))
    assert len(kept) == 1
    if not record.ok:
        assert str(kept[0]) in str(record.message)


def test_nothing_is_left_to_be_collected(ended: Any) -> None:
    assert zombies() == []


def test_a_process_that_is_left_and_a_zombie_would_be_seen(marker: str) -> None:
    process = subprocess.Popen(["sleep", "600"], env={**os.environ, MARKER: f"{marker}-3-"})
    assert left_after(marker)[3] == 1
    process.kill()
    deadline = time.monotonic() + 5.0
    while not zombies() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert zombies() == [process.pid]
    process.wait()
    assert left_after(marker)[3] == 0


def test_prints_are_kept_at_both_ends_and_bounded(ended: Any) -> None:
    folder, records, _ = ended
    key = records["prints 100 MB"].key[:12]
    (log,) = (folder / "runs").glob(f"{key}-1/command.log")
    text = log.read_bytes()
    assert 2 * LOG_LIMIT < len(text) < 2 * LOG_LIMIT + 100
    assert text.startswith(b"this is ")
    assert text.endswith(b"the end\n")
    assert b"bytes left out" in text
    assert len(str(records["prints 100 MB in one line, and fails"].message)) < 5000


def test_the_message_ends_with_the_traceback_of_the_simulator(ended: Any) -> None:
    record = ended[1]["raises an exception"]
    assert str(record.message).startswith("python") or "ended with exit code 1" in str(record.message)
    assert str(record.message).rstrip().endswith("RuntimeError: diverged")
    assert record.diagnostics == {"exit_code": 1.0}


def hanging(folder: Path, marker: str, **options: Any) -> CommandModel:
    (folder / "hang.py").write_text(HANGING)
    return CommandModel(
        command=["{{ python }}", "hang.py"],
        files=["hang.py"],
        environment={MARKER: f"{marker}-0-"},
        result={"file": "interface.csv", "unit": "mm"},
        folder=folder,
        **options,
    )


def started(marker: str, number: int) -> None:
    """Wait until `number` processes with the marker run."""
    deadline = time.monotonic() + 30.0
    while len(processes_with(marker)) < number:
        assert time.monotonic() < deadline, "the simulator did not start"
        time.sleep(0.02)


def test_the_executors_own_timeout_leaves_nothing(tmp_path: Path, marker: str) -> None:
    executor = LocalProcesses(workers=1, timeout=3.0)
    (record,) = executor(hanging(tmp_path, marker), [RunRequest("key", {})])
    assert (record.state, record.failure_kind) == ("timeout", "timeout")
    assert left_after(marker, patience=5.0)[0] == 0


def test_a_closed_campaign_leaves_nothing(tmp_path: Path, marker: str) -> None:
    def requests() -> Iterator[RunRequest]:
        yield RunRequest("first", {})
        started(marker, 4)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(LocalProcesses(workers=2)(hanging(tmp_path, marker), requests()))
    assert left_after(marker, patience=5.0)[0] == 0


DRIVER = """
import sys
from pathlib import Path
sys.path[:] = {path!r}
from strandline.models.command.model import CommandModel
from strandline.runs import {executor}, RunRequest
model = CommandModel(
    command=["{{{{ python }}}}", "hang.py"], files=["hang.py"], environment={{{name!r}: {marker!r}}},
    result={{"file": "interface.csv", "unit": "mm"}}, folder=Path({folder!r}), grace=0.2,
)
if __name__ == "__main__":
    list({executor}({options})(model, [RunRequest("key", {{}})]))
"""


@pytest.mark.parametrize(
    ("executor", "options", "number"),
    [
        ("LocalProcesses", "workers=1", signal.SIGKILL),
        ("InProcess", "", signal.SIGKILL),
        ("InProcess", "", signal.SIGINT),
    ],
    ids=["driver of workers killed", "single process killed", "single process interrupted"],
)
def test_nothing_outlives_the_driver(
    tmp_path: Path, marker: str, executor: str, options: str, number: signal.Signals
) -> None:
    hanging(tmp_path, marker)
    script = tmp_path / "driver.py"
    script.write_text(
        DRIVER.format(
            path=sys.path,
            executor=executor,
            options=options,
            name=MARKER,
            marker=f"{marker}-0-",
            folder=str(tmp_path),
        )
    )
    driver = subprocess.Popen([sys.executable, str(script)], stderr=subprocess.DEVNULL)
    try:
        started(marker, 5)  # the supervisor, the simulator and three of its children
        driver.send_signal(number)
        driver.wait(30.0)
    finally:
        driver.kill()
        driver.wait()
    assert left_after(marker, patience=10.0)[0] == 0


def test_a_run_in_this_process_ends_in_time_too(tmp_path: Path, marker: str) -> None:
    model = hanging(tmp_path, marker, timeout=1.5, grace=0.2)
    (record,) = InProcess()(model, [RunRequest("key", {})])
    assert (record.state, record.failure_kind) == ("timeout", "timeout")
    assert record.seconds < 15.0
    assert left_after(marker)[0] == 0
    assert zombies() == []
