"""The ledger: what goes in comes out, nothing is lost, and every misuse is one clear error."""

import os
import shutil
import sqlite3
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.unit.runs import fakes
from tests.unit.runs.fakes import BAD, LINE, ONE, RECORDS, SURFACE, TWO, exact, failed, put, query, states

from strandline.foundations import LedgerError
from strandline.interface import Interface
from strandline.runs import Counts, FailurePolicy, Ledger, Retry, RunRecord, RunRequest
from strandline.runs.ledger import ledger_schema
from strandline.runs.ledger.overview import Overview
from strandline.runs.ledger.plans import Plan
from strandline.testing.executors import same_outcome
from strandline.testing.models import Cantilever

KILLED = RunRecord("a", {}, "killed", failure_kind="worker_died")
PLAN = Plan("digest", "beam", "m", ("E",), False, 1, (("two",),))


def test_everything_comes_back_bit_for_bit(path):
    with Ledger.open(path, model="m", description="a beam") as ledger:
        put(ledger, *RECORDS)
    with Ledger.open(path, model="m") as ledger:
        assert [exact(r) for r in ledger] == [exact(r) for r in RECORDS]
        found = ledger.latest([r.key for r in RECORDS] + ["unknown"])
        assert {k: exact(r) for k, r in found.items()} == {r.key: exact(r) for r in RECORDS}
        assert (ledger.model, ledger.description) == ("m", "a beam")
        restored = found["line"].interface.points
        assert restored.dtype == np.float64
        assert restored.flags.writeable
        ledger.started(RunRequest("lost", {"E": 9.0}))
        assert ledger.counts() == Counts(ok=4, failed=1, timeout=1, killed=1, invalid=1, open=1)
        assert "lost" not in ledger.latest(["lost"])


def test_more_keys_than_one_query_takes(path):
    keys = {f"run {number}" for number in range(1201)}
    with Ledger.open(path, model="m") as ledger:
        with ledger._transaction():
            put(ledger, *map(failed, keys))
        assert set(ledger.latest(keys)) == keys
        assert {record.key for record in ledger} == keys
    with Overview(path) as overview:
        assert len(overview.changes(1000, range(1, 800))) == 1201 - 1000 + 799


def test_the_last_outcome_counts_and_attempts_are_counted(path):
    with Ledger.open(path, model="m") as ledger:
        put(ledger, KILLED, replace(KILLED, failure_kind="interrupted"))
        ledger.started(RunRequest("a", {}))
        assert (ledger.attempts("a"), ledger.open_attempts("a"), ledger.attempts("never")) == (2, 2, 0)
        put(ledger, RunRecord("a", {}, "ok", {"": LINE}))
        assert (ledger.attempts("a"), ledger.open_attempts("a")) == (3, 0)
        assert ledger.latest(["a"])["a"].ok
        assert ledger.counts() == Counts(ok=1)
        assert states(ledger) == ["ok"]


def test_an_outcome_without_a_start_is_refused_and_nothing_is_ever_changed(path):
    with Ledger.open(path, model="m") as ledger:
        put(ledger, TWO)
        for record in (TWO, SURFACE):
            with pytest.raises(LedgerError, match="started and has no outcome"):
                ledger.finished(record)
        ledger.plan(PLAN)
        ledger.exclude("two", "odd")
        for name in ("sessions", "starts", "outcomes", "arrays", "plans", "exclusions"):
            (column, *_) = ledger._connection.execute(f"SELECT * FROM {name}").description[0]
            for verb in (f"UPDATE {name} SET {column} = 0", f"DELETE FROM {name}"):
                with pytest.raises(sqlite3.IntegrityError, match="append-only"):
                    ledger._connection.execute(verb)


