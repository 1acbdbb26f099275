"""Simulators that misbehave: each run ends as it must, harms no other, and leaves no process behind."""

import os
import pickle
import signal
import subprocess
import sys
import uuid
from collections import Counter
from dataclasses import replace

import pytest
from tests.doors.models.waiting import until
from tests.unit.models.command.commands import RESULT
from verification.validation.command_faults import FAULTS, MARKER, left_after, processes_with, study, zombies

from strandline.models.command.model import CommandModel
from strandline.models.command.process import LOG_LIMIT
from strandline.runs import Counts, InProcess, Ledger, LocalProcesses, RunRequest, run_campaign
from strandline.testing.studies import write_study

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are looked for in /proc")

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
PROCESSES = 5
"""Of a run of it: the supervisor, the simulator and three of its children."""


@pytest.fixture
def marker():
    """A text in the environment of a test's processes; the test's own leftovers are ended after it."""
    text = uuid.uuid4().hex
    yield text
    for pid in processes_with(text):
        os.kill(pid, signal.SIGKILL)


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """The folder and the records of one campaign of all faults, and the processes that it left."""
    folder, marker = tmp_path_factory.mktemp("faults"), uuid.uuid4().hex
    model = replace(study(folder, marker), timeout=2.0, grace=0.2)
    inputs = [{"fault": float(k)} for k in range(len(FAULTS))]
    with Ledger.open(folder / "ledger.sqlite", model=model) as ledger:
        records = run_campaign(model, inputs, ledger=ledger, executor=LocalProcesses(workers=2, timeout=60.0))
    return folder, dict(zip((fault.what for fault in FAULTS), records, strict=True)), left_after(marker)


def test_each_fault_ends_as_it_must_and_leaves_nothing(ended):
    folder, records, left = ended
    assert zombies() == []
    assert [fault.what for number, fault in enumerate(FAULTS) if left[number]] == []
    found = {what: (record.state, record.failure_kind) for what, record in records.items()}
    assert found == {fault.what: (fault.state, fault.kind) for fault in FAULTS}
    for number, fault in enumerate(FAULTS):
        record = records[fault.what]
        kept = list((folder / "runs").glob(f"{record.key[:12]}-*"))
        assert len(kept) == (3 if record.state == "killed" else 1)  # a killed run is tried again, twice
        if record.ok:
            continue
        assert any(str(folder) in str(record.message) for folder in kept)
        if fault.kind not in ("command_not_found", "template"):
            last = "yyyy" if "one line" in fault.what else f"this is {number}"
            assert last in str(record.message)
            assert last in record.log


def test_messages_end_with_a_traceback_and_prints_are_kept_at_both_ends(ended):
    folder, records, _ = ended
    raised = records["raises an exception"]
    assert str(raised.message).rstrip().endswith("RuntimeError: diverged")
    assert raised.diagnostics == {"exit_code": 1.0}
    (log,) = (folder / "runs").glob(f"{records['prints 100 MB'].key[:12]}-1/command.log")
    text = log.read_bytes()
    assert 2 * LOG_LIMIT < len(text) < 2 * LOG_LIMIT + 100
    assert text.startswith(b"this is ")
    assert text.endswith(b"the end\n")
    assert b"bytes left out" in text
    assert len(str(records["prints 100 MB in one line, and fails"].message)) < 5000


def test_a_process_that_is_left_and_a_zombie_would_be_seen(marker):
    process = subprocess.Popen(["sleep", "600"], env={**os.environ, MARKER: f"{marker}-3-"})
    assert left_after(marker)[3] == 1
    process.kill()
    until(lambda: bool(zombies()))
    assert zombies() == [process.pid]
    process.wait()
    assert left_after(marker)[3] == 0


def hanging(folder, marker):
    """Return the options of a simulator that never ends, its input as an argument."""
    (folder / "hang.py").write_text(HANGING)
    command = ["{{ python }}", "hang.py", "{{ E }}"]
    return {"command": command, "files": ["hang.py"], "environment": {MARKER: f"{marker}-0-"}, "result": RESULT}


REQUEST = RunRequest("key", {"E": 1.0})


def test_the_executors_own_timeout_or_its_end_leaves_nothing(tmp_path, marker):
    model = CommandModel(**hanging(tmp_path, marker), folder=tmp_path)
    (record,) = LocalProcesses(workers=1, timeout=1.0)(model, [REQUEST])
    assert (record.state, record.failure_kind) == ("timeout", "timeout")
    assert left_after(marker, patience=5.0)[0] == 0

    def requests():
        yield REQUEST
        until(lambda: len(processes_with(marker)) >= PROCESSES)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(LocalProcesses(workers=2)(model, requests()))
    assert left_after(marker, patience=5.0)[0] == 0


DRIVER = """
import pickle, sys
sys.path[:] = {path!r}
from strandline.runs import InProcess, LocalProcesses
list({executor}(pickle.loads({model!r}), [pickle.loads({request!r})]))
"""
WORKER, ALONE = "LocalProcesses(workers=1)", "InProcess()"


