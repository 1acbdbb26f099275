"""A ledger whose file, or whose lock, is taken away while a driver works: the driver says what happened."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from strandline.errors import LedgerError
from strandline.runs import Counts, InProcess, Ledger, RunRecord, RunRequest, run_campaign
from strandline.testing.models import Cantilever

DESIGN = [{"E": value, "load": 1e-5} for value in (300.0, 400.0, 500.0)]
SECOND = """
import sys
from strandline.runs import Ledger, RunRecord, RunRequest
with Ledger.open(sys.argv[1], model="m") as ledger:
    ledger.started(RunRequest("a", {}))
    ledger.finished(RunRecord("a", {}, "failed"))
    print("open", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "study" / "ledger.sqlite"


@pytest.fixture
def ledger(path: Path) -> Ledger:
    path.parent.mkdir()
    return Ledger.open(path, model="m")


def second_driver(path: Path) -> "subprocess.Popen[str]":
    """Return another driver, which has come in and ended a run."""
    command = [sys.executable, "-c", SECOND, str(path)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "open\n"
    return process


@pytest.mark.parametrize("still_there", [True, False])
def test_a_driver_whose_lock_file_was_deleted_says_who_took_its_ledger_over(
    path: Path, ledger: Ledger, still_there: bool
) -> None:
    with ledger:
        ledger.started(RunRequest("a", {}))
        path.with_suffix(".lock").unlink()
        with second_driver(path) as second:
            if not still_there:
                second.communicate()
            with pytest.raises(LedgerError) as caught:
                ledger.finished(RunRecord("a", {}, "failed"))
            if still_there:
                second.communicate()
    said = str(caught.value)
    assert f"another driver took over the ledger {path}: got its lock file was deleted" in said
    assert f"process {second.pid} on " in said
    assert "damaged" not in said
    assert "backup" not in said
    assert "\n" not in said
    with Ledger.open(path, model="m") as after:
        assert after.counts() == Counts(failed=1)
        assert after.attempts("a") == 2


def test_a_lock_file_that_was_deleted_is_made_again_where_nobody_came_in(path: Path, ledger: Ledger) -> None:
    with ledger:
        path.with_suffix(".lock").unlink()
        ledger.started(RunRequest("a", {}))
        with pytest.raises(LedgerError, match="is locked"):
            Ledger.open(path, model="m")
        path.with_suffix(".lock").unlink()
        ledger.finished(RunRecord("a", {}, "failed"))
    Ledger.open(path, model="m").close()


def deleted(path: Path) -> None:
    path.unlink()


def moved(path: Path) -> None:
    path.rename(path.with_name("moved.sqlite"))


def replaced(path: Path) -> None:
    shutil.copy(path, path.with_name("copy.sqlite"))
    path.with_name("copy.sqlite").replace(path)


def folder_moved(path: Path) -> None:
    path.parent.rename(path.parent.with_name("elsewhere"))


def folder_deleted(path: Path) -> None:
    shutil.rmtree(path.parent)


@pytest.mark.parametrize("change", [deleted, moved, replaced, folder_moved, folder_deleted])
def test_a_driver_whose_ledger_is_gone_stops_with_one_line(path: Path, change: object) -> None:
    assert callable(change)
    path.parent.mkdir()
    model, made = Cantilever(), []

    def note(record: RunRecord, _: object) -> None:
        made.append(record)
        change(path)

    with Ledger.open(path, model=model) as ledger, pytest.raises(LedgerError) as caught:
        run_campaign(model, DESIGN, ledger=ledger, executor=InProcess(), on_record=note)
    assert len(made) == 1
    assert f"{path} is not the file that this run opened: got deleted" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_ended_before_a_ledger_was_moved_is_in_it(path: Path, ledger: Ledger) -> None:
    with ledger:
        ledger.started(RunRequest("a", {}))
        ledger.finished(RunRecord("a", {}, "failed"))
        moved(path)
        with pytest.raises(LedgerError, match="Put it back"):
            ledger.started(RunRequest("b", {}))
    path.with_name("moved.sqlite").rename(path)
    with Ledger.open(path, model="m") as after:
        assert after.counts() == Counts(failed=1)


def test_an_outcome_that_another_program_has_written_is_no_damage(ledger: Ledger) -> None:
    with ledger:
        number = ledger.started(RunRequest("a", {}))
        ledger.finished(RunRecord("a", {}, "failed"))
        with pytest.raises(LedgerError, match=r"does not take this row.*no other program writes") as caught:
            ledger._finish(number, RunRecord("a", {}, "failed"))
    assert "damaged" not in str(caught.value)
