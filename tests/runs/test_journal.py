"""Ledgers on network disks: which they are, the rollback journal that they get, and that it loses nothing."""

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from strandline.errors import InvalidInput, LedgerError
from strandline.runs import Counts, InProcess, Ledger, RunRecord, RunRequest, journal, run_campaign, tables
from strandline.runs.journal import VARIABLE, file_system, is_network, journal_for, note
from strandline.runs.overview import Overview
from strandline.testing.models import Cantilever

MOUNTS = r"""22 1 254:0 / / rw,relatime - ext4 /dev/vda rw
36 22 0:40 / /home rw,relatime shared:1 master:2 - autofs systemd-1 rw
37 36 0:41 / /home rw,relatime - nfs4 server:/home rw,vers=4.2
38 37 0:42 / /home/me/local\\040disk rw - xfs /dev/vdb rw
39 22 0:43 / /scratch rw - lustre 10.0.0.1@o2ib:/scratch rw,flock
40 22 0:44 / /mnt/far rw - fuse.sshfs me@far: rw
41 22 0:45 / /tmp rw - tmpfs tmpfs rw
broken line
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ledger.sqlite"


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Have the folder of the test lie on NFS."""
    mounts = tmp_path / "mountinfo"
    mounts.write_text(f"1 0 0:1 / / rw - ext4 /dev/vda rw\n2 1 0:2 / {tmp_path} rw - nfs4 server:/x rw\n")
    monkeypatch.setattr(journal, "MOUNTS", mounts)
    monkeypatch.delenv(VARIABLE, raising=False)


@pytest.mark.parametrize(
    ("place", "kind", "network"),
    [
        ("/var/study/ledger.sqlite", "ext4", False),
        ("/home/me/study/ledger.sqlite", "nfs4", True),
        ("/home/me/local disk/ledger.sqlite", "xfs", False),
        ("/homework/ledger.sqlite", "ext4", False),
        ("/scratch/ledger.sqlite", "lustre", True),
        ("/mnt/far/a/b/ledger.sqlite", "fuse.sshfs", True),
        ("/tmp/ledger.sqlite", "tmpfs", False),
    ],
)
def test_the_file_system_of_a_folder_is_known(tmp_path: Path, place: str, kind: str, network: bool) -> None:
    mounts = tmp_path / "mountinfo"
    mounts.write_text(MOUNTS.replace("\\\\", "\\"))
    assert file_system(Path(place), mounts=mounts) == kind
    assert is_network(kind) == network


def test_where_the_system_does_not_say_a_disk_is_local(tmp_path: Path) -> None:
    assert file_system(tmp_path / "ledger.sqlite", mounts=tmp_path / "nothing") is None
    assert not is_network(None)


@pytest.mark.parametrize(
    "kind",
    ["nfs", "nfs4", "lustre", "gpfs", "cifs", "smb3", "fuse.sshfs", "beegfs", "ceph", "panfs", "afs", "9p", "fuse"],
)
def test_these_are_network_disks(kind: str) -> None:
    assert is_network(kind)


@pytest.mark.parametrize("kind", ["ext4", "xfs", "btrfs", "zfs", "tmpfs", "overlay", "f2fs", "apfs", "fuseblk", "vfat"])
def test_these_are_local(kind: str) -> None:
    assert not is_network(kind)


def mode_of(ledger: Ledger) -> tuple[str, int]:
    rows = [ledger._rows(f"PRAGMA {name}")[0][0] for name in ("journal_mode", "synchronous")]
    return rows[0], rows[1]


@pytest.mark.usefixtures("network")
def test_a_ledger_on_a_network_disk_gets_a_rollback_journal_and_each_write_is_synchronised(path: Path) -> None:
    with Ledger.open(path, model="m") as ledger:
        assert mode_of(ledger) == ("delete", 3)
        ledger.started(RunRequest("a", {}))
        assert not path.with_name("ledger.sqlite-wal").exists()
    assert "nfs4" in str(note(path))
    assert "\n" not in str(note(path))


