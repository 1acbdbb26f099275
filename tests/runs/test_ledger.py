"""The ledger: what goes in comes out, nothing is lost, and every misuse is one clear error."""

import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strandline.errors import LedgerError
from strandline.interface import Interface
from strandline.models.protocol import fingerprint
from strandline.runs import Counts, InProcess, Ledger, RunRecord, RunRequest, run_campaign, run_key, tables
from strandline.runs.plans import Plan, read_plan
from strandline.testing.executors import requests_for, same_outcome
from strandline.testing.models import Cantilever, TwoLoads

DATA = Path(__file__).parents[1] / "data"
LINE = Interface.polyline(np.random.default_rng(1).normal(size=(66, 2)))
TETRAHEDRON = Interface(np.eye(4, 3), np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


def put(ledger, record):
    ledger.started(RunRequest(record.key, record.inputs))
    ledger.finished(record)


SLOPES = {"slow": {"E": np.random.default_rng(2).normal(size=(66, 2)), "nu": np.full((66, 2), -1e-300)}}


def records():
    return [
        RunRecord("two", {"E": 7.0}, "ok", {"slow": LINE, "a b": TETRAHEDRON}, sensitivities=SLOPES),
        RunRecord("steep", {"E": 8.0}, "ok", {"": LINE}, sensitivities={"": SLOPES["slow"]}),
        RunRecord("line", {"E": 0.1, "nu": -1e-300}, "ok", {"": LINE}, {"iterations": 7.0, "J": float("nan")}, 0.25),
        RunRecord("surface", {"E": 1 / 3}, "ok", {"": TETRAHEDRON}),
        RunRecord("bad", {"E": 2.0}, "failed", {}, {"load": 0.5}, 1.0, "limit_point", "no équilibre", "a\nlog"),
        RunRecord("slow", {"E": 3.0}, "timeout", failure_kind="timeout", message="still running"),
        RunRecord("gone", {"E": 4.0}, "killed", failure_kind="worker_died", message="SIGKILL"),
        RunRecord("odd", {"E": 5.0}, "invalid", failure_kind="non_finite", message="NaN"),
    ]


def exact(record):
    """Return all that a record says, comparable to the last bit."""
    arrays = [(c, i.points.tobytes(), i.points.shape, i.cells.tolist()) for c, i in record.interfaces.items()]
    arrays += [
        (c, n, a.tobytes(), a.shape) for c, by_input in record.sensitivities.items() for n, a in by_input.items()
    ]
    figures = {name: float(value).hex() for name, value in record.diagnostics.items()}
    rest = (record.seconds, record.failure_kind, record.message, record.log, record.origin)
    return record.key, dict(record.inputs), record.state, arrays, figures, *rest


def test_everything_comes_back_bit_for_bit(path):
    with Ledger.open(path, model="m", description="a beam") as ledger:
        for record in records():
            put(ledger, record)
    with Ledger.open(path, model="m") as ledger:
        assert [exact(r) for r in ledger] == [exact(r) for r in records()]
        found = ledger.latest([r.key for r in records()] + ["unknown"])
        assert {k: exact(r) for k, r in found.items()} == {r.key: exact(r) for r in records()}
        assert (ledger.model, ledger.description) == ("m", "a beam")
        restored = found["line"].interface.points
        assert restored.dtype == np.float64
        assert restored.flags.writeable


def test_more_keys_than_one_query_takes(path):
    model = Cantilever()
    requests = requests_for(model, np.linspace(300.0, 500.0, 1201).tolist())
    with Ledger.open(path, model="m") as ledger, ledger._transaction():
        for request in requests:
            put(ledger, RunRecord(request.key, request.inputs, "failed"))
        assert set(ledger.latest(request.key for request in requests)) == {request.key for request in requests}


def test_started_without_an_outcome_is_open(path):
    with Ledger.open(path, model="m") as ledger:
        for record in records():
            put(ledger, record)
        ledger.started(RunRequest("lost", {"E": 9.0}))
        assert ledger.counts() == Counts(ok=4, failed=1, timeout=1, killed=1, invalid=1, open=1)
        assert ledger.counts().total == 9
        assert "lost" not in ledger.latest(["lost"])


def test_last_outcome_counts_and_attempts_are_counted(path):
    with Ledger.open(path, model="m") as ledger:
        put(ledger, RunRecord("a", {}, "killed", failure_kind="worker_died"))
        put(ledger, RunRecord("a", {}, "killed", failure_kind="interrupted"))
        ledger.started(RunRequest("a", {}))
        assert ledger.attempts("a") == 2
        put(ledger, RunRecord("a", {}, "ok", {"": LINE}))
        assert ledger.attempts("a") == 3
        assert ledger.attempts("never") == 0
        assert ledger.latest(["a"])["a"].ok
        assert ledger.counts() == Counts(ok=1)
        assert [record.state for record in ledger] == ["ok"]


def test_outcome_without_a_start_is_refused(path):
    with Ledger.open(path, model="m") as ledger:
        put(ledger, records()[2])
        for record in records()[2:4]:
            with pytest.raises(LedgerError, match="started and has no outcome"):
                ledger.finished(record)


def test_each_write_is_synchronised(path):
    with Ledger.open(path, model="m") as ledger:
        assert ledger._connection.execute("PRAGMA synchronous").fetchone() == (2,)
        assert ledger._connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)


