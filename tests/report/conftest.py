"""A finished study, whose report is looked at."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from strandline.runs import InProcess
from strandline.studies import Outcome, load_study, run_study
from strandline.testing.studies import write_study


@dataclass(frozen=True)
class Reported:
    folder: Path
    outcome: Outcome


@pytest.fixture(scope="session")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Reported:
    """Two measures, and a name that must be escaped."""
    folder = write_study(
        tmp_path_factory.mktemp("reports") / "beam",
        discrepancy=[{"tracked_points": {}}, {"closest_point": {}}],
        sampler={"smc": {"particles": 400, "rejuvenation_steps": 3, "zeta": 0.5}},
    )
    path = folder / "study.yaml"
    path.write_text(path.read_text() + "\n# <script src='https://example.org/x.js'></script> & more\n")
    return Reported(folder, run_study(load_study(folder), executor=InProcess()))
