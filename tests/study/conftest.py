"""Finished studies, one for each kind of surrogate: made once a run, shared by the tests that look at them.

Tests that use the same study run in the same process (see the `conftest.py` above), so that each is made once. All are
drafts; a test that changes a folder takes a copy of it.
"""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from strandline.runs import InProcess
from strandline.studies import Outcome, Study, load_study, run_study
from strandline.testing.studies import write_study

SAMPLER = {"smc": {"particles": 1000, "rejuvenation_steps": 4, "zeta": 0.5}}
"""The same number of particles everywhere: JAX compiles once."""
NOISY = {
    "noise": {"sd": 3, "unit": "um"},
    "observation": {"synthetic": {"E": 400, "tilt": 0.02, "load": 1e-5}, "noise": {"sd": 0.003}},
    "discrepancy": [{"normal_offset": {}}, {"tracked_points": {}}],
    "surrogate": {"field": {}},
}


@dataclass(frozen=True)
class Finished:
    folder: Path
    study: Study
    outcome: Outcome


Folders = pytest.TempPathFactory


def finish(folder: Path, **content: Any) -> Finished:
    """Return the study with other content than the beam's, run in this process."""
    study = load_study(write_study(folder, **{"draft": True, "sampler": SAMPLER, **content}))
    return Finished(study.folder, study, run_study(study, executor=InProcess()))


@pytest.fixture(scope="session")
def beam(tmp_path_factory: Folders) -> Finished:
    """A surrogate of the log-likelihood, two measures, no noise in the observation."""
    measures = [{"tracked_points": {}}, {"closest_point": {}}]
    return finish(tmp_path_factory.mktemp("beam") / "beam", discrepancy=measures)


@pytest.fixture(scope="session")
def field(tmp_path_factory: Folders) -> Finished:
    """A surrogate of the interface; the tilt is a nuisance input."""
    inputs = {
        "E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"},
        "tilt": {"prior": {"uniform": [0.0, 0.04]}, "nuisance": True},
    }
    sampler = {**SAMPLER, "cut": {"values": 2}}
    design = {"sobol": {"runs": 32}}
    return finish(tmp_path_factory.mktemp("field") / "beam", inputs=inputs, design=design, **NOISY, sampler=sampler)


@pytest.fixture(scope="session")
def active(tmp_path_factory: Folders) -> Finished:
    """A surrogate of the interface, whose runs an active design chose."""
    return finish(tmp_path_factory.mktemp("active") / "beam", **NOISY, design={"active": {"runs": 40}})


@pytest.fixture
def copy_of(tmp_path: Path) -> Callable[[Finished], Path]:
    """A copy of a finished study's folder, which the test may change."""

    def copied(finished: Finished) -> Path:
        return Path(shutil.copytree(finished.folder, tmp_path / "study"))

    return copied