@pytest.mark.parametrize(
    "verb",
    [
        "UPDATE outcomes SET state = 'ok'",
        "DELETE FROM starts",
        "DELETE FROM outcomes",
        "DELETE FROM arrays",
        "UPDATE plans SET planned = 0",
        "DELETE FROM plans",
    ],
)
def test_nothing_is_ever_changed(path, verb):
    with Ledger.open(path, model="m") as ledger:
        put(ledger, records()[0])
        ledger.plan(Plan("digest", "beam", "m", ("E",), False, 1, (("two",),)))
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            ledger._connection.execute(verb)


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE outcomes SET points = zeroblob(length(points))",
        "UPDATE outcomes SET points_shape = '[132, 1]'",
        "UPDATE outcomes SET state = 'failed'",
        "UPDATE outcomes SET diagnostics = '{\"iterations\": 8.0}'",
        "UPDATE outcomes SET seconds = 0.5",
        "UPDATE starts SET inputs = '{\"E\": 0.2}'",
    ],
)
def test_damage_to_a_run_is_noticed_and_the_run_named(path, damage):
    with Ledger.open(path, model="m") as ledger:
        put(ledger, records()[2])
    tamper(path, "DROP TRIGGER outcomes_no_UPDATE", "DROP TRIGGER starts_no_UPDATE", damage)
    with Ledger.open(path, model="m") as ledger, pytest.raises(LedgerError, match=r"run line in .* is damaged"):
        ledger.latest(["line"])


def test_a_run_that_cannot_be_found_any_more_is_noticed(path):
    """SQLite skips rows behind a damaged page, without an error: 64 bytes overwritten at 60 places."""
    keys = [f"run {k}" for k in range(40)]
    with Ledger.open(path, model="m") as ledger:
        for key in keys:
            put(ledger, replace(records()[2], key=key))
    sound, rng, refused = path.read_bytes(), np.random.default_rng(3), []
    for _ in range(60):
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
            assert all(exact(found[key])[3] == exact(records()[2])[3] for key in keys)
    assert 10 < len(refused) < 60
    assert all("damaged" in said for said in refused)


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE arrays SET data = zeroblob(length(data)) WHERE role = 'sensitivity'",
        "UPDATE arrays SET shape = '[132, 1]' WHERE role = 'points' AND condition = 'slow'",
        "UPDATE arrays SET condition = 'fast' WHERE condition = 'slow'",
        "UPDATE arrays SET input = 'E2' WHERE input = 'E'",
        "DELETE FROM arrays WHERE role = 'sensitivity' AND input = 'nu'",
        "DELETE FROM arrays",
        "INSERT INTO arrays SELECT attempt, role, condition, 'extra', shape, data FROM arrays WHERE input = 'nu'",
    ],
)
def test_damage_to_the_arrays_of_a_run_is_noticed(path, damage):
    with Ledger.open(path, model="m") as ledger:
        put(ledger, records()[0])
        assert exact(ledger.latest(["two"])["two"]) == exact(records()[0])
    tamper(path, "DROP TRIGGER arrays_no_UPDATE", "DROP TRIGGER arrays_no_DELETE", damage)
    with Ledger.open(path, model="m") as ledger, pytest.raises(LedgerError, match=r"run two in .* is damaged"):
        ledger.latest(["two"])


