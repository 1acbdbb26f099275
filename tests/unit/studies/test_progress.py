"""How far a study is: ledger keys, status, what is finished."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from strandline.design import sobol
from strandline.foundations import InvalidStudy, LedgerError, write_json
from strandline.models.identity import fingerprint
from strandline.runs import Ledger, RunRecord, RunRequest, attempt, run_key
from strandline.runs.ledger.ledger_schema import ATTEMPTS
from strandline.studies import load_study
from strandline.studies.doctor import _gaps
from strandline.studies.keys.folder import SUMMARY
from strandline.studies.load.progress import RATE_RUNS, _per_minute, progress_in, progress_of
from strandline.studies.load.study import settled
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


def test_keys_are_those_of_a_campaign(study):
    points = study.space.to_physical(sobol(RUNS, 2))
    inputs = [{**study.fixed, **study.space.as_mapping(x)} for x in points]
    assert study.runs.design_keys == [run_key(fingerprint(study.model), one) for one in inputs]
    truth = run_key("test:beam-1", {"E": 400.0, "tilt": 0.02, "load": 1e-5})
    assert study.runs.needed_keys == [truth, *study.runs.design_keys]


def test_before_the_first_run_and_while_a_driver_is_at_work(study):
    state = progress_of(study)
    assert (state.name, counts(state)) == ("bent", (RUNS, 0, 0, 0, 0, RUNS))
    assert (state.results, state.driver, state.rate, state.slowest) == ("none", None, None, None)
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
    assert (state.median_seconds, state.slowest.key, state.driver.at_work) == (2.0, failing.key, True)
    assert state.seconds_left == pytest.approx(60 * 4 / state.rate)
    smaller = load_study(write_study(study.folder, design={"sobol": {"runs": 4}}))
    assert counts(progress_of(smaller)) == (4, 3, 0, 0, 1, 1)


def test_a_run_that_killed_its_process_each_time_is_settled(study):
    """The last try is under way while it lasts; lost with its driver, it counts as the others."""
    first = requests(study)[0]
    with opened(study) as ledger:
        for _ in range(ATTEMPTS - 1):
            fail(ledger, first, "killed", "worker_died")
            assert not settled(ledger, [first.key])
        ledger.started(first)
        assert counts(progress_of(study)) == (RUNS, 0, 0, 1, 0, 7)
    assert counts(progress_of(study)) == (RUNS, 0, 1, 0, 0, 7)
    with opened(study) as ledger:
        assert len(settled(ledger, [first.key])) == 1


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
        patch.setattr("strandline.runs.ledger.ledger.socket.gethostname", lambda: "elsewhere")
        with opened(study) as ledger:
            ledger.started(requests(study)[0])
    state = progress_of(study)
    assert (state.driver.host, state.driver.at_work) == ("elsewhere", None)
    assert counts(state) == (RUNS, 0, 0, 1, 0, 7)


@pytest.mark.stand_in
def test_pace_is_that_of_the_last_runs():
    """One by one, side by side, and of many runs the last."""
    many = [(0.0, 1.0), (1.0, 2.0), *((2.0 + 60 * k, 62.0 + 60 * k) for k in range(RATE_RUNS))]
    for times, rate in (
        ([(0.0, 10.0), (10.0, 20.0), (20.0, 30.0)], 6.0),
        ([(0.0, 60.0), (0.5, 60.5), (1.0, 60.0)], 60 * 3 / 60.5),
        (many, 1.0),
    ):
        made = [SimpleNamespace(started_at=begun, finished_at=ended) for begun, ended in times]
        assert _per_minute(made) == pytest.approx(rate)


def test_runs_of_others_and_interrupted_ones_make_no_pace(study, tmp_path):
    with opened(study) as ledger:
        make(ledger, study, 4)
    ended = progress_of(study)
    assert (ended.rate is not None, ended.seconds_left) == (True, None)
    other = load_study(write_study(tmp_path / "other", design={"sobol": {"runs": RUNS}}, reuse=["../beam"]))
    assert (progress_of(other).reused, progress_of(other).to_do) == (4, RUNS - 4)
    with opened(other) as ledger:
        ledger.copy_from(study.ledger_path, study.runs.design_keys)
        fail(ledger, requests(study)[5], "killed", "interrupted")
    assert (progress_of(other).ok, progress_of(other).reused, progress_of(other).rate) == (4, 0, None)
    assert (study.runs.known, other.runs.known) == (4, 4)
    study.ledger_path.unlink()
    with Ledger.open(study.ledger_path, model="something else") as ledger:
        ledger.started(requests(study)[0])
    with pytest.raises(
        LedgerError, match=r"beam/ledger\.sqlite keeps the runs of another model.*`reuse`, remove it there"
    ):
        other.runs.require_sound_ledgers()


def test_a_damaged_ledger_and_an_unreadable_study_are_refused(study):
    study.ledger_path.write_bytes(b"no database" * 500)
    with pytest.raises(LedgerError, match="damaged"):
        progress_in(study.folder)
    (study.folder / "study.yaml").write_bytes(b"\xff")
    with pytest.raises(InvalidStudy, match="cannot be read"):
        progress_in(study.folder)


def test_finished_means_the_observation_too(study):
    with pytest.raises(InvalidStudy, match=r"not finished: got 0 of 9 forward runs done.*strandline run"):
        study.runs.require_finished()
    with opened(study) as ledger:
        make(ledger, study, RUNS)
        with pytest.raises(InvalidStudy, match="got 8 of 9"):
            study.runs.require_finished()
        write_json(study.folder / SUMMARY, {"study_sha256": "another"})
        with pytest.raises(InvalidStudy, match=r"got 8 of 9 .*, and results of an earlier study\.yaml; expected"):
            study.runs.require_finished()
        truth = RunRequest(study.runs.needed_keys[0], dict(study.truth or {}))
        ledger.started(truth)
        ledger.finished(attempt(study.model, truth, study.folder))
    study.runs.require_finished()
    assert not {*study.runs.design_keys} & {*replace(study, fixed={"load": 2e-5}).runs.design_keys}


def test_a_ledger_of_an_earlier_fingerprint_is_accepted_if_the_function_has_it(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    keys = {"inputs": {"a": {"prior": {"uniform": [0, 1]}}}, "fixed": None, "observation": {"synthetic": {"a": 0.5}}}
    text = "def f(inputs, workdir):\n    return [[0.0, 0.0], [1.0, inputs['a']]]\n"
    for name, more in (("old_model", ""), ("named_model", "f.fingerprint = 'python:0123456789abcdef'\n")):
        (tmp_path / f"{name}.py").write_text(text + more)
    folder = write_study(tmp_path / "now", model={"python": {"function": "old_model:f"}}, **keys)
    with Ledger.open(folder / "ledger.sqlite", model="python:0123456789abcdef") as ledger:
        ledger.started(RunRequest("one", {"a": 0.5}))
    with pytest.raises(LedgerError, match="as its attribute `fingerprint`"):
        load_study(folder).runs.require_sound_ledgers()
    folder = write_study(folder, model={"python": {"function": "named_model:f"}}, **keys)
    load_study(folder).runs.require_sound_ledgers()


@pytest.mark.stand_in
def test_gaps_are_told_unless_a_driver_is_at_work():
    study, driver = SimpleNamespace(folder="beam"), SimpleNamespace(at_work=True)
    for detached, at_work, lost, told in (
        (False, None, 2, ["3 of 5 planned runs have no outcome; 2 of them were started and lost with their driver"]),
        (False, SimpleNamespace(at_work=False), 0, ["3 of 5 planned runs have no outcome"]),
        (False, driver, 0, []),
        (True, None, 0, []),
    ):
        state = SimpleNamespace(detached=detached, driver=at_work, open=1, planned=5, done=2, lost=lost)
        assert [one.what for one in _gaps(study, state)] == told