DAMAGES = [
    (ONE, "UPDATE outcomes SET points = zeroblob(length(points))"),
    (ONE, "UPDATE outcomes SET diagnostics = '{\"iterations\": 8.0}'"),
    (ONE, "UPDATE starts SET inputs = '{\"E\": 0.2}'"),
    (TWO, "UPDATE arrays SET data = zeroblob(length(data)) WHERE role = 'sensitivity'"),
    (TWO, "UPDATE arrays SET shape = '[132, 1]' WHERE role = 'points' AND condition = 'slow'"),
    (TWO, "UPDATE arrays SET input = 'E2' WHERE input = 'E'"),
    (TWO, "DELETE FROM arrays WHERE role = 'sensitivity' AND input = 'nu'"),
    (TWO, "INSERT INTO arrays SELECT attempt, role, condition, 'x', shape, data FROM arrays WHERE input = 'nu'"),
]


def test_damage_to_a_run_is_noticed_and_the_run_named(path):
    with Ledger.open(path, model="m") as ledger:
        put(ledger, ONE, TWO)
    guards = ("outcomes_no_UPDATE", "starts_no_UPDATE", "arrays_no_UPDATE", "arrays_no_DELETE")
    query(path, *(f"DROP TRIGGER {name}" for name in guards))
    sound = path.read_bytes()
    for record, damage in DAMAGES:
        path.write_bytes(sound)
        query(path, damage)
        said = f"run {record.key} in .* is damaged"
        with Ledger.open(path, model="m", read_only=True) as ledger, pytest.raises(LedgerError, match=said):
            ledger.latest([record.key])


def test_a_run_that_cannot_be_found_any_more_is_noticed(path):
    """SQLite skips rows behind a damaged page, without an error: 64 bytes overwritten at 25 places."""
    keys = [f"run {k}" for k in range(40)]
    with Ledger.open(path, model="m") as ledger:
        put(ledger, *(replace(ONE, key=key) for key in keys))
    sound, rng, refused = path.read_bytes(), np.random.default_rng(3), []
    for _ in range(25):
        spoilt, place = bytearray(sound), int(rng.integers(4096, len(sound) - 64))
        spoilt[place : place + 64] = rng.bytes(64)
        path.write_bytes(spoilt)
        try:
            with Ledger.open(path, model="m") as ledger:
                found = ledger.latest(keys)
        except LedgerError as error:
            refused.append(str(error))
        else:
            assert list(found) == keys
            assert all(exact(found[key])[3] == exact(ONE)[3] for key in keys)
    assert 4 < len(refused) < 25
    assert all("damaged" in said for said in refused)


def test_an_outcome_is_written_with_all_its_arrays_or_not_at_all(path):
    full = "BEFORE INSERT ON arrays WHEN NEW.input = 'nu' BEGIN SELECT RAISE(ABORT, 'full'); END"
    with Ledger.open(path, model="m") as ledger:
        ledger.started(RunRequest("two", {"E": 7.0}))
        ledger._connection.execute(f"CREATE TEMP TRIGGER full {full}")
        with pytest.raises(LedgerError, match="full"):
            ledger.finished(TWO)
        assert ledger._rows("SELECT count(*) FROM arrays") == [(0,)]
        assert ledger.counts() == Counts(open=1)
        ledger._connection.execute("DROP TRIGGER full")
        ledger.finished(TWO)
        assert exact(ledger.latest(["two"])["two"]) == exact(TWO)


def overwrite(path):
    data = bytearray(path.read_bytes())
    data[4096:12288] = b"\xff" * 8192
    path.write_bytes(data)


VERSIONED = "UPDATE meta SET value = '{}' WHERE key = 'schema_version'"


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda path: path.write_bytes(b"this is not a database" * 100), "damaged or not a ledger"),
        (overwrite, "damaged"),
        (lambda path: query(path, VERSIONED.format(ledger_schema.VERSION + 1)), "newer strandline"),
        (lambda path: query(path, VERSIONED.format(3)), r"verification\.upgrade_ledger .*ledger\.sqlite"),
    ],
    ids=["text", "overwritten", "newer", "older"],
)
def test_a_damaged_file_or_one_of_another_version_is_refused(path, spoil, said):
    Ledger.open(path, model="m").close()
    spoil(path)
    for read_only in (False, True):
        with pytest.raises(LedgerError, match=said):
            Ledger.open(path, model="m", read_only=read_only)
    with pytest.raises(LedgerError, match=said):
        Overview(path, model="m").runs()


