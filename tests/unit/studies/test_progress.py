"""How far a study is: ledger keys, status, what is finished."""

import inspect
import os
import socket
import sqlite3
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import pytest

from strandline.design import sobol
from strandline.errors import InvalidStudy, LedgerError
from strandline.models.protocol import fingerprint
from strandline.runs import Ledger, RunRecord, RunRequest, attempt, run_campaign, run_key
from strandline.runs.tables import ATTEMPTS
from strandline.studies import load_study
from strandline.studies.doctor import _gaps, examine
from strandline.studies.progress import RATE_RUNS, progress_in, progress_of, recorded_plan
from strandline.studies.study_runs import settled
from strandline.testing.studies import write_study

RUNS = 8


@pytest.fixture
def study(tmp_path):
    return load_study(write_study(tmp_path / "beam", name="bent", design={"sobol": {"runs": RUNS}}))


def opened(study):
    return Ledger.open(study.ledger_path, model=study.model)


def requests(study):
    return [RunRequest(key, inputs) for key, inputs in zip(study.runs.design_keys, study.runs.design, strict=True)]


def make(ledger, study, number):
    for request in requests(study)[:number]:
        ledger.started(request)
        ledger.finished(attempt(study.model, request, study.folder))


def fail(ledger, request, state, kind, **story):
    ledger.started(request)
    ledger.finished(RunRecord(request.key, request.inputs, state, {}, {}, 9.0, kind, **story))


def counts(state):
    return state.planned, state.ok, state.failed, state.open, state.lost, state.to_do


def test_keys_are_those_of_a_campaign_and_so_are_attempts(study):
    points = study.space.to_physical(sobol(RUNS, 2))
    inputs = [{**study.fixed, **study.space.as_mapping(x)} for x in points]
    assert study.runs.design_keys == [run_key(fingerprint(study.model), one) for one in inputs]
    truth = run_key("test:beam-1", {"E": 400.0, "tilt": 0.02, "load": 1e-5})
    assert study.runs.needed_keys == [truth, *study.runs.design_keys]
    assert inspect.signature(run_campaign).parameters["maximum_attempts"].default == ATTEMPTS


def test_before_the_first_run_and_while_a_driver_is_at_work(study):
    state = progress_of(study)
    assert (state.name, counts(state)) == ("bent", (RUNS, 0, 0, 0, 0, RUNS))
    assert (state.results, state.driver, state.rate, state.slowest) == ("none", None, None, None)
    assert not study.ledger_path.exists()
    first, failing = requests(study)[:3], requests(study)[4]
    with opened(study) as ledger:
        for request, seconds in zip(first, (1.0, 2.0, 2.0), strict=True):
            ledger.started(request)
            ledger.finished(replace(attempt(study.model, request, study.folder), seconds=seconds))
        ledger.started(requests(study)[3])
        fail(ledger, failing, "failed", "stalled", message="no convergence\nlong story", log="zero\n\none  \ntwo\n\n")
        state = progress_of(study)
    assert counts(state) == (RUNS, 3, 1, 1, 0, 3)
    assert {kind: some.count for kind, some in state.failures.items()} == {"stalled": 1}
    example = state.failures["stalled"].example
    assert (example.key, example.message, example.log) == (failing.key, "no convergence", ("one", "two"))
    assert example.inputs == pytest.approx({"E": 397.5, "tilt": 0.015})
    assert (state.median_seconds, state.slowest.seconds, state.slowest.key) == (2.0, 9.0, failing.key)
    assert (state.driver.pid, state.driver.at_work) == (os.getpid(), True)
    assert state.seconds_left == pytest.approx(60 * 4 / state.rate)
    smaller = load_study(write_study(study.folder, design={"sobol": {"runs": 4}}))
    assert counts(progress_of(smaller)) == (4, 3, 0, 0, 1, 1)


def test_a_run_that_killed_its_process_each_time_is_settled(study):
    """The last try is under way while it lasts; lost with its driver, it counts as the others."""
    first, other = requests(study)[:2]
    with opened(study) as ledger:
        for attempts in range(1, ATTEMPTS + 1):
            fail(ledger, first, "killed", "worker_died")
            assert len(settled(ledger, [first.key])) == (attempts == ATTEMPTS)
        assert progress_of(study).failures["worker_died"].count == 1
        for _ in range(ATTEMPTS - 1):
            fail(ledger, other, "killed", "worker_died")
        ledger.started(other)
        assert counts(progress_of(study)) == (RUNS, 0, 1, 1, 0, 6)
    assert counts(progress_of(study)) == (RUNS, 0, 2, 0, 0, 6)


