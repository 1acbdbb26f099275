"""Runs excluded by hand: not used, not made again, and nothing else changes; ledgers of earlier versions are kept."""

import shutil
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from strandline.errors import LedgerError
from strandline.interface import Interface
from strandline.runs import FailurePolicy, InProcess, Ledger, Retry, run_campaign, run_key
from strandline.runs.backup import copied
from strandline.runs.overview import Overview

DATA = Path(__file__).parents[1] / "data"
MADE: list[float] = []


@dataclass(frozen=True)
class Line:
    """Notes each run that is made."""

    fingerprint: str = "test:line"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Interface:
        MADE.append(inputs["E"])
        return Interface.polyline(np.array([[0.0, 0.0], [1.0, inputs["E"]]]))


INPUTS = [{"E": 1.0}, {"E": 2.0}, {"E": 3.0}]
KEYS = [run_key(Line().fingerprint, entry) for entry in INPUTS]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    campaign(tmp_path / "ledger.sqlite")
    MADE.clear()
    return tmp_path / "ledger.sqlite"


def campaign(path: Path, policy: FailurePolicy | None = None) -> list[str]:
    with Ledger.open(path, model="test:line") as ledger:
        made = run_campaign(Line(), INPUTS, ledger=ledger, executor=InProcess(), policy=policy)
    return [record.state for record in made]


def test_an_excluded_run_is_not_used_and_not_made_again(path: Path) -> None:
    with Ledger.open(path, model="test:line") as ledger:
        before = ledger.latest(KEYS)
        ledger.exclude(KEYS[1], "the mesh\nfolded")
        after = ledger.latest(KEYS)
        assert [record.state for record in ledger] == ["ok", "excluded", "ok"]
    assert after[KEYS[1]].message == "excluded by hand: the mesh folded"
    assert after[KEYS[1]].interfaces == {}
    for key in (KEYS[0], KEYS[2]):
        assert after[key].interfaces[""].points.tobytes() == before[key].interfaces[""].points.tobytes()
    for policy in (None, FailurePolicy({"invalid": Retry(3)}), FailurePolicy(again=frozenset({"excluded"}))):
        assert campaign(path, policy) == ["ok", "excluded", "ok"]
    assert MADE == []
    with Ledger.open(path, model="test:line") as ledger:
        ledger.include(KEYS[1])
        assert ledger.latest(KEYS)[KEYS[1]].interfaces[""].points.tolist() == [[0, 0], [1, 2]]
    assert campaign(path) == ["ok", "ok", "ok"]
    assert MADE == []


def test_every_decision_stays_in_the_ledger(path: Path) -> None:
    with Ledger.open(path, model="test:line") as ledger:
        ledger.exclude(KEYS[1], "odd")
        ledger.include(KEYS[1], "it was right")
    with closing(sqlite3.connect(path)) as connection:
        rows = connection.execute("SELECT key, excluded, why FROM exclusions").fetchall()
        assert rows == [(KEYS[1], 1, "odd"), (KEYS[1], 0, "it was right")]
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            connection.execute("DELETE FROM exclusions")


def test_what_cannot_be_excluded(path: Path) -> None:
    with Ledger.open(path, model="test:line") as ledger:
        with pytest.raises(LedgerError, match="a few words"):
            ledger.exclude(KEYS[0], " ")
        with pytest.raises(LedgerError, match="no outcome yet"):
            ledger.exclude("unknown", "odd")
        with pytest.raises(LedgerError, match="not excluded"):
            ledger.include(KEYS[0])
        ledger.exclude(KEYS[0], "odd")
        with pytest.raises(LedgerError, match="excluded already"):
            ledger.exclude(KEYS[0], "odd")


def test_an_excluded_run_is_not_copied(path: Path, tmp_path: Path) -> None:
    with Ledger.open(path, model="test:line") as ledger:
        ledger.exclude(KEYS[1], "odd")
    with Ledger.open(tmp_path / "other.sqlite", model="test:line") as other:
        assert other.copy_from(path, KEYS) == 2


def test_the_overview_says_so(path: Path) -> None:
    with Ledger.open(path, model="test:line") as ledger:
        ledger.exclude(KEYS[1], "odd")
    with Overview(path) as overview:
        assert [run.exclusion.why if run.exclusion else None for run in overview.runs()] == [None, "odd", None]


@pytest.mark.parametrize("name", ["ledger-v1.sqlite", "ledger-v2-study.sqlite", "ledger-v3-study.sqlite"])
def test_an_earlier_ledger_is_copied_before_its_upgrade(tmp_path: Path, name: str) -> None:
    path = Path(shutil.copy(DATA / name, tmp_path / "ledger.sqlite"))
    path.chmod(0o644)
    with Ledger.open(path, model=None, read_only=True) as reader:
        model, before = reader.model, [(record.key, record.state) for record in reader]
        assert reader.exclusions() == {}
    assert [one.name for one in tmp_path.iterdir()] == ["ledger.sqlite"]
    version = name[len("ledger-v")]
    for number in ("", "-1"):
        path.write_bytes((DATA / name).read_bytes())
        with Ledger.open(path, model=model) as ledger:
            assert ledger.backup == tmp_path / f"ledger.sqlite.v{version}-backup{number}"
            assert [(record.key, record.state) for record in ledger] == before
        with Ledger.open(ledger.backup, model=model, read_only=True) as kept:
            assert [(record.key, record.state) for record in kept] == before
            assert kept._meta("schema_version") == version
    with Ledger.open(path, model=model) as ledger:
        assert ledger.backup is None


def test_a_copy_overwrites_nothing(path: Path, tmp_path: Path) -> None:
    target = tmp_path / "kept"
    target.write_text("mine")
    with closing(sqlite3.connect(path)) as connection, pytest.raises(FileExistsError):
        copied(connection, target)
    assert target.read_text() == "mine"
    assert not list(tmp_path.glob("*.partial")) + list(tmp_path.glob(".*.partial"))