def test_what_cannot_be_opened_is_refused(path):
    with pytest.raises(LedgerError, match="folder"):
        Ledger.open(path.parent / "nowhere" / "ledger.sqlite", model="m")
    with pytest.raises(LedgerError, match="no such file"):
        Ledger.open(path, model="m", read_only=True)
    assert not list(path.parent.iterdir())


@pytest.fixture
def unwritable():
    """Give the place of a ledger in a folder that this process cannot write, even where the tests run as root."""
    folder, root = Path(tempfile.mkdtemp()), os.geteuid() == 0
    Ledger.open(folder / "ledger.sqlite", model="m").close()
    for file in folder.iterdir():
        file.chmod(0o444)
    folder.chmod(0o555)
    if root:
        os.seteuid(65534)
    yield folder / "ledger.sqlite"
    if root:
        os.seteuid(0)
    folder.chmod(0o755)
    shutil.rmtree(folder)


def test_a_folder_that_cannot_be_written_is_refused_but_can_be_read(unwritable):
    before = sorted(unwritable.parent.iterdir())
    with pytest.raises(LedgerError, match="cannot be written"):
        Ledger.open(unwritable, model="m")
    with Ledger.open(unwritable, model="m", read_only=True) as ledger:
        assert ledger.counts().total == 0
    assert sorted(unwritable.parent.iterdir()) == before


def test_a_reader_sees_what_a_driver_has_written_so_far(path):
    with Ledger.open(path, model="m") as driver, Ledger.open(path, model="m", read_only=True) as reader:
        put(driver, TWO)
        assert exact(reader.latest(["two"])["two"]) == exact(TWO)
        driver.started(RunRequest("next", {"E": 7.0}))
        assert reader.counts() == Counts(ok=1, open=1)
        with driver._transaction():
            put(driver, ONE)
            assert reader.counts() == Counts(ok=1, open=1)
        assert reader.counts() == Counts(ok=2, open=1)


def test_runs_of_another_study_are_copied_with_their_origin(tmp_path):
    first, second, third, other = (tmp_path / f"{name}.sqlite" for name in "abcd")
    keys = [record.key for record in RECORDS] + ["unknown"]
    with Ledger.open(first, model="m") as ledger:
        put(ledger, *RECORDS, replace(ONE, key="excluded"))
        ledger.exclude("excluded", "odd")
    with Ledger.open(second, model="m") as ledger:
        put(ledger, replace(ONE, interfaces={"": fakes.TETRAHEDRON}))
        assert ledger.copy_from(first, [*keys, "excluded"]) == 5
        assert ledger.copy_from(first, keys) == 0
        found = ledger.latest([*keys, "excluded"])
        assert set(found) == {"two", "steep", "line", "surface", "bad", "odd"}
        assert found["line"].interface.dim == 3, "what is here already stays"
        assert found["bad"].origin == str(first)
        for record in (TWO, SURFACE, BAD):
            assert exact(found[record.key])[:-1] == exact(record)[:-1]
    with Ledger.open(third, model="m") as ledger:
        assert ledger.copy_from(second, ["bad"]) == 1
        assert ledger.latest(["bad"])["bad"].origin == str(first)
    with Ledger.open(other, model="other") as ledger, pytest.raises(LedgerError, match="another model"):
        ledger.copy_from(first, ["two"])


