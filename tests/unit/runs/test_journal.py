"""The file of a ledger: its journal on local and network disks, its lock, and what happens if either is taken away."""

import os
import shutil
from pathlib import Path

import pytest
from tests.unit.runs.fakes import campaign, design, failed, put

from strandline.foundations import InvalidInput, LedgerError
from strandline.runs import Counts, Ledger, RunRequest
from strandline.runs.ledger import journal
from strandline.runs.ledger.journal import VARIABLE, file_system, is_network, journal_for, note
from strandline.runs.ledger.overview import Overview
from strandline.testing.models import Cantilever

MOUNTS = r"""22 1 254:0 / / rw,relatime - ext4 /dev/vda rw
36 22 0:40 / /home rw,relatime shared:1 master:2 - autofs systemd-1 rw
37 36 0:41 / /home rw,relatime - nfs4 server:/home rw,vers=4.2
38 37 0:42 / /home/me/local\040disk rw - xfs /dev/vdb rw
40 22 0:44 / /mnt/far rw - fuse.sshfs me@far: rw
broken line
"""
NETWORK = ["nfs", "nfs4", "lustre", "gpfs", "cifs", "smb3", "fuse.sshfs", "beegfs", "ceph", "panfs", "9p", "fuse"]
LOCAL = ["ext4", "xfs", "btrfs", "zfs", "tmpfs", "overlay", "f2fs", "apfs", "fuseblk", "vfat", None]


@pytest.fixture
def mounts(tmp_path):
    (tmp_path / "mountinfo").write_text(MOUNTS)
    return tmp_path / "mountinfo"


def test_the_file_system_of_a_folder_decides(mounts):
    for place, kind, network in (
        ("/var/study", "ext4", False),
        ("/home/me/study", "nfs4", True),
        ("/home/me/local disk", "xfs", False),
        ("/homework", "ext4", False),
        ("/mnt/far/a/b", "fuse.sshfs", True),
    ):
        ledger = Path(place) / "ledger.sqlite"
        assert file_system(ledger, mounts=mounts) == kind
        assert journal_for(ledger, environment={}, mounts=mounts) == ("delete" if network else "wal")
        said = note(ledger, mounts=mounts)
        assert (said is not None) == network
        assert said is None or (kind in said and "\n" not in said)
    assert [kind for kind in NETWORK + LOCAL if is_network(kind)] == NETWORK


def mode_of(ledger):
    return tuple(ledger._rows(f"PRAGMA {name}")[0][0] for name in ("journal_mode", "synchronous"))


def test_the_environment_decides_where_it_says_anything(path, mounts, monkeypatch):
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


def test_readers_and_a_driver_do_not_stop_each_other_on_a_network_disk(path, monkeypatch):
    monkeypatch.setenv(VARIABLE, "delete")
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


def test_a_driver_whose_lock_file_was_deleted_says_that_its_ledger_was_taken_over(path):
    said = f"took over .* lock file was deleted, .*process {os.getpid()} on "
    with Ledger.open(path, model="m") as first:
        first.started(RunRequest("a", {}))
        path.with_suffix(".lock").unlink()
        with Ledger.open(path, model="m") as second:
            put(second, failed("a"))
            with pytest.raises(LedgerError, match=said) as caught:
                first.finished(failed("a"))
    assert "damaged" not in str(caught.value)
    assert "\n" not in str(caught.value)
    with Ledger.open(path, model="m") as after:
        assert after.counts() == Counts(failed=1)
        assert after.attempts("a") == 2


def replace(path):
    shutil.copy(path, path.with_name("copy.sqlite"))
    path.with_name("copy.sqlite").replace(path)


@pytest.mark.parametrize(("change", "said"), [(Path.unlink, "deleted or moved"), (replace, "moved or replaced")])
def test_a_driver_whose_ledger_is_gone_stops_with_one_line(path, change, said):
    made = []

    def note(record, progress):
        made.append(record)
        change(path)

    with pytest.raises(LedgerError) as caught:
        campaign(path, Cantilever(), design(300, 400, 500), on_record=note)
    assert len(made) == 1
    assert f"{path} is not the file that this run opened: got " in str(caught.value)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_ended_before_a_ledger_was_moved_is_in_it(path):
    moved = path.with_name("moved.sqlite")
    with Ledger.open(path, model="m") as ledger:
        put(ledger, failed("a"))
        path.rename(moved)
        with pytest.raises(LedgerError, match="Put it back"):
            ledger.started(RunRequest("b", {}))
    moved.rename(path)
    with Ledger.open(path, model="m") as after:
        assert after.counts() == Counts(failed=1)


def test_an_outcome_that_another_program_has_written_is_no_damage(path):
    with Ledger.open(path, model="m") as ledger:
        number = ledger.started(RunRequest("a", {}))
        ledger.finished(failed("a"))
        with pytest.raises(LedgerError, match=r"does not take this row.*no other program writes") as caught:
            ledger._finish(number, failed("a"))
    assert "damaged" not in str(caught.value)


def test_a_lock_file_that_was_deleted_is_made_again_where_nobody_came_in(path):
    with Ledger.open(path, model="m") as ledger:
        path.with_suffix(".lock").unlink()
        ledger.started(RunRequest("a", {}))
        with pytest.raises(LedgerError, match="is locked"):
            Ledger.open(path, model="m")
        path.with_suffix(".lock").unlink()
        ledger.finished(failed("a"))
    Ledger.open(path, model="m").close()
