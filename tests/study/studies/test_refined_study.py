"""A study with rounds of refinement, some of whose runs fail: counts, resume, results, reuse."""

import json
from unittest.mock import Mock

import pytest
from tests.study.conftest import SAMPLER, Finished

from strandline.calibration import Observer
from strandline.foundations import InvalidStudy
from strandline.runs import InProcess, Ledger
from strandline.studies import load_study, run_study
from strandline.studies.load.progress import progress_in, progress_of, recorded_plan
from strandline.testing.studies import write_study

SMALL = {
    **{"draft": True, "report": "none", "sampler": SAMPLER, "noise": {"sd": 0.03}, "fixed": {"load": 1e-4}},
    "design": {"sobol": {"runs": 20}, "refine": {"rounds": 2, "runs": 6}},
    "observation": {"synthetic": {"E": 480, "tilt": 0.02, "load": 1e-4}},
}
"""Below 400 Pa, the beam bends too far."""


@pytest.fixture(scope="module")
def refined(tmp_path_factory):
    """Stopped among the runs of the second round, and finished; the noted plan tells the same as the loaded study."""
    folder = write_study(tmp_path_factory.mktemp("refined") / "beam", **SMALL)
    study, ended = load_study(folder), []

    def run(record, progress):
        ended.append(record.state)
        assert recorded_plan(folder) == study.runs.plan
        assert progress_in(folder) == progress_of(study)
        if len(ended) == 28:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(study, executor=InProcess(), observer=Observer(run=run))
    state = progress_in(folder)
    assert (state.planned, state.done, state.to_do, state.open) == (32, 28, 4, 0)
    assert state.failures["large_deflection"].count == state.failed == ended.count("failed") > 0
    with pytest.raises(InvalidStudy, match="got 29 of 33 forward runs done"):
        study.runs.require_finished()
    study = load_study(folder)
    return Finished(folder, study, run_study(study, executor=InProcess()))


def test_what_was_stopped_goes_on_and_the_rounds_are_told(refined):
    """With other draws of the second round, more than four runs would be new."""
    summary = refined.outcome.summary
    first, second = summary["refinement"]
    assert (summary["runs"]["new"], summary["runs"]["reused"]) == (4, 28)
    assert summary["runs"]["by_kind"] == {"large_deflection": summary["runs"]["failed"]}
    assert 8 <= first["n_train"] < second["n_train"] < summary["surrogate"]["n_train"] == summary["runs"]["ok"]
    study = refined.study
    study.runs.require_finished()
    state = progress_of(study)
    assert (state.planned, state.done, state.to_do, state.results) == (32, 32, 0, "current")
    assert [len(keys) for keys in study.runs.rounds] == [6, 6]
    with Ledger.open(study.ledger_path, model=study.model, read_only=True) as ledger:
        assert {record.key for record in ledger} == set(study.runs.needed_keys)


def test_results_and_rounds_belong_to_their_study_file(refined, copy_of):
    folder = copy_of(refined)
    study = load_study(folder)
    assert (study.runs.planned, len(study.runs.rounds)) == (32, 2)
    changed = load_study(write_study(folder, **SMALL | {"seed": 2}))
    assert (changed.runs.rounds, changed.runs.planned) == ([], 32)
    state = progress_in(folder)
    assert (state.results, state.planned, state.done) == ("outdated", 32, 20)
    for text in ("[]", json.dumps({"study_sha256": study.text_digest, "rounds": "x"})):
        (folder / "refinement.json").write_text(text)
        assert study.runs.rounds == []


def test_rounds_are_taken_over_from_a_study_that_is_reused(refined, tmp_path):
    """The runs of the first round are at hand when the study asks for them; it is stopped there."""
    study = load_study(write_study(tmp_path / "beam", **SMALL, reuse=[str(refined.folder)]))
    with pytest.raises(KeyboardInterrupt):
        run_study(study, executor=InProcess(), observer=Observer(draws=Mock(side_effect=KeyboardInterrupt)))
    with Ledger.open(study.ledger_path, model=study.model, read_only=True) as ledger:
        assert {record.key for record in ledger if record.origin} == set(study.runs.needed_keys)
    assert (len(study.runs.rounds), progress_of(study).done) == (1, 26)
