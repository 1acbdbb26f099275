"""`strandline doctor` and `strandline backup` on a finished study."""

import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest
from tests.study.conftest import Finished

from strandline.cli import main
from strandline.runs import Ledger, RunRequest
from strandline.studies import load_study
from strandline.studies.doctor import examine


def summary_with(folder: Path, **changes: object) -> None:
    path = folder / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def tamper(folder: Path) -> None:
    with closing(sqlite3.connect(folder / "ledger.sqlite")) as connection, connection:
        for name in ("outcomes_no_UPDATE", "outcomes_no_DELETE"):
            connection.execute(f"DROP TRIGGER {name}")
        connection.execute("UPDATE outcomes SET seconds = 7 WHERE attempt = 9")


def without_outcome(folder: Path) -> None:
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1") as ledger:
        ledger.started(RunRequest("lost", {"E": 1.0}))
    text = (folder / "study.yaml").read_text().replace('"runs": 64', '"runs": 65')
    (folder / "study.yaml").write_text(text)


def exclude(folder: Path) -> None:
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1") as ledger:
        ledger.exclude(load_study(folder).runs.design_keys[5], "odd")


def answered_before(folder: Path, name: str) -> None:
    (folder / name).write_text('{"study_sha256": "that of another study.yaml"}')


ANSWERS = ("check.json", "coverage.json", "next.json", "what-if.json", "specimens.json")
WRONG: list[tuple[Callable[[Path], object], str]] = [
    (tamper, "1 outcome(s) do not match their checksum"),
    (without_outcome, "1 of 65 planned runs have no outcome"),
    (exclude, "the ledger has changed since the results were made"),
    (lambda folder: (folder / ".summary.json.7.partial").touch(), "left by a process that was killed"),
    (lambda folder: summary_with(folder, version="0.0.1"), "other versions: strandline 0.0.1"),
    (lambda folder: summary_with(folder, model="m"), "made with the model m"),
    (lambda folder: (folder / "posterior.nc").unlink(), "missing next to summary.json: posterior.nc"),
    (lambda folder: (folder / "summary.json").unlink(), "without a readable summary.json"),
    *[(partial(answered_before, name=name), f"{name} is of another study.yaml") for name in ANSWERS],
    (lambda folder: (folder / "study.yaml").write_text("version: 1\n"), "study.yaml cannot be used"),
]


def test_what_is_wrong_is_found_and_has_a_remedy(
    beam: Finished, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, (spoil, words) in enumerate(WRONG):
        folder = Path(shutil.copytree(beam.folder, tmp_path / str(number)))
        spoil(folder)
        with pytest.raises(SystemExit) as ended:
            main(["doctor", str(folder)])
        shown, found = capsys.readouterr().out, examine(folder)
        assert ended.value.code == 1
        assert words in shown
        assert all(finding.remedy for finding in found)
        assert shown.count("\n  -> ") == len(found)


def test_a_finished_study_is_sound_and_a_backup_holds_all_its_runs(
    beam: Finished,
    copy_of: Callable[[Finished], Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, target = copy_of(beam), tmp_path / "kept.sqlite"
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    main(["doctor", str(folder)])
    assert capsys.readouterr().out == "sound: nothing found\n"
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1") as driver:
        main(["backup", str(folder), str(target)])
        expected = [(record.key, record.state) for record in driver]
    assert f"wrote {target}: 65 runs" in capsys.readouterr().out
    with Ledger.open(target, model="test:beam-1", read_only=True) as copy:
        assert [(record.key, record.state) for record in copy] == expected
    content = target.read_bytes()
    with pytest.raises(SystemExit) as ended:
        main(["backup", str(folder), str(target)])
    assert ended.value.code == 2
    assert target.read_bytes() == content