@pytest.mark.parametrize(("executor", "number"), [(WORKER, "SIGKILL"), (ALONE, "SIGKILL"), (ALONE, "SIGINT")])
def test_nothing_outlives_the_driver(tmp_path, marker, executor, number):
    model = CommandModel(**hanging(tmp_path, marker), folder=tmp_path, grace=0.2)
    pickled = {"model": pickle.dumps(model), "request": pickle.dumps(REQUEST)}
    script = DRIVER.format(path=sys.path, executor=executor, **pickled)
    driver = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.DEVNULL)
    try:
        until(lambda: len(processes_with(marker)) >= PROCESSES)
        driver.send_signal(signal.Signals[number])
        driver.wait(30.0)
    finally:
        driver.kill()
        driver.wait()
    assert left_after(marker, patience=10.0)[0] == 0


@pytest.mark.parametrize(
    "number", ["SIGTERM", *(pytest.param(one, marks=pytest.mark.long) for one in ("SIGHUP", "SIGINT"))]
)
def test_a_signal_ends_the_run_of_a_study_and_all_its_children(tmp_path, marker, number):
    """With one line, and 128 + its number; temporary folders go, too, and the runs can be made again."""
    folder, temporary, number = tmp_path / "study", tmp_path / "tmp", signal.Signals[number]
    folder.mkdir()
    temporary.mkdir()
    (folder / "seen.csv").write_text("0,0\n1,1\n2,0\n")
    write_study(
        folder,
        model={"command": hanging(folder, marker)},
        fixed=None,
        inputs={"E": {"prior": {"uniform": [1, 2]}, "unit": "Pa"}},
        observation={"file": "seen.csv", "unit": "mm"},
        discrepancy={"closest_point": {}},
        executor={"local": {"workers": 2}},
    )
    command = [sys.executable, "-m", "strandline", "run", "--quiet", str(folder)]
    environment = {**os.environ, "TMPDIR": str(temporary)}
    driver = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        until(lambda: len(processes_with(marker)) >= 2 * PROCESSES)
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
    assert left_after(marker, patience=10.0)[0] == 0
    assert list(temporary.glob("strandline-*")) == []
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().open == 0
        assert [(record.state, record.failure_kind) for record in ledger] == [("killed", "interrupted")] * 2
        assert [ledger.attempts(record.key) for record in ledger] == [0, 0]


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


def shell(folder, script, **options):
    (folder / "run.sh").write_text(script)
    return CommandModel(command=["/bin/sh", "run.sh"], files=["run.sh"], result=RESULT, folder=folder, **options)


def test_none_of_eight_children_killed_by_signal_9_becomes_a_final_failure(tmp_path):
    """The first attempt of each run is killed by signal 9, or loses its supervisor so, in turn."""
    (tmp_path / "marks").mkdir()
    (tmp_path / "in.j2").write_text("{{ number | int }}")
    script = KILLED_ONCE.format(folder=tmp_path / "marks")
    model, ends = shell(tmp_path, script, templates={"in.j2": "number.txt"}, keep="none"), []
    with Ledger.open(tmp_path / "ledger.sqlite", model=model) as ledger:
        records = run_campaign(
            model,
            [{"number": float(k)} for k in range(8)],
            ledger=ledger,
            executor=LocalProcesses(workers=2),
            on_record=lambda record, _: ends.append((record.state, record.failure_kind)),
        )
        assert ledger.counts() == Counts(ok=8)
    assert all(record.ok for record in records)
    assert Counter(ends) == {("killed", "simulator_killed"): 4, ("killed", "supervisor_died"): 4, ("ok", None): 8}


OUTCOMES = [
    ("sh -c 'kill -9 $$'; exit $?", {}, "killed", "simulator_killed"),
    ("exit 137", {"exit_codes": [0, 137]}, "invalid", "result_missing"),
    ("kill -9 $$", {"exit_codes": "any"}, "killed", "simulator_killed"),
    ("kill -TERM $$", {}, "failed", "exit_code"),
    ("printf 'x,y\\n0,0\\n1,1\\n' > out.csv", {"timeout": 3.16e7}, "ok", None),  # waited for in slices
    ("trap '' TERM; while :; do sleep 0.1; done", {"timeout": 0.3, "grace": 0.1}, "timeout", "timeout"),
]


@pytest.mark.smoke
def test_only_a_foreign_sigkill_is_an_infrastructure_failure(tmp_path):
    for script, options, state, kind in OUTCOMES:
        (record,) = InProcess()(shell(tmp_path, script, keep="none", **options), [REQUEST])
        assert (record.state, record.failure_kind) == (state, kind), f"{script}: {record.message}"
        assert record.seconds < 15.0


SLICED = """
from strandline.models.command import supervisor
waits, wait = [], supervisor.Tree.wait
supervisor.Tree.wait = lambda self, deadline: (waits.append(deadline), wait(self, deadline))
asked = {"log": "log", "log_limit": 100, "timeout": 1e300, "grace": 0.1, "environment": {}}
ended = supervisor.run(asked | {"arguments": ["/bin/sleep", "0.2"]}, longest_poll=0.01)
print(ended["exit_code"], ended["timeout"], len(waits) > 5)
"""


def test_an_end_between_two_slices_is_waited_for(tmp_path):
    """The supervisor itself, with slices of a hundredth of a second; its input stays open."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", SLICED], cwd=tmp_path, **pipes) as process:
        assert process.stdout.read() == "0 False True\n"
