"""How far a study is: ledger keys, status, what is finished."""

import inspect
import json
import os
import shutil
import socket
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from strandline.calibration import Observer
from strandline.errors import InvalidStudy, LedgerError
from strandline.models.protocol import fingerprint
from strandline.runs import InProcess, Ledger, RunRecord, RunRequest, attempt, run_campaign, run_key
from strandline.runs.tables import ATTEMPTS
from strandline.studies import Study, load_study, run_study
from strandline.studies.progress import progress_in, progress_of, recorded_plan
from strandline.studies.study_runs import settled
from strandline.testing.studies import write_study

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return load_study(write_study(tmp_path / "beam", name="bent", design={"sobol": {"runs": 8}}))


def opened(study: Study) -> Ledger:
    return Ledger.open(study.ledger_path, model=study.model)


def requests(study: Study) -> list[RunRequest]:
    from strandline.design import sobol

    points = study.space.to_physical(sobol(8, 2))
    inputs = [{**study.fixed, **study.space.as_mapping(x)} for x in points]
    return [RunRequest(run_key(fingerprint(study.model), entry), entry) for entry in inputs]


def make(ledger: Ledger, study: Study, number: int, tmp_path: Path) -> None:
    for request in requests(study)[:number]:
        ledger.started(request)
        ledger.finished(attempt(study.model, request, tmp_path))


def test_keys_are_those_of_the_campaign(study: Study) -> None:
    keys = study.runs.design_keys
    assert keys == [request.key for request in requests(study)]
    assert study.runs.needed_keys[0] == run_key("test:beam-1", {"E": 400.0, "tilt": 0.02, "load": 1e-5})
    assert study.runs.needed_keys[1:] == keys


def test_attempts_are_those_of_a_campaign() -> None:
    assert inspect.signature(run_campaign).parameters["maximum_attempts"].default == ATTEMPTS


def test_before_the_first_run(study: Study) -> None:
    state = progress_of(study)
    assert (state.name, state.planned, state.ok, state.failed, state.open, state.to_do) == ("bent", 8, 0, 0, 0, 8)
    assert (state.results, state.driver, state.rate, state.slowest) == ("none", None, None, None)
    assert not study.ledger_path.exists()


def test_while_a_driver_is_at_work(study: Study, tmp_path: Path) -> None:
    with opened(study) as ledger:
        for request, seconds in zip(requests(study)[:3], (1.0, 2.0, 2.0), strict=True):
            ledger.started(request)
            ledger.finished(replace(attempt(study.model, request, tmp_path), seconds=seconds))
        ledger.started(requests(study)[3])
        failing = requests(study)[4]
        ledger.started(failing)
        story = {"message": "no convergence\nlong story", "log": "zero\n\none  \ntwo\n\n"}
        ledger.finished(RunRecord(failing.key, failing.inputs, "failed", {}, {}, 9.0, "stalled", **story))
        state = progress_of(study)
    assert (state.ok, state.failed, state.open, state.to_do) == (3, 1, 1, 3)
    assert {kind: some.count for kind, some in state.failures.items()} == {"stalled": 1}
    example = state.failures["stalled"].example
    assert (example.key, example.message, example.log) == (failing.key, "no convergence", ("one", "two"))
    assert example.inputs == pytest.approx({"E": 397.5, "tilt": 0.015})
    assert (state.median_seconds, state.slowest and state.slowest.seconds) == (2.0, 9.0)
    assert state.slowest is not None
    assert state.slowest.key == failing.key
    assert state.driver is not None
    assert (state.driver.pid, state.driver.at_work) == (os.getpid(), True)


def test_runs_of_other_designs_do_not_count(study: Study, tmp_path: Path) -> None:
    with opened(study) as ledger:
        make(ledger, study, 8, tmp_path)
    smaller = load_study(write_study(study.folder, design={"sobol": {"runs": 4}}))
    state = progress_of(smaller)
    assert (state.planned, state.ok, state.to_do) == (4, 4, 0)


def test_a_run_that_killed_its_process_each_time_is_settled(study: Study) -> None:
    request = requests(study)[0]
    with opened(study) as ledger:
        for attempts in range(1, ATTEMPTS + 1):
            ledger.started(request)
            ledger.finished(RunRecord(request.key, request.inputs, "killed", failure_kind="worker_died"))
            assert len(settled(ledger, [request.key])) == (attempts == ATTEMPTS)
    assert progress_of(study).failures["worker_died"].count == 1


def test_a_lost_run_is_to_do_and_told(study: Study, tmp_path: Path) -> None:
    with opened(study) as ledger:
        make(ledger, study, 2, tmp_path)
        ledger.started(requests(study)[2])
        assert (progress_of(study).open, progress_of(study).lost) == (1, 0)
    state = progress_of(study)
    assert (state.ok, state.open, state.lost, state.to_do) == (2, 0, 1, 6)
    with opened(study) as ledger:  # another driver, which has not come to it yet
        state = progress_of(study)
        assert (state.open, state.lost, state.to_do) == (0, 1, 6)
        ledger.started(requests(study)[2])
        state = progress_of(study)
        assert (state.open, state.lost, state.to_do) == (1, 0, 5)


