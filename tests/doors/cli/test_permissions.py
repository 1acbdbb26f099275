"""Folders that may not be written to, another driver, and how a real process ends."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.unit.cli.command_line import ALL_SET, Shown, contents, one_line, printed, refused

from strandline.testing.studies import write_study

COMMAND = [sys.executable, "-c", "from strandline.cli import main; main()"]


@contextmanager
def another_driver(folder: Path) -> Iterator[int]:
    """Keep the study's ledger open in another process; give its process id."""
    code = (
        "import sys, pathlib; from strandline.runs import Ledger\n"
        f"with Ledger.open(pathlib.Path({str(folder / 'ledger.sqlite')!r}), model='test:beam-1'):\n"
        "    print('open', flush=True); sys.stdin.read()\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stdout.readline() == b"open\n"
    try:
        yield process.pid
    finally:
        process.stdin.close()
        process.wait(10)
        process.stdout.close()


@pytest.mark.smoke
def test_a_second_driver_is_refused_and_may_look(tmp_path: Path, capsys: Shown) -> None:
    folder = write_study(tmp_path / "study")
    with another_driver(folder) as pid:
        before = contents(folder)
        line = refused(capsys, "run", str(folder), "--quiet")
        assert "ledger.sqlite is locked" in line
        assert f"process {pid} on " in line
        assert "Wait for the other run to end" in line
        assert contents(folder) == before
        assert "0 of 64 runs" in printed(capsys, "status", str(folder))


def denied(*arguments: str) -> str:
    """Return the line with which a process refuses that permissions bind, the superuser's too."""
    command = [*COMMAND, *arguments]
    if os.geteuid() == 0:
        tool = shutil.which("setpriv")
        if tool is None:
            pytest.skip("the superuser passes all permissions, and there is no setpriv to drop that right")
        command = [tool, "--bounding-set=-dac_override", "--inh-caps=-dac_override", *command]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (2, "")
    return one_line(ended.stderr)


@pytest.mark.parametrize("subcommand", [pytest.param("run", marks=pytest.mark.smoke), "check"])
def test_a_folder_that_cannot_be_written_to(subcommand: str, tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study")
    before = contents(folder)
    folder.chmod(0o555)
    try:
        line = denied(subcommand, str(folder))
    finally:
        folder.chmod(0o755)
    assert f"the study folder cannot be written to: got {folder}: Permission denied" in line
    assert "copy the study elsewhere" in line
    assert contents(folder) == before


def test_a_table_without_permission_is_found_before_the_run(tmp_path: Path) -> None:
    """The load would fail the run, which would be told instead had it been made."""
    folder, closed = write_study(tmp_path / "study"), tmp_path / "closed"
    closed.mkdir(mode=0o555)
    line = denied("forward", str(folder), *ALL_SET, "--set", "load=1", "--csv", str(closed / "a.csv"))
    assert "without write permission" in line
