"""Folders in which runs are made: a driver that was killed leaves one behind, and the next one removes it."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from strandline.runs import InProcess, LocalProcesses, scratch
from strandline.testing.executors import requests_for
from strandline.testing.models import Cantilever

DRIVER = """
import os, signal, sys
from pathlib import Path
from strandline.runs.scratch import scratch_folder
folder = scratch_folder()
(folder / "run-1").mkdir()
(folder / "run-1" / "mesh.msh").write_text("large")
print(folder, flush=True)
if sys.argv[1] == "killed":
    os.kill(os.getpid(), signal.SIGKILL)
sys.stdin.read()
"""


@pytest.fixture
def parent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for temporary files of this process and of those that it starts."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return tmp_path


def driver(end: str) -> tuple["subprocess.Popen[str]", Path]:
    """Return a driver that has made its folder, and the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", DRIVER, end], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


@pytest.mark.parametrize("executor", [LocalProcesses(1), InProcess()])
def test_the_next_driver_clears_the_folder_of_one_that_was_killed(parent: Path, executor: object) -> None:
    assert callable(executor)
    process, folder = driver("killed")
    with process:
        process.communicate()
    assert (folder / "run-1" / "mesh.msh").is_file()
    model = Cantilever()
    (record,) = executor(model, requests_for(model, [400.0]))
    assert record.ok
    assert list(parent.iterdir()) == []


def test_the_folder_of_a_driver_at_work_stays(parent: Path) -> None:
    process, folder = driver("waits")
    with process:
        assert scratch.clear_stale(parent) == 0
        assert (folder / "run-1" / "mesh.msh").is_file()
        process.communicate()
    assert scratch.clear_stale(parent) == 1
    assert not folder.exists()


@pytest.mark.skipif(sys.platform != "linux", reason="the system does not say when a process was started")
def test_a_process_that_has_the_number_of_a_dead_one_does_not_keep_its_folder(parent: Path) -> None:
    mine = scratch.scratch_folder()
    machine, pid, begun = mine.name.removeprefix(scratch.PREFIX).split("-")[:3]
    older = parent / f"{scratch.PREFIX}{machine}-{pid}-{int(begun) - 1}-abc"
    older.mkdir()
    assert scratch.clear_stale(parent) == 1
    assert mine.is_dir()
    assert not older.exists()


def test_folders_of_other_machines_and_users_and_links_stay(parent: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = scratch.scratch_folder()
    gone = mine.name.replace(f"-{os.getpid()}-", "-999999999-")
    machine = gone.removeprefix(scratch.PREFIX).split("-")[0]
    elsewhere = parent / gone.replace(machine, "0" * 8)
    foreign = [elsewhere, parent / "strandline-runs-notes", parent / "strandline-on-call-abc"]
    for folder in foreign:
        folder.mkdir()
    target = parent / "target"
    target.mkdir()
    (parent / gone).symlink_to(target)
    assert scratch.clear_stale(parent) == 0
    assert all(folder.is_dir() for folder in (*foreign, target))
    (parent / gone).unlink()
    (parent / gone).mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(os, "getuid", lambda: 12345)
        assert scratch.clear_stale(parent) == 0
    assert scratch.clear_stale(parent) == 1
    shutil.rmtree(mine)