def test_the_environment_decides_where_it_says_anything(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (journal_for(path, environment={}), note(path)) == ("wal", None)
    monkeypatch.setenv(VARIABLE, "delete")
    with Ledger.open(path, model="m") as ledger:
        assert mode_of(ledger) == ("delete", 3)
    assert VARIABLE in str(note(path))
    monkeypatch.setenv(VARIABLE, "wal")
    with Ledger.open(path, model="m") as ledger:
        assert mode_of(ledger) == ("wal", 2)
    monkeypatch.setenv(VARIABLE, "memory")
    with pytest.raises(InvalidInput, match="STRANDLINE_JOURNAL in the environment: got memory; expected wal or delete"):
        Ledger.open(path, model="m")


@pytest.mark.usefixtures("network")
def test_the_environment_overrules_the_disk(path: Path) -> None:
    assert journal_for(path, environment={VARIABLE: "wal"}) == "wal"


KILLED_WITH_A_LOG = """
import os, signal, sys
from strandline.runs import Ledger, RunRecord, RunRequest
ledger = Ledger.open(sys.argv[1], model="m")
for key in "abc":
    ledger.started(RunRequest(key, {}))
    ledger.finished(RunRecord(key, {}, "failed"))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_ledger_with_a_log_is_converted_and_keeps_what_is_in_the_log(path: Path, request: Any) -> None:
    subprocess.run([sys.executable, "-c", KILLED_WITH_A_LOG, str(path)], env={**os.environ, VARIABLE: "wal"})
    assert path.with_name("ledger.sqlite-wal").stat().st_size > 0
    request.getfixturevalue("network")
    with Ledger.open(path, model="m") as ledger:
        assert mode_of(ledger) == ("delete", 3)
        assert ledger.counts() == Counts(failed=3)
    assert not path.with_name("ledger.sqlite-wal").exists()
    assert journal.has_rollback_journal(path)


def test_a_ledger_that_is_read_is_not_converted_and_the_driver_says_so(
    path: Path, request: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    Ledger.open(path, model="m").close()
    with closing(sqlite3.connect(path)) as reader:
        reader.execute("SELECT * FROM meta").fetchall()
        request.getfixturevalue("network")
        monkeypatch.setattr(journal, "BUSY_SECONDS", 0.1)
        with pytest.raises(LedgerError, match=r"cannot be given a rollback journal.*Wait until it ends"):
            Ledger.open(path, model="m")


@pytest.mark.usefixtures("network")
def test_readers_and_a_driver_do_not_stop_each_other(path: Path) -> None:
    with Ledger.open(path, model="m") as driver:
        driver._connection.execute("PRAGMA busy_timeout = 100")
        for key in "ab":
            driver.started(RunRequest(key, {}))
            driver.finished(RunRecord(key, {}, "failed"))
        with Ledger.open(path, model="m", read_only=True) as reader, Overview(path) as overview:
            under_way = iter(reader)
            assert next(under_way).key == "a"
            driver.started(RunRequest("c", {}))
            driver.finished(RunRecord("c", {}, "failed"))
            assert reader.counts() == Counts(failed=3)
            assert len(overview.runs()) == 3
            assert next(under_way).key == "b"


WRITER = """
import select, sys
from strandline.runs import Ledger, RunRecord, RunRequest
with Ledger.open(sys.argv[1], model="m") as ledger:
    print("open", flush=True)
    for k in range(100_000):
        if select.select([sys.stdin], [], [], 0.02)[0]:
            break
        ledger.started(RunRequest(str(k), {}))
        ledger.finished(RunRecord(str(k), {}, "failed"))
"""


def test_a_reader_beside_a_driver_of_another_process_sees_whole_runs(path: Path) -> None:
    environment = {**os.environ, VARIABLE: "delete"}
    command = [sys.executable, "-c", WRITER, str(path)]
    seen: list[int] = []
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as writer:
        assert writer.stdout is not None
        writer.stdout.readline()
        until = time.monotonic() + 30.0
        while len(set(seen)) < 3 and writer.poll() is None and time.monotonic() < until:
            with Ledger.open(path, model="m", read_only=True) as reader:
                seen.append(len(list(reader)))
                assert reader.counts().open <= 1
        writer.communicate()
    assert writer.returncode == 0
    assert seen == sorted(seen)
    assert len(set(seen)) == 3


KILLED_WHILE_WRITING = """
import os, signal, sqlite3, sys
from strandline.runs import tables
connection = tables.connect(sys.argv[1])
connection.execute("PRAGMA cache_size = 1")
connection.execute("BEGIN IMMEDIATE")
for k in range(300):
    connection.execute("INSERT INTO starts (session, key, inputs, started_at) VALUES (1, ?, '{}', 0)", (str(k) * 500,))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.usefixtures("network")
def test_what_a_killed_driver_had_only_begun_to_write_is_undone_by_a_reader(path: Path) -> None:
    with Ledger.open(path, model="m") as ledger:
        ledger.started(RunRequest("a", {}))
        ledger.finished(RunRecord("a", {}, "failed"))
    subprocess.run([sys.executable, "-c", KILLED_WHILE_WRITING, str(path)], env={**os.environ, VARIABLE: "delete"})
    assert path.with_name("ledger.sqlite-journal").stat().st_size > 0
    with Ledger.open(path, model="m", read_only=True) as reader:
        assert reader.counts() == Counts(failed=1)
        with pytest.raises(sqlite3.OperationalError):
            reader._connection.execute("DELETE FROM starts")
    with closing(tables.connect_read_only(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


CAMPAIGN = """
import os, signal, sys, threading
from strandline.runs import InProcess, Ledger, run_campaign
from strandline.testing.models import Cantilever
model = Cantilever()
inputs = [{"E": 300.0 + k, "load": 1e-5} for k in range(int(sys.argv[2]))]
finished = []
def on_record(record, progress):
    finished.append(record)
    if len(finished) == 5:
        threading.Timer(float(sys.argv[3]), os.kill, (os.getpid(), signal.SIGKILL)).start()
with Ledger.open(sys.argv[1], model=model) as ledger:
    run_campaign(model, inputs, ledger=ledger, executor=InProcess(), on_record=on_record)
"""


def test_nothing_is_lost_or_repeated_when_drivers_are_killed(path: Path, tmp_path: Path) -> None:
    rng, number, lost = random.Random(1), 600, 0
    environment = {**os.environ, VARIABLE: "delete"}
    known: dict[str, bytes] = {}
    for _ in range(3):
        command = [sys.executable, "-c", CAMPAIGN, str(path), str(number), str(rng.uniform(0.0, 0.05))]
        assert subprocess.run(command, env=environment).returncode == -signal.SIGKILL
        now = points_of(path)
        lost += sum(now.get(key) != value for key, value in known.items())
        known = now
    model = Cantilever()
    inputs = [{"E": 300.0 + k, "load": 1e-5} for k in range(number)]
    for place in (path, tmp_path / "calm.sqlite"):
        with Ledger.open(place, model=model) as ledger:
            run_campaign(model, inputs, ledger=ledger, executor=InProcess())
    assert 0 < len(known) < number
    assert lost == 0
    assert points_of(path) == points_of(tmp_path / "calm.sqlite")
    with closing(tables.connect_read_only(path)) as connection:
        sql = (
            "SELECT count(*) FROM (SELECT 1 FROM starts JOIN outcomes USING (attempt) GROUP BY key HAVING count(*) > 1)"
        )
        assert connection.execute(sql).fetchone() == (0,)


def points_of(path: Path) -> dict[str, bytes]:
    """Return the points of every run that is ok, by key."""
    if not path.exists():
        return {}
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return {record.key: record.interface.points.tobytes() for record in ledger if record.interface is not None}
