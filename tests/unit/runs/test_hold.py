"""A ledger whose file, or whose lock, is taken away while a driver works: the driver says what happened."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.unit.runs.fakes import campaign, design
from tests.unit.runs.ledgers import failed, put

from strandline.errors import LedgerError
from strandline.runs import Counts, Ledger, RunRequest
from strandline.testing.models import Cantilever


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "study").mkdir()
    return tmp_path / "study" / "ledger.sqlite"


@pytest.mark.parametrize("still_there", [True, False])
def test_a_driver_whose_lock_file_was_deleted_says_that_its_ledger_was_taken_over(
    path: Path, still_there: bool
) -> None:
    with Ledger.open(path, model="m") as first:
        first.started(RunRequest("a", {}))
        path.with_suffix(".lock").unlink()
        with Ledger.open(path, model="m") as second:
            put(second, failed("a"))
            if not still_there:
                second.close()
            with pytest.raises(
                LedgerError, match=f"took over .* lock file was deleted, .*process {os.getpid()} on "
            ) as caught:
                first.finished(failed("a"))
    assert "damaged" not in str(caught.value)
    assert "\n" not in str(caught.value)
    with Ledger.open(path, model="m") as after:
        assert after.counts() == Counts(failed=1)
        assert after.attempts("a") == 2


def test_a_lock_file_that_was_deleted_is_made_again_where_nobody_came_in(path: Path) -> None:
    with Ledger.open(path, model="m") as ledger:
        path.with_suffix(".lock").unlink()
        ledger.started(RunRequest("a", {}))
        with pytest.raises(LedgerError, match="is locked"):
            Ledger.open(path, model="m")
        path.with_suffix(".lock").unlink()
        ledger.finished(failed("a"))
    Ledger.open(path, model="m").close()


def move(path: Path) -> None:
    path.rename(path.with_name("moved.sqlite"))


def replace(path: Path) -> None:
    shutil.copy(path, path.with_name("copy.sqlite"))
    path.with_name("copy.sqlite").replace(path)


def move_folder(path: Path) -> None:
    path.parent.rename(path.parent.with_name("elsewhere"))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (Path.unlink, "deleted or moved"),
        (move, "deleted or moved"),
        (replace, "deleted, moved or replaced"),
        (move_folder, "deleted or moved"),
        (lambda path: shutil.rmtree(path.parent), "deleted or moved"),
    ],
    ids=["deleted", "moved", "replaced", "folder moved", "folder deleted"],
)
def test_a_driver_whose_ledger_is_gone_stops_with_one_line(
    path: Path, change: Callable[[Path], None], said: str
) -> None:
    made = []

    def note(record: object, progress: object) -> None:
        made.append(record)
        change(path)

    with pytest.raises(LedgerError) as caught:
        campaign(path, Cantilever(), design(300, 400, 500), on_record=note)
    assert len(made) == 1
    assert f"{path} is not the file that this run opened: got {said}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_ended_before_a_ledger_was_moved_is_in_it(path: Path) -> None:
    with Ledger.open(path, model="m") as ledger:
        put(ledger, failed("a"))
        move(path)
        with pytest.raises(LedgerError, match="Put it back"):
            ledger.started(RunRequest("b", {}))
    path.with_name("moved.sqlite").rename(path)
    with Ledger.open(path, model="m") as after:
        assert after.counts() == Counts(failed=1)


def test_an_outcome_that_another_program_has_written_is_no_damage(path: Path) -> None:
    with Ledger.open(path, model="m") as ledger:
        number = ledger.started(RunRequest("a", {}))
        ledger.finished(failed("a"))
        with pytest.raises(LedgerError, match=r"does not take this row.*no other program writes") as caught:
            ledger._finish(number, failed("a"))
    assert "damaged" not in str(caught.value)
