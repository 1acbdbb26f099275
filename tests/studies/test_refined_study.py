"""A study with rounds of refinement: counts, resume, results, reuse."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.calibration import Observer
from strandline.cli import main
from strandline.errors import InvalidStudy
from strandline.posterior import read
from strandline.runs import InProcess, Ledger, Progress, RunRecord
from strandline.studies import load_study, run_study
from strandline.studies.progress import progress_of
from strandline.testing.studies import TWO_LOADS_STUDY, write_study

SMALL: dict[str, Any] = {
    **TWO_LOADS_STUDY,
    "design": {"sobol": {"runs": 8}, "refine": {"rounds": 2, "runs": 6}},
    "sampler": {"smc": {"particles": 200, "rejuvenation_steps": 5, "zeta": 0.6}},
}


class Stopped(Exception):
    """The driver is stopped."""


def stopping_after(runs: int) -> Observer:
    made: list[RunRecord] = []

    def run(record: RunRecord, progress: Progress) -> None:
        made.append(record)
        if len(made) == runs:
            raise Stopped

    return Observer(run=run)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_study(tmp_path_factory.mktemp("refined") / "beam", **SMALL)


@pytest.fixture(scope="module")
def summary(folder: Path) -> dict[str, Any]:
    """Of a study that was stopped twice: among the runs of the first round, and of the second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.run.write_report", lambda *a, folder, **o: folder / "report.html")
        for runs, ok in ((11, 11), (5, 16)):
            with pytest.raises(Stopped):
                run_study(load_study(folder), executor=InProcess(), observer=stopping_after(runs))
            study = load_study(folder)
            state = progress_of(study)
            assert (state.planned, state.ok, state.to_do) == (20, ok, 20 - ok)
            assert study.runs.known == ok
            with pytest.raises(InvalidStudy, match=f"got {ok + 1} of 21 forward runs done"):
                study.runs.require_finished()
        return run_study(load_study(folder), executor=InProcess()).summary


def test_what_was_stopped_goes_on_to_the_same_bits(
    folder: Path, summary: dict[str, Any], tmp_path: Path, without_report: None
) -> None:
    other = write_study(tmp_path / "at-once", **SMALL)
    straight = run_study(load_study(other), executor=InProcess())
    assert (straight.summary["runs"]["new"], straight.summary["runs"]["reused"]) == (20, 0)
    assert (summary["runs"]["new"], summary["runs"]["reused"]) == (4, 16)
    assert read(folder / "posterior.nc").identical(read(other / "posterior.nc"))
    assert straight.summary["refinement"] == summary["refinement"]


def test_a_finished_study_is_known_to_be_so(folder: Path, summary: dict[str, Any]) -> None:
    study = load_study(folder)
    study.runs.require_finished()
    state = progress_of(study)
    assert (state.planned, state.ok, state.to_do, state.results) == (20, 20, 0, "current")
    assert [len(keys) for keys in study.runs.rounds] == [6, 6]
    with Ledger.open(study.ledger_path, model=study.model, read_only=True) as ledger:
        assert {record.key for record in ledger} == set(study.runs.needed_keys)


def test_the_rounds_are_told(summary: dict[str, Any]) -> None:
    first, second = summary["refinement"]
    assert (first["n_train"], second["n_train"]) == (8, 14)
    assert summary["surrogate"]["n_train"] == summary["runs"]["ok"] == 20
    assert second["error_rms"] < first["error_rms"]
    assert np.isfinite(first["shift"]["E"])


def test_another_study_file_has_rounds_of_its_own(folder: Path, summary: dict[str, Any], tmp_path: Path) -> None:
    other = write_study(tmp_path / "beam", **SMALL)
    (other / "refinement.json").write_bytes((folder / "refinement.json").read_bytes())
    assert load_study(other).runs.planned == 20
    assert len(load_study(other).runs.rounds) == 2
    changed = load_study(write_study(other, **{**SMALL, "seed": 2}))
    assert changed.runs.rounds == []
    assert changed.runs.planned == 20


def test_rounds_are_taken_over_from_a_study_that_is_reused(
    folder: Path, summary: dict[str, Any], tmp_path: Path, without_report: None
) -> None:
    other = write_study(tmp_path / "beam", **SMALL, reuse=[str(folder)])
    outcome = run_study(load_study(other), executor=InProcess())
    assert (outcome.summary["runs"]["new"], outcome.summary["runs"]["reused"]) == (0, 20)


def test_check_and_status_count_the_rounds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_study(tmp_path / "beam", **SMALL)
    main(["check", str(folder)])
    assert "20 forward runs planned (8 and 2 rounds of 6), 0 of them known already" in capsys.readouterr().out
    main(["status", str(folder)])
    assert "0 of 20 runs of the design done" in capsys.readouterr().out


def test_more_runs_than_particles_are_refused(tmp_path: Path) -> None:
    folder = write_study(tmp_path, **{**SMALL, "design": {"sobol": {"runs": 8}, "refine": {"runs": 201}}})
    with pytest.raises(InvalidStudy, match=r"design\.refine\.runs: got 201; expected at most 200"):
        load_study(folder)


def test_a_damaged_note_of_the_rounds_is_passed_over(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, **SMALL))
    for text in ("", "[]", '{"rounds": 3}', json.dumps({"study_sha256": study.text_digest, "rounds": "x"})):
        (tmp_path / "refinement.json").write_text(text)
        assert study.runs.rounds == []
    assert progress_of(study).planned == 20
