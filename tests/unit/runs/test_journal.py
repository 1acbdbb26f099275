"""Ledgers on network disks: which they are, and the rollback journal that they get."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from tests.unit.runs.ledgers import failed, put

from strandline.errors import InvalidInput, LedgerError
from strandline.runs import Counts, Ledger, RunRequest, journal
from strandline.runs.journal import VARIABLE, file_system, is_network, journal_for, note
from strandline.runs.overview import Overview

MOUNTS = r"""22 1 254:0 / / rw,relatime - ext4 /dev/vda rw
36 22 0:40 / /home rw,relatime shared:1 master:2 - autofs systemd-1 rw
37 36 0:41 / /home rw,relatime - nfs4 server:/home rw,vers=4.2
38 37 0:42 / /home/me/local\040disk rw - xfs /dev/vdb rw
39 22 0:43 / /scratch rw - lustre 10.0.0.1@o2ib:/scratch rw,flock
40 22 0:44 / /mnt/far rw - fuse.sshfs me@far: rw
41 22 0:45 / /tmp rw - tmpfs tmpfs rw
broken line
"""
NETWORK = ["nfs", "nfs4", "lustre", "gpfs", "cifs", "smb3", "fuse.sshfs", "beegfs", "ceph", "panfs", "9p", "fuse"]
LOCAL = ["ext4", "xfs", "btrfs", "zfs", "tmpfs", "overlay", "f2fs", "apfs", "fuseblk", "vfat"]


@pytest.fixture
def mounts(tmp_path: Path) -> Path:
    (tmp_path / "mountinfo").write_text(MOUNTS)
    return tmp_path / "mountinfo"


@pytest.fixture
def rollback(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give ledgers the journal of a network disk."""
    monkeypatch.setenv(VARIABLE, "delete")


@pytest.mark.parametrize(
    ("place", "kind", "network"),
    [
        ("/var/study/ledger.sqlite", "ext4", False),
        ("/home/me/study/ledger.sqlite", "nfs4", True),
        ("/home/me/local disk/ledger.sqlite", "xfs", False),
        ("/homework/ledger.sqlite", "ext4", False),
        ("/mnt/far/a/b/ledger.sqlite", "fuse.sshfs", True),
    ],
)
def test_the_file_system_of_a_folder_decides(mounts: Path, place: str, kind: str, network: bool) -> None:
    assert file_system(Path(place), mounts=mounts) == kind
    assert journal_for(Path(place), environment={}, mounts=mounts) == ("delete" if network else "wal")
    said = note(Path(place), mounts=mounts)
    assert said is None or (kind in said and "\n" not in said)
    assert (said is not None) == network


def test_network_disks_are_told_from_local_ones(tmp_path: Path) -> None:
    assert [kind for kind in NETWORK + LOCAL if is_network(kind)] == NETWORK
    assert file_system(tmp_path / "ledger.sqlite", mounts=tmp_path / "nothing") is None
    assert not is_network(None)


def mode_of(ledger: Ledger) -> tuple[str, int]:
    journal, synchronous = (ledger._rows(f"PRAGMA {name}")[0][0] for name in ("journal_mode", "synchronous"))
    return journal, synchronous


def test_the_environment_decides_where_it_says_anything(
    path: Path, mounts: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert journal_for(Path("/home/x"), environment={VARIABLE: "wal"}, mounts=mounts) == "wal"
    monkeypatch.delenv(VARIABLE, raising=False)
    assert (journal_for(path), note(path)) == ("wal", None)
    monkeypatch.setenv(VARIABLE, "delete")
    with Ledger.open(path, model="m") as ledger:
        assert mode_of(ledger) == ("delete", 3)
        ledger.started(RunRequest("a", {}))
        assert not path.with_name("ledger.sqlite-wal").exists()
    assert VARIABLE in str(note(path))
    assert journal.has_rollback_journal(path)
    monkeypatch.setenv(VARIABLE, "wal")
    with Ledger.open(path, model="m") as ledger:
        assert mode_of(ledger) == ("wal", 2), "each write is synchronised"
    assert not journal.has_rollback_journal(path)
    monkeypatch.setenv(VARIABLE, "memory")
    with pytest.raises(InvalidInput, match="STRANDLINE_JOURNAL in the environment: got memory; expected wal or delete"):
        Ledger.open(path, model="m")


def test_a_ledger_that_is_read_is_not_converted_and_the_driver_says_so(path: Path, request: pytest.FixtureRequest):
    Ledger.open(path, model="m").close()
    request.getfixturevalue("rollback")
    with closing(sqlite3.connect(path)) as reader, closing(sqlite3.connect(path, isolation_level=None)) as driver:
        reader.execute("SELECT * FROM meta").fetchall()
        with pytest.raises(LedgerError, match=r"cannot be given a rollback journal.*Wait until it ends"):
            journal.settle(driver, path, busy_seconds=0.05)
        (busy,) = driver.execute("PRAGMA busy_timeout").fetchone()
        assert busy == 50


@pytest.mark.usefixtures("rollback")
def test_readers_and_a_driver_do_not_stop_each_other(path: Path) -> None:
    with Ledger.open(path, model="m") as driver:
        driver._connection.execute("PRAGMA busy_timeout = 100")
        put(driver, failed("a"), failed("b"))
        with Ledger.open(path, model="m", read_only=True) as reader, Overview(path) as overview:
            under_way = iter(reader)
            assert next(under_way).key == "a"
            put(driver, failed("c"))
            assert reader.counts() == Counts(failed=3)
            assert len(overview.runs()) == 3
            assert next(under_way).key == "b"
