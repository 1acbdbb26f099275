"""`strandline doctor` and `strandline backup`, and results that stay under the text that they are of."""

import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from strandline.cli import main
from strandline.errors import InvalidStudy, LedgerError
from strandline.interface import GaussianNoise
from strandline.models.protocol import fingerprint
from strandline.runs import FailurePolicy, InProcess, Ledger, RunRequest
from strandline.studies import load_study, run_study
from strandline.studies.doctor import examine
from strandline.studies.provenance import require_its_own_text


@pytest.fixture
def folder(finished: Any, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished.folder, tmp_path / "beam"))


def summary_with(folder: Path, **changes: Any) -> None:
    path = folder / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def tamper(path: Path, sql: str) -> None:
    with closing(sqlite3.connect(path)) as connection:
        for name in ("outcomes_no_UPDATE", "outcomes_no_DELETE"):
            connection.execute(f"DROP TRIGGER {name}")
        connection.execute(sql)
        connection.commit()


def without_outcome(folder: Path) -> None:
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1") as ledger:
        (key,) = load_study(folder).runs.design_keys[:1]
        ledger.started(RunRequest("lost", {"E": 1.0}))
        assert ledger.latest([key])
    text = (folder / "study.yaml").read_text().replace('"runs": 64', '"runs": 65')
    (folder / "study.yaml").write_text(text)


def exclude(folder: Path) -> None:
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1") as ledger:
        ledger.exclude(load_study(folder).runs.design_keys[5], "odd")


def answered_before(folder: Path, name: str) -> None:
    (folder / name).write_text('{"study_sha256": "that of another study.yaml"}')


WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    "checksum": (
        lambda folder: tamper(folder / "ledger.sqlite", "UPDATE outcomes SET seconds = 7 WHERE attempt = 9"),
        "1 outcome(s) do not match their checksum",
    ),
    "gap": (without_outcome, "1 of 65 planned runs have no outcome"),
    "excluded": (exclude, "the ledger has changed since the results were made"),
    "leftover": (lambda folder: (folder / ".summary.json.7.partial").touch(), "left by a process that was killed"),
    "versions": (lambda folder: summary_with(folder, version="0.0.1"), "other versions: strandline 0.0.1"),
    "model": (lambda folder: summary_with(folder, model="m"), "made with the model m"),
    "missing": (lambda folder: (folder / "posterior.nc").unlink(), "missing next to summary.json: posterior.nc"),
    "half": (lambda folder: (folder / "summary.json").unlink(), "without a readable summary.json"),
    **{
        name: (partial(answered_before, name=name), f"{name} is of another study.yaml")
        for name in ("check.json", "coverage.json", "next.json", "what-if.json", "specimens.json")
    },
    "study": (lambda folder: (folder / "study.yaml").write_text("version: 1\n"), "study.yaml cannot be used"),
}


def test_a_finished_study_is_sound(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    main(["doctor", str(folder)])
    assert capsys.readouterr().out == "sound: nothing found\n"
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_found_and_has_a_remedy(folder: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    spoil, words = WRONG[name]
    spoil(folder)
    with pytest.raises(SystemExit) as ended:
        main(["doctor", str(folder)])
    assert ended.value.code == 1
    shown = capsys.readouterr().out
    assert words in shown
    assert all(finding.remedy for finding in examine(folder))
    assert shown.count("\n  -> ") == len(examine(folder))


def test_a_backup_holds_all_runs_and_overwrites_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "kept.sqlite"
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


def test_a_study_changed_since_it_was_loaded_is_refused(folder: Path) -> None:
    study = load_study(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    for changed, word in (
        (replace(study, noise=GaussianNoise(1.0)), "noise"),
        (replace(study, fixed={"load": 2e-5}), "fixed"),
        (replace(study, settings=replace(study.settings, seed=5)), "settings.seed"),
    ):
        with pytest.raises(InvalidStudy, match=word) as caught:
            run_study(changed, executor=InProcess())
        assert "\n" not in str(caught.value)
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before


def test_what_changes_no_result_may_be_replaced(folder: Path) -> None:
    study = load_study(folder)
    policy = FailurePolicy(again=frozenset({"timeout"}))
    require_its_own_text(replace(study, executor=InProcess(), settings=replace(study.settings, failures=policy)))
    require_its_own_text(replace(study, noise=GaussianNoise(1.0), text=study.text + "# with another noise"))


OLD = "def helper(a):\n    return a\n\ndef f(inputs, workdir):\n    return [[0.0, 0.0], [1.0, helper(inputs['a'])]]\n"
STUDY = """version: 1
name: old
model: {python: {function: "old_ledger_model:f"}}
inputs: {a: {prior: {uniform: [0, 1]}}}
observation: {synthetic: {a: 0.5}}
discrepancy: {tracked_points: {}}
noise: {sd: 0.1}
design: {sobol: {runs: 8}}
"""


def test_an_earlier_ledger_of_an_unchanged_function_is_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "old_ledger_model.py").write_text(OLD)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "study.yaml").write_text(STUDY)
    now = fingerprint(load_study(tmp_path).model)
    assert now.startswith("python-files:")
    earlier = fingerprint(replace(load_study(tmp_path).model, function_alone=True))
    Ledger.open(tmp_path / "ledger.sqlite", model=earlier).close()
    study = load_study(tmp_path)
    assert fingerprint(study.model) == earlier
    Ledger.open(study.ledger_path, model=study.model).close()
    assert any("covered old_ledger_model:f alone" in finding.what for finding in examine(tmp_path))
    shutil.move(tmp_path / "ledger.sqlite", tmp_path / "away")
    assert fingerprint(load_study(tmp_path).model) == now
    Ledger.open(tmp_path / "ledger.sqlite", model="python:another").close()
    with pytest.raises(LedgerError, match="another model"):
        Ledger.open(tmp_path / "ledger.sqlite", model=fingerprint(load_study(tmp_path).model))
