"""Ledgers of versions before 0.2: if one of these tests fails, studies of users cannot be opened any more."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest
from tests.unit.runs.fakes import TWO, campaign, exact, put, query, states, stored
from verification.upgrade_ledger import upgrade

from strandline.foundations import LedgerError
from strandline.models.identity import fingerprint
from strandline.runs import Counts, Ledger, run_key
from strandline.runs.ledger.ledger_schema import copied
from strandline.runs.ledger.overview import STATES, Overview
from strandline.runs.ledger.plans import read_plan
from strandline.testing.models import Cantilever, TwoLoads

BEAM = Cantilever(nodes=9)
V1, V2, STUDY_2, STUDY_3 = "ledger-v1.sqlite", "ledger-v2.sqlite", "ledger-v2-study.sqlite", "ledger-v3-study.sqlite"
NAMES = [V1, V2, STUDY_2, STUDY_3]


def upgraded(name, folder):
    path = stored(name, folder)
    upgrade(path)
    return path


def content(path):
    """Return the tables, and all rows of those of the earlier versions but for the sessions."""
    names = {name for (name,) in query(path, "SELECT name FROM sqlite_schema WHERE type = 'table'")}
    return names, [query(path, f"SELECT * FROM {name}") for name in ("starts", "outcomes", "arrays") if name in names]


def version_of(path):
    return query(path, "SELECT value FROM meta WHERE key = 'schema_version'")[0][0]


def definitions(path):
    return sorted(query(path, "SELECT name, sql FROM sqlite_schema"))


@pytest.mark.parametrize("name", NAMES)
def test_an_old_ledger_is_refused_until_it_is_upgraded_which_touches_no_run(tmp_path, name):
    path, version = stored(name, tmp_path), name[len("ledger-v")]
    before, (names, rows) = path.read_bytes(), content(path)
    for read_only in (False, True):
        with pytest.raises(LedgerError, match="upgrade_ledger"):
            Ledger.open(path, model="m", read_only=read_only)
    assert path.read_bytes() == before
    for number in ("", "-1"):
        path.write_bytes(before)
        backup = upgrade(path)
        assert backup == tmp_path / f"ledger.sqlite.v{version}-backup{number}"
        assert (content(backup), version_of(backup)) == ((names, rows), version)
    with Ledger.open(path, model=None, read_only=True) as reader, Overview(path) as overview:
        model, runs = reader.model, [exact(record) for record in reader]
        assert overview.model == model
        counted = [sum(run.last.state == state for run in overview.runs()) for state in STATES]
        assert counted == [getattr(reader.counts(), state) for state in STATES]
        assert (reader.exclusions(), overview.plan("any")) == ({}, None)
        with Ledger.open(tmp_path / "fresh.sqlite", model=model) as fresh:
            assert fresh.copy_from(path, [run[0] for run in runs]) == sum(run[2] in ("ok", "failed") for run in runs)
    with pytest.raises(LedgerError, match="another model"):
        Ledger.open(path, model="another")
    assert content(path)[1] == (rows if "arrays" in names else [*rows, []])
    assert definitions(path) == definitions(tmp_path / "fresh.sqlite")
    with Ledger.open(path, model=model) as ledger:
        put(ledger, TWO)
        assert exact(ledger.latest(["two"])["two"]) == exact(TWO)


def test_the_runs_of_version_1_are_right_and_go_on(tmp_path):
    path = upgraded(V1, tmp_path)
    with Ledger.open(path, model=BEAM) as ledger:
        assert ledger.counts() == Counts(ok=2, failed=1, killed=1, open=1)
        assert ledger.description == "a beam, written by format version 1"
        good = [record for record in ledger if record.ok]
        assert [list(record.interfaces) for record in good] == [[""], [""]]
        for record in good:
            direct = BEAM(record.inputs, tmp_path).interface.points
            np.testing.assert_allclose(record.interface.points, direct, rtol=0, atol=1e-15)
    inputs = [{"E": value, "load": 1e-5} for value in (400.0, 300.0, -1.0, 500.0, 600.0)]
    assert states(campaign(path, BEAM, inputs)) == ["ok", "ok", "failed", "ok", "ok"]


def test_the_runs_of_version_2_are_right(tmp_path):
    """Two conditions with sensitivities."""
    model = TwoLoads(Cantilever(nodes=5), sensitivities=True)
    with Ledger.open(upgraded(V2, tmp_path), model=model) as ledger:
        assert ledger.counts() == Counts(ok=2, failed=1)
        for record in ledger:
            direct = model(record.inputs, tmp_path) if record.ok else None
            assert list(record.interfaces) == (["light", "heavy"] if record.ok else [])
            for name, interface in record.interfaces.items():
                np.testing.assert_allclose(interface.points, direct.interfaces[name].points, rtol=0, atol=1e-15)
        key = run_key(fingerprint(model), {"E": 500.0, "load": 1e-5})
        steep = ledger.latest([key])[key]
        for name in model.conditions:
            slope = model(steep.inputs, tmp_path).sensitivities[name]["load"]
            np.testing.assert_allclose(steep.sensitivities[name]["load"], slope, rtol=1e-12)


def test_the_ledger_of_a_study_is_right_and_so_is_its_plan(tmp_path):
    """Four runs ok, four failed, one more at the inputs of the synthetic observation."""
    path = upgraded(STUDY_3, tmp_path)
    with Ledger.open(path, model="test:beam-1") as ledger:
        assert ledger.counts() == Counts(ok=5, failed=4)
        for record in ledger:
            tip = 4 * record.inputs["load"] * 1e6 / record.inputs["E"] + record.inputs["tilt"]  # F L³ / (3 E I)
            assert record.diagnostics["tip"] == pytest.approx(tip)
            assert record.ok == (tip <= 1)
            assert record.failure_kind == (None if record.ok else "large_deflection")
    keys = [key for (key,) in query(path, "SELECT key FROM starts ORDER BY attempt")]
    with closing(sqlite3.connect(path)) as connection:
        plan = read_plan(connection, *query(path, "SELECT study_sha256 FROM plans")[0])
    assert (plan.name, plan.model, plan.inputs) == ("old", "test:beam-1", ("E", "tilt"))
    assert (plan.sensitivities, plan.planned, plan.keys) == (False, 8, keys[1:])


def test_a_copy_overwrites_nothing(tmp_path):
    target = tmp_path / "kept"
    target.write_text("mine")
    with closing(sqlite3.connect(stored(V1, tmp_path))) as connection, pytest.raises(FileExistsError):
        copied(connection, target)
    assert target.read_text() == "mine"
    assert not [path for path in tmp_path.iterdir() if path.suffix == ".partial"]