def test_the_third_try_is_under_way_while_it_lasts(study: Study) -> None:
    request = requests(study)[0]
    with opened(study) as ledger:
        for _ in range(ATTEMPTS - 1):
            ledger.started(request)
            ledger.finished(RunRecord(request.key, request.inputs, "killed", failure_kind="worker_died"))
        ledger.started(request)
        assert (progress_of(study).open, progress_of(study).failed) == (1, 0)
    assert (progress_of(study).open, progress_of(study).lost, progress_of(study).failed) == (0, 0, 1)


def at_times(study: Study, sessions: list[list[tuple[float, float]]]) -> None:
    """Let drivers make the runs of the design in order, each started and ended at the given seconds."""
    waiting = iter(requests(study))
    for times in sessions:
        with opened(study) as ledger, pytest.MonkeyPatch.context() as patch:
            made = [next(waiting) for _ in times]
            moments = sorted([(t, i, end) for i, pair in enumerate(times) for end, t in enumerate(pair)])
            for now, number, end in moments:
                patch.setattr("strandline.runs.ledger.time.time", lambda now=now: now)
                if end:
                    ledger.finished(RunRecord(made[number].key, made[number].inputs, "failed", failure_kind="x"))
                else:
                    ledger.started(made[number])


@pytest.mark.parametrize(
    ("sessions", "rate"),
    [
        ([[(0.0, 10.0), (10.0, 20.0), (20.0, 30.0)]], 6.0),
        ([[(0.0, 60.0), (0.5, 60.5), (1.0, 60.0)]], 60 * 3 / 60.5),  # side by side: not three in half a second
        ([[(0.0, 1.0), (1.0, 2.0)], [(100.0, 130.0), (130.0, 160.0)]], 2.0),
        ([[(0.0, 30.0), (30.0, 60.0)], []], 2.0),
        ([[]], None),
    ],
    ids=["one by one", "side by side", "the last driver's", "a driver that made none", "none"],
)
def test_pace_is_that_of_the_last_driver(study: Study, sessions: Any, rate: float | None) -> None:
    at_times(study, sessions)
    assert progress_of(study).rate == (None if rate is None else pytest.approx(rate))
    assert progress_of(study).seconds_left is None


