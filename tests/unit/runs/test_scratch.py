"""Folders in which runs are made: a driver that was killed leaves one behind, and the next one removes it."""

import os
import sys
import tempfile
from pathlib import Path

import pytest
from tests.unit.runs.fakes import design, key_of

from strandline.runs import InProcess, RunRequest, scratch
from strandline.testing.models import Cantilever


@pytest.fixture
def parent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_the_next_driver_clears_the_folder_of_one_that_is_gone_and_its_own(parent: Path) -> None:
    mine = scratch.scratch_folder()
    gone = parent / mine.name.replace(f"-{os.getpid()}-", "-999999999-")
    gone.mkdir()
    (gone / "mesh.msh").write_text("large")
    (inputs,) = design(400)
    (record,) = InProcess()(Cantilever(), [RunRequest(key_of(Cantilever(), inputs), inputs)])
    assert record.ok
    assert list(parent.iterdir()) == [mine]


@pytest.mark.skipif(sys.platform != "linux", reason="the system does not say when a process was started")
def test_a_process_that_has_the_number_of_a_dead_one_does_not_keep_its_folder(parent: Path) -> None:
    mine = scratch.scratch_folder()
    machine, pid, begun = mine.name.removeprefix(scratch.PREFIX).split("-")[:3]
    older = parent / f"{scratch.PREFIX}{machine}-{pid}-{int(begun) - 1}-abc"
    older.mkdir()
    assert scratch.clear_stale(parent) == 1
    assert [path.name for path in parent.iterdir()] == [mine.name]


def test_folders_of_other_machines_and_users_and_links_stay(parent: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = scratch.scratch_folder().name.replace(f"-{os.getpid()}-", "-999999999-")
    machine = gone.removeprefix(scratch.PREFIX).split("-")[0]
    elsewhere = gone.replace(machine, "0" * 8)
    foreign = [parent / name for name in (elsewhere, "strandline-runs-notes", "strandline-on-call-abc", "target")]
    for folder in foreign:
        folder.mkdir()
    (parent / gone).symlink_to(parent / "target")
    assert scratch.clear_stale(parent) == 0
    (parent / gone).unlink()
    (parent / gone).mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(os, "getuid", lambda: 12345)
        assert scratch.clear_stale(parent) == 0
    assert scratch.clear_stale(parent) == 1
    assert all(folder.is_dir() for folder in foreign)