def test_an_outcome_is_written_with_all_its_arrays_or_not_at_all(path):
    with Ledger.open(path, model="m") as ledger:
        ledger.started(RunRequest("two", {"E": 7.0}))
        ledger._connection.execute(
            "CREATE TEMP TRIGGER full BEFORE INSERT ON arrays WHEN NEW.input = 'nu' "
            "BEGIN SELECT RAISE(ABORT, 'full'); END"
        )
        with pytest.raises(LedgerError, match="full"):
            ledger.finished(records()[0])
        assert ledger._rows("SELECT count(*) FROM arrays") == [(0,)]
        assert ledger.counts() == Counts(open=1)
        ledger._connection.execute("DROP TRIGGER full")
        ledger.finished(records()[0])
        assert exact(ledger.latest(["two"])["two"]) == exact(records()[0])


def test_attempts_since_the_last_end_for_good(path):
    with Ledger.open(path, model="m") as ledger:
        for state in ("killed", "killed", "ok", "killed"):
            put(ledger, RunRecord("a", {}, state, {"": LINE} if state == "ok" else {}))
        ledger.started(RunRequest("a", {}))
        put(ledger, RunRecord("b", {}, "killed"))
        assert (ledger.attempts("a"), ledger.open_attempts("a")) == (5, 2)
        assert (ledger.open_attempts("b"), ledger.open_attempts("never")) == (1, 0)


def tamper(path, *statements):
    connection = sqlite3.connect(path, isolation_level=None)
    for statement in statements:
        connection.execute(statement)
    connection.close()


def test_ledger_of_another_model_is_refused_with_both_names(path):
    Ledger.open(path, model="beam-1").close()
    for read_only in (False, True):
        with pytest.raises(LedgerError, match=r"beam-1 in the ledger, beam-2 now.*new study folder"):
            Ledger.open(path, model="beam-2", read_only=read_only)
    Ledger.open(path, model="beam-1").close()  # the refusal left no lock behind


def test_newer_version_is_refused(path):
    Ledger.open(path, model="m").close()
    tamper(path, f"UPDATE meta SET value = '{tables.VERSION + 1}' WHERE key = 'schema_version'")
    with pytest.raises(LedgerError, match="newer strandline"):
        Ledger.open(path, model="m")


def damaged_in_the_middle(path):
    Ledger.open(path, model="m").close()
    data = bytearray(path.read_bytes())
    data[4096:12288] = b"\xff" * 8192
    path.write_bytes(data)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(b"this is not a database" * 100),
        lambda path: path.write_bytes(b""),
        damaged_in_the_middle,
        lambda path: tamper(path, "CREATE TABLE other (x)"),
    ],
    ids=["text", "empty", "overwritten", "foreign"],
)
@pytest.mark.parametrize("read_only", [False, True])
def test_damaged_or_foreign_file_is_refused(path, spoil, read_only):
    spoil(path)
    with pytest.raises(LedgerError):
        Ledger.open(path, model="m", read_only=read_only)


def test_missing_folder_is_refused(tmp_path):
    with pytest.raises(LedgerError, match="folder"):
        Ledger.open(tmp_path / "nowhere" / "ledger.sqlite", model="m")


@contextmanager
def folder_without_the_right_to_write():
    """Give a folder that this process cannot write, even where the tests run as root."""
    folder = Path(tempfile.mkdtemp())
    try:
        Ledger.open(folder / "ledger.sqlite", model="m").close()
        for file in folder.iterdir():
            file.chmod(0o444)
        folder.chmod(0o555)
        if os.geteuid() == 0:
            os.seteuid(65534)
        yield folder
    finally:
        if os.getuid() == 0:
            os.seteuid(0)
        folder.chmod(0o755)
        shutil.rmtree(folder)


def test_folder_that_cannot_be_written_is_refused_but_can_be_read():
    with folder_without_the_right_to_write() as folder:
        before = sorted(folder.iterdir())
        with pytest.raises(LedgerError, match="cannot be written"):
            Ledger.open(folder / "other.sqlite", model="m")
        with pytest.raises(LedgerError):
            Ledger.open(folder / "ledger.sqlite", model="m")
        with Ledger.open(folder / "ledger.sqlite", model="m", read_only=True) as ledger:
            assert ledger.counts().total == 0
        assert sorted(folder.iterdir()) == before


