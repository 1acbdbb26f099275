"""A finished study, shared by the tests that only look at it."""

from dataclasses import dataclass
from pathlib import Path

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
