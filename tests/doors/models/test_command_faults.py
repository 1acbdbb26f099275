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
from tests.doors.models.command_faults import FAULTS, MARKER, left_after, processes_with, study, zombies
from tests.doors.models.waiting import until
from tests.unit.models.command.commands import RESULT

from strandline.models.command.model import LOG_LIMIT, CommandModel
from strandline.runs import Counts, InProcess, Ledger, LocalProcesses, RunRequest, run_campaign
from strandline.studies.keys.parse import made
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
while True:
    time.sleep(600)
"""
PROCESSES = 5  # of a run of it: the supervisor, the simulator and three of its children


@pytest.fixture
def marker():
    """A text in the environment of a test's processes; the test's own leftovers are ended after it."""
    text = uuid.uuid4().hex
    yield text
    for pid in processes_with(text):
        os.kill(pid, signal.SIGKILL)


def test_each_fault_ends_as_it_must_tells_how_its_log_ends_and_leaves_nothing(tmp_path):
    folder, marker = tmp_path, uuid.uuid4().hex
    model = replace(study(folder, marker), timeout=2.0, grace=0.2)
    inputs = [{"fault": float(k)} for k in range(len(FAULTS))]
    with Ledger.open(folder / "ledger.sqlite", model=model) as ledger:
        found = run_campaign(model, inputs, ledger=ledger, executor=LocalProcesses(workers=2, timeout=60.0))
    records, left = dict(zip((fault.what for fault in FAULTS), found, strict=True)), left_after(marker)
    assert zombies() == []
    assert [fault.what for number, fault in enumerate(FAULTS) if left[number]] == []
    ends = {what: (record.state, record.failure_kind) for what, record in records.items()}
    assert ends == {fault.what: (fault.state, fault.kind) for fault in FAULTS}
    for number, fault in enumerate(FAULTS):
        record = records[fault.what]
        kept = list((folder / "runs").glob(f"{record.key[:12]}-*"))
        assert len(kept) == (3 if record.state == "killed" else 1)  # a killed run is tried again, twice
        if record.ok:
            continue
        assert len(str(record.message)) < 5000
        assert any(str(folder) in str(record.message) for folder in kept)
        if fault.kind not in ("command_not_found", "template"):
            last = "yyyy" if "one line" in fault.what else f"this is {number}"
            assert last in str(record.message)
            assert last in record.log
    assert str(records["raises an exception"].message).rstrip().endswith("RuntimeError: diverged")
    (log,) = (folder / "runs").glob(f"{records['prints 100 MB'].key[:12]}-1/command.log")
    text = log.read_bytes()
    assert len(text) < 2 * LOG_LIMIT + 100
    assert (text[:8], text[-8:]) == (b"this is ", b"the end\n")


def test_a_process_that_is_left_and_a_zombie_would_be_seen(marker):
    process = subprocess.Popen(["sleep", "600"], env={**os.environ, MARKER: f"{marker}-3-"})
    assert left_after(marker)[3] == 1
    process.kill()
    until(lambda: bool(zombies()))
    assert zombies() == [process.pid]
    process.wait()
    assert left_after(marker)[3] == 0


def hanging(folder, marker):
    """Return the options of a simulator that never ends."""
    (folder / "hang.py").write_text(HANGING)
    command = ["{{ python }}", "hang.py", "{{ E }}"]
    return {"command": command, "files": ["hang.py"], "environment": {MARKER: f"{marker}-0-"}, "result": RESULT}


REQUEST = RunRequest("key", {"E": 1.0})


def test_the_executors_own_timeout_leaves_nothing(tmp_path, marker):
    model = made(CommandModel, hanging(tmp_path, marker), "model.command", folder=tmp_path)
    (record,) = LocalProcesses(workers=1, timeout=1.0)(model, [REQUEST])
    assert (record.state, record.failure_kind) == ("timeout", "timeout")
    assert left_after(marker, patience=5.0)[0] == 0


DRIVER = """
import pickle, sys
sys.path[:] = {path!r}
from strandline.runs import InProcess, LocalProcesses
list({executor}(pickle.loads({model!r}), [pickle.loads({request!r})]))
"""


@pytest.mark.parametrize("executor", ["LocalProcesses(workers=1)", "InProcess()"])
def test_nothing_outlives_a_driver_that_is_killed(tmp_path, marker, executor):
    model = made(CommandModel, hanging(tmp_path, marker) | {"grace": 0.2}, "model.command", folder=tmp_path)
    pickled = {"model": pickle.dumps(model), "request": pickle.dumps(REQUEST)}
    script = DRIVER.format(path=sys.path, executor=executor, **pickled)
    driver = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.DEVNULL)
    try:
        until(lambda: len(processes_with(marker)) >= PROCESSES)
    finally:
        driver.kill()
        driver.wait()
    assert left_after(marker, patience=10.0)[0] == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.long)])
def test_a_signal_ends_the_run_of_a_study_and_all_its_children(tmp_path, marker, number):
    """With one line, and 128 + its number; temporary folders go, too, and the runs can be made again."""
    folder, temporary = tmp_path / "study", tmp_path / "tmp"
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
        driver.send_signal(number)
        _, said = driver.communicate(timeout=30.0)
    finally:
        driver.kill()
        driver.wait()
    assert driver.returncode == 128 + number
    assert said.count("\n") == 1
    assert said.startswith("strandline: interrupted")
    assert left_after(marker, patience=10.0)[0] == 0
    assert list(temporary.glob("strandline-*")) == []
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert [(record.state, record.failure_kind) for record in ledger] == [("killed", "interrupted")] * 2
        assert [ledger.attempts(record.key) for record in ledger] == [0, 0]


def shell(folder, script, **options):
    (folder / "run.sh").write_text(script)
    given = {"command": ["/bin/sh", "run.sh"], "files": ["run.sh"], "result": RESULT, **options}
    return made(CommandModel, given, "model.command", folder=folder)


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


def test_none_of_eight_children_killed_by_signal_9_becomes_a_final_failure(tmp_path):
    """The first attempt of each run is killed by signal 9, or loses its supervisor so, in turn."""
    (tmp_path / "marks").mkdir()
    (tmp_path / "in.j2").write_text("{{ number | int }}")
    script = KILLED_ONCE.format(folder=tmp_path / "marks")
    model, ends = shell(tmp_path, script, templates={"in.j2": "number.txt"}, keep="none"), []

    def on_record(record, _):
        ends.append((record.state, record.failure_kind))

    with Ledger.open(tmp_path / "ledger.sqlite", model=model) as ledger:
        options = {"ledger": ledger, "executor": LocalProcesses(workers=2), "on_record": on_record}
        records = run_campaign(model, [{"number": float(k)} for k in range(8)], **options)
        assert ledger.counts() == Counts(ok=8)
    assert all(record.ok for record in records)
    assert Counter(ends) == {("killed", "simulator_killed"): 4, ("killed", "supervisor_died"): 4, ("ok", None): 8}


OUTCOMES = [
    ("sh -c 'kill -9 $$'; exit $?", {}, "killed", "simulator_killed"),
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