def test_failure_while_creating_leaves_no_ledger(path, monkeypatch):
    monkeypatch.setattr("strandline.runs.tables.TABLES", "CREATE TABLE broken (")
    with pytest.raises(LedgerError):
        Ledger.open(path, model="m")
    assert not [file for file in path.parent.iterdir() if file.suffix != ".lock"]
    monkeypatch.undo()
    Ledger.open(path, model="m").close()


def test_reading_creates_nothing(path):
    with pytest.raises(LedgerError, match="no such file"):
        Ledger.open(path, model="m", read_only=True)
    assert not list(path.parent.iterdir())


def test_reading_cannot_write(path):
    Ledger.open(path, model="m").close()
    with Ledger.open(path, model=None, read_only=True) as ledger:
        with pytest.raises(LedgerError, match="read_only"):
            ledger.started(RunRequest("a", {}))
        with pytest.raises(LedgerError, match="read_only"):
            ledger.copy_from(path, ["a"])


def test_model_is_needed_for_writing(path):
    with pytest.raises(LedgerError, match="fingerprint"):
        Ledger.open(path, model=None)


def test_reader_sees_what_a_driver_has_written_so_far(path):
    with Ledger.open(path, model="m") as driver:
        put(driver, records()[0])
        with Ledger.open(path, model="m", read_only=True) as reader:
            assert reader.counts() == Counts(ok=1)
            assert exact(reader.latest(["two"])["two"]) == exact(records()[0])
            driver.started(RunRequest("next", {"E": 7.0}))
            assert reader.counts() == Counts(ok=1, open=1)
            with driver._transaction():
                put(driver, records()[1])
                assert reader.counts() == Counts(ok=1, open=1)
            assert reader.counts() == Counts(ok=2, open=1)


HOLDER = """
import sys
from strandline.runs import Ledger
with Ledger.open(sys.argv[1], model="m"):
    print("open", flush=True)
    sys.stdin.read()
"""


