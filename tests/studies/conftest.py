"""A finished study, shared by the tests that only look at it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from strandline.runs import InProcess
from strandline.studies import Outcome, Study, load_study, run_study
from strandline.testing.studies import write_study


@dataclass(frozen=True)
class Finished:
    folder: Path
    study: Study
    outcome: Outcome


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    folder = write_study(tmp_path_factory.mktemp("studies") / "beam")
    study = load_study(folder)
    return Finished(folder, study, run_study(study, executor=InProcess()))


@pytest.fixture
def without_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out figures and page: they take most of the time of a small study."""

    def write_report(calibration: Any, summary: Any, *, folder: Path, **others: Any) -> Path:
        return folder / "report.html"

    monkeypatch.setattr("strandline.studies.run.write_report", write_report)