def test_pace_is_that_of_the_last_runs(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strandline.studies.progress.RATE_RUNS", 2)
    at_times(study, [[(0.0, 10.0), (10.0, 20.0), (20.0, 80.0), (80.0, 140.0)]])
    assert progress_of(study).rate == pytest.approx(1.0)


def test_runs_of_others_and_interrupted_ones_make_no_pace(study: Study, tmp_path: Path) -> None:
    with opened(study) as ledger:
        make(ledger, study, 4, tmp_path)
    assert progress_of(study).rate is not None
    other = load_study(write_study(tmp_path / "other", design={"sobol": {"runs": 8}}))
    with opened(other) as ledger:
        ledger.copy_from(study.ledger_path, [request.key for request in requests(study)])
        ledger.started(requests(study)[5])
        ledger.finished(RunRecord(requests(study)[5].key, {"E": 1.0}, "killed", failure_kind="interrupted"))
    assert (progress_of(other).ok, progress_of(other).rate) == (4, None)


def test_time_left_at_the_pace_of_the_driver_at_work(study: Study, tmp_path: Path) -> None:
    with opened(study) as ledger:
        assert progress_of(study).seconds_left is None
        make(ledger, study, 5, tmp_path)
        state = progress_of(study)
        assert state.rate is not None
        assert state.seconds_left == pytest.approx(60 * 3 / state.rate)


def test_a_driver_elsewhere_may_be_at_work(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("strandline.runs.ledger.socket.gethostname", lambda: "elsewhere")
        with opened(study) as ledger:
            ledger.started(requests(study)[0])
    assert socket.gethostname() != "elsewhere"
    state = progress_of(study)
    assert state.driver is not None
    assert (state.driver.host, state.driver.at_work) == ("elsewhere", None)
    assert (state.open, state.lost, state.to_do) == (1, 0, 7)


def test_a_plan_tells_the_same_as_the_study(tmp_path: Path, without_report: None) -> None:
    """Failures, runs to do, a round of refinement, an earlier study file: each as the loaded study tells it."""
    options: dict[str, Any] = {
        "design": {"sobol": {"runs": 12}, "refine": {"rounds": 2, "runs": 4}},
        "fixed": {"load": 1e-4},
        "sampler": {"smc": {"particles": 200, "rejuvenation_steps": 2, "zeta": 0.5}},
    }
    folder = write_study(tmp_path / "beam", **options)
    study = load_study(folder)
    assert recorded_plan(folder) is None
    assert progress_in(folder) == progress_of(study)

    ended: list[str] = []

    def run(record: RunRecord, _: Any) -> None:
        ended.append(record.state)
        assert recorded_plan(folder) == study.runs.plan
        assert progress_in(folder) == progress_of(study)
        assert progress_in(folder).done == len(ended)
        if len(ended) == 14:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(study, executor=InProcess(), observer=Observer(run=run))
    state = progress_in(folder)
    assert state == progress_of(study)
    assert (state.planned, state.done, state.to_do, state.open) == (20, 14, 6, 0)
    assert (state.ok, state.failed) == (ended.count("ok"), ended.count("failed"))
    assert state.ok
    assert state.failures["large_deflection"].count == state.failed > 0

    run_study(study, executor=InProcess())
    assert recorded_plan(folder) == study.runs.plan
    state = progress_in(folder)
    assert state == progress_of(study)
    assert (state.planned, state.done, state.to_do, state.results) == (20, 20, 0, "current")

    write_study(folder, **options, seed=2)
    assert recorded_plan(folder) is None
    state = progress_in(folder)
    assert (state.results, state.planned, state.done) == ("outdated", 20, 12)


def plan_rows(study: Study) -> int:
    with closing(sqlite3.connect(study.ledger_path)) as connection:
        return int(connection.execute("SELECT count(*) FROM plans").fetchone()[0])


def test_a_finished_study_run_again_notes_no_plan_again(finished: Any, tmp_path: Path, without_report: None) -> None:
    folder = tmp_path / "beam"
    shutil.copytree(finished.folder, folder)
    study = load_study(folder)
    assert plan_rows(study) == 1
    run_study(study, executor=InProcess())
    assert plan_rows(study) == 1


def test_a_study_run_by_an_earlier_version_is_loaded_until_it_is_run(tmp_path: Path, without_report: None) -> None:
    sampler = {"smc": {"particles": 200, "rejuvenation_steps": 2, "zeta": 0.5}}
    folder = write_study(
        tmp_path / "old", name="old", fixed={"load": 1e-4}, design={"sobol": {"runs": 8}}, sampler=sampler
    )
    shutil.copy(DATA / "ledger-v2-study.sqlite", folder / "ledger.sqlite")
    (folder / "ledger.sqlite").chmod(0o644)
    assert recorded_plan(folder) is None
    before = progress_in(folder)
    assert (before.ok, before.failed, before.to_do) == (4, 4, 0)
    assert run_study(load_study(folder), executor=InProcess()).summary["runs"]["new"] == 0
    assert recorded_plan(folder) is not None
    after = progress_in(folder)
    assert (after.ok, after.failed, after.failures, after.rate) == (4, 4, before.failures, before.rate)


def test_a_plan_of_a_study_without_a_file_or_with_a_damaged_ledger(study: Study) -> None:
    assert recorded_plan(study.folder / "nowhere") is None
    study.ledger_path.write_bytes(b"no database" * 500)
    with pytest.raises(LedgerError, match="damaged"):
        progress_in(study.folder)
    (study.folder / "study.yaml").write_bytes(b"\xff")
    assert recorded_plan(study.folder) is None
    with pytest.raises(InvalidStudy, match="cannot be read"):
        progress_in(study.folder)


def test_finished_means_the_observation_too(study: Study, tmp_path: Path) -> None:
    with pytest.raises(InvalidStudy, match=r"not finished: got 0 of 9 forward runs done.*strandline run"):
        study.runs.require_finished()
    with opened(study) as ledger:
        make(ledger, study, 8, tmp_path)
        with pytest.raises(InvalidStudy, match="got 8 of 9"):
            study.runs.require_finished()
        truth = RunRequest(study.runs.needed_keys[0], dict(study.truth or {}))
        ledger.started(truth)
        ledger.finished(attempt(study.model, truth, tmp_path))
    study.runs.require_finished()


def test_known_runs_are_counted_once_over_all_ledgers(study: Study, tmp_path: Path) -> None:
    with opened(study) as ledger:
        make(ledger, study, 5, tmp_path)
    assert study.runs.known == 5
    other = load_study(write_study(tmp_path / "other", design={"sobol": {"runs": 8}}, reuse=["../beam"]))
    assert other.runs.known == 5
    with opened(other) as ledger:
        make(ledger, other, 6, tmp_path)
    assert other.runs.known == 6


def test_a_reused_ledger_is_checked_too(study: Study, tmp_path: Path) -> None:
    Ledger.open(study.ledger_path, model="something else").close()
    other = load_study(write_study(tmp_path / "other", reuse=["../beam"]))
    with pytest.raises(LedgerError, match=r"beam/ledger\.sqlite keeps the runs of another model"):
        other.runs.require_sound_ledgers()


def test_results_of_an_earlier_study_file_are_told(finished: Any, tmp_path: Path) -> None:
    folder = tmp_path / "beam"
    shutil.copytree(finished.folder, folder)
    assert progress_of(load_study(folder)).results == "current"
    assert progress_of(load_study(write_study(folder, seed=2))).results == "outdated"
    (folder / "summary.json").write_text(json.dumps({})[:-1])
    assert progress_of(load_study(folder)).results == "none"