def test_second_driver_is_refused_and_told_who_the_first_is(path):
    command = [sys.executable, "-c", HOLDER, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "open\n"
        with pytest.raises(LedgerError, match=f"locked.*another run is using it.*process {holder.pid} "):
            Ledger.open(path, model="m")
        with Ledger.open(path, model="m", read_only=True) as reader:
            assert reader.counts().total == 0
        holder.communicate()
    Ledger.open(path, model="m").close()


def test_runs_of_another_study_are_copied_with_their_origin(tmp_path):
    first, second, third = (tmp_path / name for name in ("a.sqlite", "b.sqlite", "c.sqlite"))
    with Ledger.open(first, model="m") as ledger:
        for record in records():
            put(ledger, record)
    keys = [record.key for record in records()] + ["unknown"]
    with Ledger.open(second, model="m") as ledger:
        put(ledger, RunRecord("line", {"E": 0.1, "nu": -1e-300}, "ok", {"": TETRAHEDRON}))
        assert ledger.copy_from(first, keys) == 5
        assert ledger.copy_from(first, keys) == 0
        found = ledger.latest(keys)
        assert set(found) == {"two", "steep", "line", "surface", "bad", "odd"}
        assert exact(found["two"])[:-1] == exact(records()[0])[:-1]
        assert found["line"].interface.dim == 3  # what is here already stays
        assert found["bad"].origin == str(first)
        assert exact(found["surface"])[:-1] == exact(records()[3])[:-1]
    with Ledger.open(third, model="m") as ledger:
        assert ledger.copy_from(second, ["bad"]) == 1
        assert ledger.latest(["bad"])["bad"].origin == str(first)


def test_nothing_is_copied_from_another_model(tmp_path):
    Ledger.open(tmp_path / "a.sqlite", model="other").close()
    with Ledger.open(tmp_path / "b.sqlite", model="m") as ledger, pytest.raises(LedgerError, match="another model"):
        ledger.copy_from(tmp_path / "a.sqlite", ["x"])


def test_ledger_of_version_1_still_opens(tmp_path):
    """Written by the first released format; if this fails, old studies of users cannot be opened any more."""
    path = Path(shutil.copy(DATA / "ledger-v1.sqlite", tmp_path / "ledger.sqlite"))
    path.chmod(0o644)
    model = Cantilever(nodes=9)
    with Ledger.open(path, model=model.fingerprint) as ledger:
        assert ledger.counts() == Counts(ok=2, failed=1, killed=1, open=1)
        assert ledger.description == "a beam, written by format version 1"
        for record in ledger:
            if record.ok:
                direct = model(record.inputs, tmp_path)
                np.testing.assert_allclose(record.interface.points, direct.interface.points, rtol=0, atol=1e-15)
        inputs = [{"E": value, "load": 1e-5} for value in (400.0, 300.0, -1.0, 500.0, 600.0)]
        done = run_campaign(model, inputs, ledger=ledger, executor=InProcess())
        assert [record.state for record in done] == ["ok", "ok", "failed", "ok", "ok"]
        assert ledger.counts() == Counts(ok=4, failed=1)


def old_ledger(folder):
    path = Path(shutil.copy(DATA / "ledger-v1.sqlite", folder / "ledger.sqlite"))
    path.chmod(0o644)
    return path


def content(path):
    """Return version, tables, and all rows of the tables of version 1 but for the sessions."""
    with closing(sqlite3.connect(path)) as connection:
        (version,) = connection.execute("SELECT value FROM meta WHERE key = 'schema_version'").fetchone()
        names = {row[0] for row in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
        rows = [connection.execute(f"SELECT * FROM {table}").fetchall() for table in ("starts", "outcomes")]
    return version, names, rows


def test_reading_version_1_gives_an_unnamed_condition_and_changes_nothing(tmp_path):
    path = old_ledger(tmp_path)
    before = path.read_bytes()
    with Ledger.open(path, model=None, read_only=True) as ledger:
        good = [record for record in ledger if record.ok]
        assert [list(record.interfaces) for record in good] == [[""], [""]]
        assert all(record.sensitivities == {} for record in good)
        with Ledger.open(tmp_path / "new.sqlite", model=ledger.model) as new:
            assert new.copy_from(path, [record.key for record in ledger]) == 3
    assert path.read_bytes() == before


def test_a_driver_upgrades_version_1_and_touches_no_row(tmp_path):
    path = old_ledger(tmp_path)
    version, names, rows = content(path)
    assert (version, {"arrays", "plans"} & names) == ("1", set())
    model = Cantilever(nodes=9).fingerprint
    with pytest.raises(LedgerError, match="another model"):
        Ledger.open(path, model="m")
    assert content(path)[0] == "1"
    Ledger.open(path, model=model).close()
    assert content(path) == (str(tables.VERSION), names | {"arrays", "plans", "exclusions"}, rows)
    with Ledger.open(path, model=model) as ledger:
        put(ledger, records()[0])
        assert exact(ledger.latest(["two"])["two"]) == exact(records()[0])
    fresh = tmp_path / "fresh.sqlite"
    Ledger.open(fresh, model=model).close()
    assert definitions(path) == definitions(fresh)


def definitions(path):
    with closing(sqlite3.connect(path)) as connection:
        return sorted(connection.execute("SELECT name, sql FROM sqlite_schema").fetchall())


def test_an_upgrade_that_fails_leaves_version_1(tmp_path, monkeypatch):
    path = old_ledger(tmp_path)
    before = content(path)
    monkeypatch.setitem(tables.ADDED, "plans", tables.ADDED["plans"] + "CREATE TABLE broken (")
    with pytest.raises(LedgerError):
        Ledger.open(path, model=Cantilever(nodes=9).fingerprint)
    assert content(path) == before
    monkeypatch.undo()
    Ledger.open(path, model=Cantilever(nodes=9).fingerprint).close()
    assert content(path)[0] == str(tables.VERSION)


def test_a_reader_of_version_1_sees_what_an_upgrading_driver_writes(tmp_path):
    path = old_ledger(tmp_path)
    model = Cantilever(nodes=9).fingerprint
    with closing(tables.connect(path)), Ledger.open(path, model=None, read_only=True) as reader:
        assert len(list(reader)) == 4
        with Ledger.open(path, model=model) as driver:
            put(driver, records()[0])
            assert exact(reader.latest(["two"])["two"]) == exact(records()[0])


def test_ledger_of_version_2_still_opens(tmp_path):
    """Two conditions with sensitivities; if this fails, studies of users cannot be opened any more."""
    path = Path(shutil.copy(DATA / "ledger-v2.sqlite", tmp_path / "ledger.sqlite"))
    path.chmod(0o644)
    model = TwoLoads(Cantilever(nodes=5), sensitivities=True)
    with Ledger.open(path, model=model) as ledger:
        assert ledger.counts() == Counts(ok=2, failed=1)
        for record in ledger:
            if record.ok:
                direct = model(record.inputs, tmp_path)
                assert list(record.interfaces) == ["light", "heavy"]
                for name, interface in record.interfaces.items():
                    np.testing.assert_allclose(interface.points, direct.interfaces[name].points, rtol=0, atol=1e-15)
        steep = ledger.latest([run_key(fingerprint(model), {"E": 500.0, "load": 1e-5})]).popitem()[1]
        for name in model.conditions:
            slope = model(steep.inputs, tmp_path).sensitivities[name]["load"]
            np.testing.assert_allclose(steep.sensitivities[name]["load"], slope, rtol=1e-12)


def stored(name, folder):
    path = Path(shutil.copy(DATA / name, folder / "ledger.sqlite"))
    path.chmod(0o644)
    return path


def array_rows(path):
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute("SELECT * FROM arrays").fetchall()


@pytest.mark.parametrize("name", ["ledger-v2.sqlite", "ledger-v2-study.sqlite"])
def test_a_driver_upgrades_version_2_and_touches_no_row(tmp_path, name):
    path = stored(name, tmp_path)
    with closing(sqlite3.connect(path)) as connection:
        (model,) = connection.execute("SELECT value FROM meta WHERE key = 'model'").fetchone()
    (version, names, rows), arrays = content(path), array_rows(path)
    assert (version, "plans" in names) == ("2", False)
    Ledger.open(path, model=model).close()
    assert content(path) == (str(tables.VERSION), names | {"plans", "exclusions"}, rows)
    assert array_rows(path) == arrays
    fresh = tmp_path / "fresh.sqlite"
    Ledger.open(fresh, model=model).close()
    assert definitions(path) == definitions(fresh)


def test_an_upgrade_that_fails_leaves_version_2(tmp_path, monkeypatch):
    path = stored("ledger-v2-study.sqlite", tmp_path)
    before = content(path)
    monkeypatch.setitem(tables.ADDED, "plans", tables.ADDED["plans"] + "CREATE TABLE broken (")
    with pytest.raises(LedgerError):
        Ledger.open(path, model="test:beam-1")
    assert content(path) == before


@pytest.mark.parametrize("version", [2, 3])
def test_the_ledger_of_a_study_still_opens(tmp_path, version):
    """Four runs ok, four failed, one more at the inputs of the synthetic observation."""
    path = stored(f"ledger-v{version}-study.sqlite", tmp_path)
    with Ledger.open(path, model="test:beam-1") as ledger:
        assert ledger.counts() == Counts(ok=5, failed=4)
        for record in ledger:
            tip = 4 * record.inputs["load"] * 1e6 / record.inputs["E"] + record.inputs["tilt"]  # F L³ / (3 E I)
            assert record.diagnostics["tip"] == pytest.approx(tip)
            assert record.ok == (tip <= 1)
            assert record.failure_kind == (None if record.ok else "large_deflection")


def test_the_plan_of_version_3_is_read(tmp_path):
    with closing(sqlite3.connect(stored("ledger-v3-study.sqlite", tmp_path))) as connection:
        ((digest,),) = connection.execute("SELECT study_sha256 FROM plans").fetchall()
        keys = [row[0] for row in connection.execute("SELECT key FROM starts ORDER BY attempt")]
        plan = read_plan(connection, digest)
    assert (plan.name, plan.model, plan.inputs) == ("old", "test:beam-1", ("E", "tilt"))
    assert (plan.sensitivities, plan.planned, plan.keys) == (False, 8, keys[1:])


def test_equal_outcomes_are_told_from_different_ones():
    one, other = records()[2], records()[2]
    two, less = records()[0], {"slow": {"E": SLOPES["slow"]["E"]}}
    assert same_outcome(two, records()[0])
    assert not same_outcome(two, replace(two, sensitivities=less))
    assert not same_outcome(two, replace(two, interfaces={"slow": LINE}))
    assert same_outcome(
        RunRecord(one.key, one.inputs, "ok", {"": LINE}), RunRecord(one.key, one.inputs, "ok", {"": LINE})
    )
    moved = Interface.polyline(np.nextafter(LINE.points, 1.0))
    assert not same_outcome(one, RunRecord(other.key, other.inputs, "ok", {"": moved}, other.diagnostics))
