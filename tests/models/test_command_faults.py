"""Simulators that misbehave: each run ends as it must, harms no other, and leaves no process behind."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from verification.validation.command_faults import FAULTS, MARKER, campaign, left_after, processes_with, zombies

from strandline.errors import ForwardModelError
from strandline.models.command import model as command_model
from strandline.models.command import process, supervisor
from strandline.models.command.model import CommandModel
from strandline.models.command.process import LOG_LIMIT
from strandline.runs import Counts, InProcess, Ledger, LocalProcesses, RunRecord, RunRequest, run_campaign

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
    assert len(kept) == (3 if record.state == "killed" else 1)  # a killed run is tried again, twice
    if not record.ok:
        assert any(str(folder) in str(record.message) for folder in kept)


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


KILLED_ONCE = """
cat number.txt
mark="{folder}/$(cat number.txt)"
if [ ! -e "$mark" ]; then
    touch "$mark"
    case $(cat number.txt) in
        *[02468]) kill -9 $$ ;;
        *) kill -9 $PPID; sleep 60 ;;
    esac
fi
printf 'x,y\\n0,0\\n1,1\\n' > out.csv
"""


def killed_once(folder: Path) -> CommandModel:
    """A simulator whose first attempt is killed by signal 9, or loses its supervisor so, in turn."""
    (folder / "marks").mkdir()
    (folder / "run.sh").write_text(KILLED_ONCE.format(folder=folder / "marks"))
    (folder / "in.j2").write_text("{{ number | int }}")
    return CommandModel(
        command=["/bin/sh", "run.sh"],
        files=["run.sh"],
        templates={"in.j2": "number.txt"},
        result={"file": "out.csv", "unit": "mm"},
        keep="none",
        folder=folder,
    )


def test_none_of_twenty_children_killed_by_signal_9_becomes_a_final_failure(tmp_path: Path) -> None:
    model, ends = killed_once(tmp_path), []
    inputs = [{"number": float(k)} for k in range(20)]
    with Ledger.open(tmp_path / "ledger.sqlite", model=model) as ledger:
        records = run_campaign(
            model,
            inputs,
            ledger=ledger,
            executor=LocalProcesses(workers=2),
            on_record=lambda record, _: ends.append((record.state, record.failure_kind)),
        )
        assert ledger.counts() == Counts(ok=20)
    assert all(record.ok for record in records)
    assert Counter(ends) == {("killed", "simulator_killed"): 10, ("killed", "supervisor_died"): 10, ("ok", None): 20}


def test_a_run_that_is_killed_each_time_is_given_up_and_never_copied(tmp_path: Path) -> None:
    (tmp_path / "run.sh").write_text("kill -9 $$")
    model = CommandModel(
        command=["/bin/sh", "run.sh"], files=["run.sh"], result={"file": "out.csv", "unit": "mm"}, folder=tmp_path
    )
    with Ledger.open(tmp_path / "ledger.sqlite", model=model) as ledger:
        (record,) = run_campaign(model, [{}], ledger=ledger, executor=InProcess(), maximum_attempts=2)
        assert (record.state, record.failure_kind) == ("killed", "simulator_killed")
        assert ledger.attempts(record.key) == 2
    with Ledger.open(tmp_path / "other.sqlite", model=model) as other:
        assert other.copy_from(tmp_path / "ledger.sqlite", [record.key]) == 0


@pytest.mark.parametrize(
    ("script", "options", "state", "kind"),
    [
        ("sh -c 'kill -9 $$'; exit $?", {}, "killed", "simulator_killed"),
        ("exit 137", {"exit_codes": [0, 137]}, "invalid", "result_missing"),
        ("kill -9 $$", {"exit_codes": "any"}, "killed", "simulator_killed"),
        ("kill -SEGV $$", {}, "failed", "exit_code"),
        ("kill -TERM $$", {}, "failed", "exit_code"),
        ("sleep 60", {"timeout": 0.3, "grace": 0.1}, "timeout", "timeout"),
        ("trap '' TERM; while :; do sleep 1; done", {"timeout": 0.3, "grace": 0.1}, "timeout", "timeout"),
    ],
    ids=["child of a shell", "137 allowed", "any exit code", "crash", "SIGTERM", "timeout", "our own SIGKILL"],
)
def test_only_a_foreign_sigkill_is_an_infrastructure_failure(
    tmp_path: Path, script: str, options: Any, state: str, kind: str
) -> None:
    (tmp_path / "run.sh").write_text(script)
    model = CommandModel(
        command=["/bin/sh", "run.sh"],
        files=["run.sh"],
        result={"file": "out.csv", "unit": "mm"},
        folder=tmp_path,
        keep="none",
        **options,
    )
    (record,) = InProcess()(model, [RunRequest("key", {})])
    assert (record.state, record.failure_kind) == (state, kind), record.message


def test_a_kill_for_lack_of_memory_says_so(tmp_path: Path) -> None:
    assert supervisor.oom_kills() >= 0
    answer = {"exit_code": -9, "timeout": False, "seconds": 1.0, "tail": "", "left": 0, "out_of_memory": True}
    ended = process._ended(json.dumps(answer).encode(), 0, tmp_path / "log")
    assert ended.killed
    error = command_model._killed(ended, "solver")
    assert (error.kind, error.state) == ("out_of_memory", "killed")
    assert "out of memory" in error.message


def test_no_room_for_a_process_is_tried_again(tmp_path: Path) -> None:
    answer = json.dumps({"error": "Cannot allocate memory", "errno": errno.ENOMEM}).encode()
    with pytest.raises(ForwardModelError, match="Cannot allocate memory") as caught:
        process._ended(answer, 0, tmp_path / "log")
    assert (caught.value.kind, caught.value.state) == ("out_of_memory", "killed")


@pytest.mark.parametrize("timeout", [3.0e6, 3.16e7])
def test_a_timeout_of_more_than_24_days_is_waited_for_in_slices(tmp_path: Path, timeout: float) -> None:
    (tmp_path / "run.sh").write_text("printf 'x,y\\n0,0\\n1,1\\n' > out.csv")
    model = CommandModel(
        command=["/bin/sh", "run.sh"],
        files=["run.sh"],
        result={"file": "out.csv", "unit": "mm"},
        folder=tmp_path,
        timeout=timeout,
    )
    (record,) = InProcess()(model, [RunRequest("key", {})])
    assert record.ok, record.message


@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")  # JAX, where another test has started it
def test_an_end_between_two_slices_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The supervisor itself, with slices of a hundredth of a second."""
    monkeypatch.setattr(supervisor, "LONGEST_POLL", 0.01)
    monkeypatch.setattr(supervisor, "descendants", lambda _: [])  # those of this process are none of its
    waits = []
    monkeypatch.setattr(supervisor.Tree, "wait", _counted(supervisor.Tree.wait, waits))
    stdin = os.pipe()
    saved = os.dup(0)
    os.dup2(stdin[0], 0)
    try:
        asked = {"log": str(tmp_path / "log"), "log_limit": 100, "timeout": 1e300, "grace": 0.1}
        ended = supervisor.run({**asked, "arguments": ["/bin/sleep", "0.2"], "environment": {}})
    finally:
        os.dup2(saved, 0)
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for descriptor in (*stdin, saved):
            os.close(descriptor)
    assert (ended["exit_code"], ended["timeout"]) == (0, False)
    assert len(waits) > 5


def _counted(method: Any, waits: list[float]) -> Any:
    def counting(self: Any, deadline: float) -> None:
        waits.append(deadline)
        method(self, deadline)

    return counting
