"""A ledger on a network disk: one line at the start of a run says what it is given."""

from pathlib import Path
from typing import Any

import pytest

from strandline.cli.main import main
from strandline.errors import InvalidStudy
from strandline.runs.journal import VARIABLE
from strandline.studies import run
from strandline.testing.studies import write_study


def not_run(*_: Any, **__: Any) -> None:
    raise InvalidStudy("the end of this test", value=1, expected="2", remedy="None.")


@pytest.mark.parametrize(("journal", "lines"), [("delete", 1), ("wal", 0), ("", 0)])
def test_a_rollback_journal_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], journal: str, lines: int
) -> None:
    monkeypatch.setenv(VARIABLE, journal)
    monkeypatch.setattr(run, "run_study", not_run)
    study = write_study(tmp_path / "study")
    for arguments, expected in ((["run", str(study)], lines), (["run", "--quiet", str(study)], 0)):
        with pytest.raises(SystemExit):
            main(arguments)
        said = capsys.readouterr().err.splitlines()
        assert sum("rollback journal" in line for line in said) == expected
        assert len(said) == expected + 1


def test_a_journal_that_there_is_not_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(VARIABLE, "memory")
    study = write_study(tmp_path / "study")
    before = sorted(study.iterdir())
    with pytest.raises(SystemExit) as ended:
        main(["run", "--quiet", str(study)])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "STRANDLINE_JOURNAL in the environment: got memory; expected wal or delete" in said
    assert sorted(study.iterdir()) == before