def test_a_ledger_without_a_good_run_becomes_that_of_the_corrected_model(path):
    with Ledger.open(path, model="wrong") as ledger:
        put(ledger, BAD, KILLED)
        ledger.started(RunRequest("open", {"E": 3.0}))
        with pytest.raises(LedgerError, match="another model"):
            Overview(path, model="right")
        ledger.finished(replace(failed("open"), state="invalid"))
    Overview(path, model="right").close()
    for model in ("wrong", "right"):
        with Ledger.open(path, model=model) as ledger:
            assert (ledger.model, ledger.counts().failed, ledger.counts().invalid) == (model, 1, 1)
    with Ledger.open(path, model="right") as ledger:
        put(ledger, ONE)
    with pytest.raises(LedgerError, match="another model"):
        Ledger.open(path, model="wrong")


def test_an_excluded_run_is_not_used_and_not_made_again(path):
    model, inputs, executor = Cantilever(), fakes.design(300, 400, 500), fakes.Noted()
    keys = [fakes.key_of(model, entry) for entry in inputs]
    made = fakes.campaign(path, model, inputs, executor)
    with Ledger.open(path, model=model) as ledger:
        ledger.exclude(keys[1], "the mesh\nfolded")
        after = ledger.latest(keys)
        assert states(ledger) == ["ok", "excluded", "ok"]
    assert (after[keys[1]].message, after[keys[1]].interfaces) == ("excluded by hand: the mesh folded", {})
    assert same_outcome(after[keys[0]], made[0])
    with Overview(path) as overview:
        assert [run.exclusion and run.exclusion.why for run in overview.runs()] == [None, "the mesh folded", None]
        assert list(overview.exclusions()) == [keys[1]]
    for policy in (None, FailurePolicy({"invalid": Retry(3)}), FailurePolicy(again=frozenset({"excluded"}))):
        assert states(fakes.campaign(path, model, inputs, executor, policy=policy)) == ["ok", "excluded", "ok"]
    with Ledger.open(path, model=model) as ledger:
        ledger.include(keys[1], "it was right")
        rows = ledger._rows("SELECT key, excluded, why FROM exclusions")
        assert rows == [(keys[1], 1, "the mesh folded"), (keys[1], 0, "it was right")], "every decision stays"
    again = fakes.campaign(path, model, inputs, executor)
    assert all(same_outcome(*pair) for pair in zip(again, made, strict=True))
    assert executor.calls == [[300.0, 400.0, 500.0]]


def test_equal_outcomes_are_told_from_different_ones():
    assert same_outcome(TWO, replace(TWO, seconds=9.0))
    moved = Interface.polyline(np.nextafter(LINE.points, 1.0))
    for change in (
        {"sensitivities": {"slow": {"E": TWO.sensitivities["slow"]["E"]}}},
        {"interfaces": {"slow": LINE}},
        {"interfaces": {**TWO.interfaces, "slow": moved}},
        {"diagnostics": {"steps": 1.0}},
        {"state": "failed"},
    ):
        assert not same_outcome(TWO, replace(TWO, **change))


def test_a_failure_while_creating_leaves_no_ledger(path, monkeypatch):
    def full(connection, path):
        raise sqlite3.OperationalError("disk full")

    with monkeypatch.context() as patch:
        patch.setattr(ledger_schema.journal, "settle", full)
        with pytest.raises(LedgerError, match="disk full"):
            Ledger.open(path, model="m")
    assert not [file for file in path.parent.iterdir() if file.suffix != ".lock"]
    Ledger.open(path, model="m").close()


def test_a_reader_cannot_write(path):
    Ledger.open(path, model="m").close()
    with Ledger.open(path, model=None, read_only=True) as ledger:
        for write, *arguments in (
            (ledger.started, RunRequest("a", {})),
            (ledger.finished, failed("a")),
            (ledger.copy_from, path, ["a"]),
            (ledger.exclude, "a", "odd"),
            (ledger.plan, PLAN),
        ):
            with pytest.raises(LedgerError, match="read_only"):
                write(*arguments)