def test_a_lost_run_is_to_do_and_told(study):
    with opened(study) as ledger:
        make(ledger, study, 2)
        ledger.started(requests(study)[2])
        assert counts(progress_of(study)) == (RUNS, 2, 0, 1, 0, 5)
    assert counts(progress_of(study)) == (RUNS, 2, 0, 0, 1, 6)
    with opened(study) as ledger:  # another driver, which has not come to it yet
        assert counts(progress_of(study)) == (RUNS, 2, 0, 0, 1, 6)
        ledger.started(requests(study)[2])
        assert counts(progress_of(study)) == (RUNS, 2, 0, 1, 0, 5)


def test_a_driver_elsewhere_may_be_at_work(study, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("strandline.runs.ledger.socket.gethostname", lambda: "elsewhere")
        with opened(study) as ledger:
            ledger.started(requests(study)[0])
    assert socket.gethostname() != "elsewhere"
    state = progress_of(study)
    assert (state.driver.host, state.driver.at_work) == ("elsewhere", None)
    assert counts(state) == (RUNS, 0, 0, 1, 0, 7)


def at_times(study, sessions):
    """Let drivers make the runs of the design in order, each started and ended at the given seconds."""
    waiting = iter(requests(study))
    for times in sessions:
        with opened(study) as ledger:
            for _ in times:
                fail(ledger, next(waiting), "failed", "x")
    with closing(sqlite3.connect(study.ledger_path)) as connection, connection:
        for table in ("starts", "outcomes"):
            connection.execute(f"DROP TRIGGER {table}_no_UPDATE")
        for number, (begun, ended) in enumerate([pair for times in sessions for pair in times], 1):
            connection.execute("UPDATE starts SET started_at = ? WHERE attempt = ?", (begun, number))
            connection.execute("UPDATE outcomes SET finished_at = ? WHERE attempt = ?", (ended, number))


def test_pace_is_that_of_the_last_runs_of_the_last_driver(tmp_path):
    """One by one, side by side, by two drivers, the second of which may make none, and of many runs the last."""
    many = [(0.0, 1.0), (1.0, 2.0), *((2.0 + 60 * k, 62.0 + 60 * k) for k in range(RATE_RUNS))]
    study = load_study(write_study(tmp_path, design={"sobol": {"runs": RATE_RUNS + 2}}))
    for sessions, rate in (
        ([[(0.0, 10.0), (10.0, 20.0), (20.0, 30.0)]], 6.0),
        ([[(0.0, 60.0), (0.5, 60.5), (1.0, 60.0)]], 60 * 3 / 60.5),
        ([[(0.0, 1.0), (1.0, 2.0)], [(100.0, 130.0), (130.0, 160.0)]], 2.0),
        ([[(0.0, 30.0), (30.0, 60.0)], []], 2.0),
        ([many], 1.0),
        ([[]], None),
    ):
        study.ledger_path.unlink(missing_ok=True)
        at_times(study, sessions)
        assert progress_of(study).rate == (rate and pytest.approx(rate))
        assert progress_of(study).seconds_left is None


def test_runs_of_others_and_interrupted_ones_make_no_pace(study, tmp_path):
    with opened(study) as ledger:
        make(ledger, study, 4)
    assert progress_of(study).rate is not None
    other = load_study(write_study(tmp_path / "other", design={"sobol": {"runs": RUNS}}, reuse=["../beam"]))
    with opened(other) as ledger:
        ledger.copy_from(study.ledger_path, study.runs.design_keys)
        fail(ledger, requests(study)[5], "killed", "interrupted")
    assert (progress_of(other).ok, progress_of(other).rate) == (4, None)
    assert (study.runs.known, other.runs.known) == (4, 4)
    with opened(other) as ledger:
        make(ledger, other, 6)
    assert other.runs.known == 6


def test_a_plan_of_a_study_without_a_file_or_with_a_damaged_ledger(study):
    assert recorded_plan(study.folder / "nowhere") is None
    study.ledger_path.write_bytes(b"no database" * 500)
    with pytest.raises(LedgerError, match="damaged"):
        progress_in(study.folder)
    (study.folder / "study.yaml").write_bytes(b"\xff")
    assert recorded_plan(study.folder) is None
    with pytest.raises(InvalidStudy, match="cannot be read"):
        progress_in(study.folder)


def test_a_reused_ledger_of_another_model_or_without_one_of_its_facts_is_refused(study, tmp_path):
    other = load_study(write_study(tmp_path / "other", reuse=["../beam"]))
    Ledger.open(study.ledger_path, model="something else").close()
    with pytest.raises(LedgerError, match=r"beam/ledger\.sqlite keeps the runs of another model"):
        other.runs.require_sound_ledgers()
    for row in ("model", "schema_version"):
        with closing(sqlite3.connect(study.ledger_path)) as connection, connection:
            connection.execute("DELETE FROM meta WHERE key = ?", (row,))
        with pytest.raises(LedgerError, match=f"damaged.*no row {row}"):
            other.runs.require_sound_ledgers()


def test_finished_means_the_observation_too(study):
    with pytest.raises(InvalidStudy, match=r"not finished: got 0 of 9 forward runs done.*strandline run"):
        study.runs.require_finished()
    with opened(study) as ledger:
        make(ledger, study, RUNS)
        with pytest.raises(InvalidStudy, match="got 8 of 9"):
            study.runs.require_finished()
        truth = RunRequest(study.runs.needed_keys[0], dict(study.truth or {}))
        ledger.started(truth)
        ledger.finished(attempt(study.model, truth, study.folder))
    study.runs.require_finished()
    other = replace(study, fixed={"load": 2e-5})
    with Ledger.open(study.ledger_path, model=study.model, read_only=True) as ledger:
        assert len(ledger.latest(study.runs.design_keys)) == RUNS
        assert ledger.latest(other.runs.design_keys) == {}


OLD = "def helper(a):\n    return a\n\ndef f(inputs, workdir):\n    return [[0.0, 0.0], [1.0, helper(inputs['a'])]]\n"


def test_an_earlier_ledger_of_an_unchanged_function_is_accepted(tmp_path, monkeypatch):
    (tmp_path / "old_ledger_model.py").write_text(OLD)
    monkeypatch.syspath_prepend(tmp_path)
    model, inputs = {"python": {"function": "old_ledger_model:f"}}, {"a": {"prior": {"uniform": [0, 1]}}}
    write_study(tmp_path, model=model, inputs=inputs, fixed=None, observation={"synthetic": {"a": 0.5}})
    now = fingerprint(load_study(tmp_path).model)
    assert now.startswith("python-files:")
    earlier = fingerprint(replace(load_study(tmp_path).model, function_alone=True))
    ledger = tmp_path / "ledger.sqlite"
    Ledger.open(ledger, model=earlier).close()
    study = load_study(tmp_path)
    assert fingerprint(study.model) == earlier
    Ledger.open(study.ledger_path, model=study.model).close()
    assert any("covered old_ledger_model:f alone" in finding.what for finding in examine(tmp_path))
    ledger.rename(tmp_path / "away")
    assert fingerprint(load_study(tmp_path).model) == now
    Ledger.open(ledger, model="python:another").close()
    with pytest.raises(LedgerError, match="another model"):
        Ledger.open(ledger, model=fingerprint(load_study(tmp_path).model))


@pytest.mark.stand_in
def test_gaps_are_told_unless_a_driver_is_at_work():
    study, driver = SimpleNamespace(folder="beam"), SimpleNamespace(at_work=True)
    for detached, at_work, lost, told in (
        (False, None, 2, ["3 of 5 planned runs have no outcome; 2 of them were started and lost with their driver"]),
        (False, None, 0, ["3 of 5 planned runs have no outcome"]),
        (False, driver, 0, []),
        (True, None, 0, []),
        (False, SimpleNamespace(at_work=False), 0, ["3 of 5 planned runs have no outcome"]),
    ):
        state = SimpleNamespace(detached=detached, driver=at_work, open=1, planned=5, done=2, lost=lost)
        assert [one.what for one in _gaps(study, state)] == told
