"""How far a study is: ledger keys, status, what is finished."""

import inspect
import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from strandline.errors import InvalidStudy, LedgerError
from strandline.models.protocol import fingerprint
from strandline.runs import Ledger, RunRecord, RunRequest, attempt, run_campaign, run_key
from strandline.studies import Study, load_study
from strandline.studies.ledgers import (
    ATTEMPTS,
    check_ledgers,
    design_keys,
    known_runs,
    needed_keys,
    require_finished,
    settled,
)
from strandline.studies.progress import progress_of
from strandline.testing.studies import write_study


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return load_study(write_study(tmp_path / "beam", name="bent", design={"sobol": {"runs": 8}}))


def opened(study: Study) -> Ledger:
    return Ledger.open(study.ledger_path, model=fingerprint(study.model))


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
    keys = design_keys(study)
    assert keys == [request.key for request in requests(study)]
    assert needed_keys(study)[0] == run_key("test:beam-1", {"E": 400.0, "tilt": 0.02, "load": 1e-5})
    assert needed_keys(study)[1:] == keys


def test_attempts_are_those_of_a_campaign() -> None:
    assert inspect.signature(run_campaign).parameters["maximum_attempts"].default == ATTEMPTS


def test_before_the_first_run(study: Study) -> None:
    state = progress_of(study)
    assert (state.name, state.planned, state.ok, state.failed, state.open, state.to_do) == ("bent", 8, 0, 0, 0, 8)
    assert state.results == "none"
    assert not study.ledger_path.exists()


def test_while_a_driver_is_at_work(study: Study, tmp_path: Path) -> None:
    with opened(study) as ledger:
        make(ledger, study, 3, tmp_path)
        ledger.started(requests(study)[3])
        failing = requests(study)[4]
        ledger.started(failing)
        message = "no convergence\nlong story"
        ledger.finished(RunRecord(failing.key, failing.inputs, "failed", failure_kind="stalled", message=message))
        state = progress_of(study)
    assert (state.ok, state.failed, state.open, state.to_do) == (3, 1, 1, 3)
    assert state.by_kind == {"stalled": 1}
    assert state.examples["stalled"].endswith("no convergence")
    assert "E = 397.5, tilt = 0.015: " in state.examples["stalled"]
    assert "load" not in state.examples["stalled"]
    assert state.median_seconds is not None
    assert state.slowest is not None


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
    assert progress_of(study).by_kind == {"worker_died": 1}


def test_finished_means_the_observation_too(study: Study, tmp_path: Path) -> None:
    with pytest.raises(InvalidStudy, match=r"not finished: got 0 of 9 forward runs done.*strandline run"):
        require_finished(study)
    with opened(study) as ledger:
        make(ledger, study, 8, tmp_path)
        with pytest.raises(InvalidStudy, match="got 8 of 9"):
            require_finished(study)
        truth = RunRequest(needed_keys(study)[0], dict(study.truth or {}))
        ledger.started(truth)
        ledger.finished(attempt(study.model, truth, tmp_path))
    require_finished(study)


def test_known_runs_are_counted_once_over_all_ledgers(study: Study, tmp_path: Path) -> None:
    with opened(study) as ledger:
        make(ledger, study, 5, tmp_path)
    assert known_runs(study) == 5
    other = load_study(write_study(tmp_path / "other", design={"sobol": {"runs": 8}}, reuse=["../beam"]))
    assert known_runs(other) == 5
    with opened(other) as ledger:
        make(ledger, other, 6, tmp_path)
    assert known_runs(other) == 6


def test_a_reused_ledger_is_checked_too(study: Study, tmp_path: Path) -> None:
    Ledger.open(study.ledger_path, model="something else").close()
    other = load_study(write_study(tmp_path / "other", reuse=["../beam"]))
    with pytest.raises(LedgerError, match=r"beam/ledger\.sqlite keeps the runs of another model"):
        check_ledgers(other)


def test_results_of_an_earlier_study_file_are_told(finished: Any, tmp_path: Path) -> None:
    folder = tmp_path / "beam"
    shutil.copytree(finished.folder, folder)
    assert progress_of(load_study(folder)).results == "current"
    assert progress_of(load_study(write_study(folder, seed=2))).results == "outdated"
    (folder / "summary.json").write_text(json.dumps({})[:-1])
    assert progress_of(load_study(folder)).results == "none"
