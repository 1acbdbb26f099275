"""A ledger looked at without its interfaces: the same as the records say, what a study plans, and who is at work."""

import os
import socket
from dataclasses import replace

import numpy as np
import pytest
from tests.unit.runs.fakes import BAD, LINE, SLOPES, put, query

from strandline.foundations import LedgerError
from strandline.runs import Ledger, RunRecord, RunRequest
from strandline.runs.ledger import ledger_schema
from strandline.runs.ledger.overview import OPEN, STATES, Overview, is_at_work
from strandline.runs.ledger.plans import Plan
from strandline.runs.ledger.record import ENDS
from strandline.studies.load.study import settled

KEYS = [f"k{number}" for number in range(40)]


def some_end(key, rng):
    state, interrupted = str(rng.choice(ENDS)), rng.random() < 0.3
    kind = None if state == "ok" else "interrupted" if state == "killed" and interrupted else f"because_{state}"
    slopes = {"": SLOPES["slow"]} if state == "ok" and rng.random() < 0.5 else {}
    good = {"": LINE} if state == "ok" else {}
    return RunRecord(key, {"E": 1.0}, state, good, seconds=float(rng.random()), failure_kind=kind, sensitivities=slopes)


def test_settled_runs_are_those_of_the_records(path):
    """Of runs started at random, most of which ended, several times some."""
    rng = np.random.default_rng(1)
    with Ledger.open(path, model="m") as ledger:
        with ledger._transaction():
            for key in rng.choice(KEYS, 150).tolist():
                ledger.started(RunRequest(key, {"E": 1.0}))
                if rng.random() < 0.8:
                    ledger.finished(some_end(key, rng))
        with Overview(path) as overview:
            runs = overview.runs()
        for sensitivities in (False, True):
            expected = {record.key: record for record in settled(ledger, KEYS, sensitivities=sensitivities)}
            found = {run.key: run.outcome for run in runs if run.settled(sensitivities=sensitivities)}
            assert set(found) == set(expected)
            assert 0 < len(found) < len(runs)
            for key, record in expected.items():
                end = found[key]
                assert (end.state, end.kind, end.seconds) == (record.state, record.failure_kind, record.seconds)
                assert end.sensitivities == bool(record.sensitivities)
        for state in STATES:
            assert sum(run.last.state == state for run in runs) == getattr(ledger.counts(), state)
    assert [run.last.number for run in runs] == sorted(run.last.number for run in runs)
    assert (*ENDS, OPEN) == STATES


def test_details_are_those_of_the_record_and_changes_are_told(path):
    with Ledger.open(path, model="m") as ledger:
        put(ledger, BAD)
        number = ledger.started(RunRequest("open", {"E": 3.0}))
        with Overview(path, model="m") as overview:
            assert [(run.key, run.inputs) for run in overview.runs()] == [("bad", {"E": 2.0}), ("open", {"E": 3.0})]
            details = overview.details([number - 1, number])
            assert overview.changes(number, []) == []
            ledger.finished(RunRecord("open", {"E": 3.0}, "timeout"))
            ledger.started(RunRequest("next", {"E": 4.0}))
            changes = [(key, attempt.state) for key, attempt in overview.changes(number, [number])]
            assert changes == [("open", "timeout"), ("next", "open")]
    (told,) = details.values()
    assert (told.message, told.log, told.diagnostics) == (BAD.message, BAD.log, BAD.diagnostics)
    with pytest.raises(LedgerError, match="another model"):
        Overview(path, model="other")


def test_whether_a_driver_is_at_work_is_told_or_said_to_be_unknown(path):
    me, here = os.getpid(), socket.gethostname()
    assert is_at_work(me, f"not-{here}", path) is None
    assert is_at_work(me, here, path) is False, "no lock was ever made"
    with path.open("w"):
        assert is_at_work(me, here, path) is True
    assert is_at_work(me, here, path) is False
    path.unlink()
    ledger_schema.create(path, model="m", description="")
    with Overview(path, model="m") as overview:
        assert (overview.driver(), overview.runs()) == (None, [])
    with Ledger.open(path, model="m") as ledger, Overview(path) as overview:
        driver = overview.driver()
        assert (driver.pid, driver.host, driver.at_work) == (me, here, True)
        ledger.close()
        assert overview.driver().at_work is False


DESIGN = ("a" * 64, "b" * 64, "c" * 64)
PLAN = Plan("digest", "béam", "m", ("tilt", "E"), False, 7, (DESIGN,))
FIRST = replace(PLAN, parts=(DESIGN, ("d", "e")))
BOTH = replace(PLAN, planned=6, parts=(DESIGN, ("d", "e"), ("f",)))
STEEP = replace(BOTH, sensitivities=True)
OTHER_ROUND = replace(PLAN, parts=(DESIGN, ("d", "x")))
COURSES = [
    ([STEEP], STEEP, 3),
    ([PLAN, FIRST, BOTH], BOTH, 3),
    ([BOTH, PLAN, FIRST], BOTH, 3),
    ([BOTH, OTHER_ROUND], OTHER_ROUND, 4),
    ([BOTH, OTHER_ROUND, BOTH], BOTH, 6),
    ([BOTH, replace(BOTH, planned=5)], replace(BOTH, planned=5), 4),
]


def test_the_last_plan_counts_and_only_what_is_new_is_noted(path):
    """Rounds are added; those that are known stay while they are gone through again; another takes their place."""
    with Ledger.open(path, model="m") as ledger, Overview(path) as overview:
        for number, (plans, last, rows) in enumerate(COURSES):
            study = f"study {number}"
            for plan in plans:
                ledger.plan(replace(plan, study_sha256=study))
            assert overview.plan(study) == replace(last, study_sha256=study)
            assert query(path, f"SELECT count(*) FROM plans WHERE study_sha256 = '{study}'") == [(rows,)]
    assert replace(PLAN, parts=(("a", "b"), ("b", "c"))).keys == ["a", "b", "c"]
