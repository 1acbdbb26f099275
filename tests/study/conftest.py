"""Finished studies, one for each kind of surrogate: made once a run, shared by all processes that look at them.

All are drafts. A test that changes a folder takes a copy of it.
"""

import os
import pickle
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

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
FIELD = {
    **NOISY,
    "inputs": {
        "E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"},
        "tilt": {"prior": {"uniform": [0.0, 0.04]}, "nuisance": True},
    },
    "design": {"sobol": {"runs": 32}},
    "sampler": {**SAMPLER, "cut": {"values": 2}},
}


@dataclass(frozen=True)
class Finished:
    folder: Path
    study: Study
    outcome: Outcome

    def copied(self, folder: Path) -> Path:
        """Copy the study to a new folder, without what SQLite keeps beside a ledger while another test reads it."""
        return Path(shutil.copytree(self.folder, folder, ignore=shutil.ignore_patterns("*-wal", "*-shm")))


Share = Callable[..., Finished]


@pytest.fixture(scope="session")
def share(tmp_path_factory: pytest.TempPathFactory) -> Share:
    """Run the study with other content than the beam's, unless another process of this run has done so."""
    root = tmp_path_factory.getbasetemp()
    root = root.parent if "PYTEST_XDIST_WORKER" in os.environ else root

    def shared(name: str, **content: Any) -> Finished:
        place, kept = root / f"study-{name}" / "beam", root / f"study-{name}.pickle"
        with FileLock(root / f"study-{name}.lock"):
            if not kept.exists():
                outcome = finish(place, **content).outcome
                kept.write_bytes(pickle.dumps(outcome))
        return Finished(place, load_study(place), pickle.loads(kept.read_bytes()))

    return shared


def finish(folder: Path, **content: Any) -> Finished:
    """Return the study with other content than the beam's, run in this process."""
    study = load_study(write_study(folder, **{"draft": True, "sampler": SAMPLER, **content}))
    return Finished(study.folder, study, run_study(study, executor=InProcess()))


@pytest.fixture(scope="session")
def beam(share: Share) -> Finished:
    """A surrogate of the log-likelihood, two measures, no noise in the observation."""
    return share("beam", discrepancy=[{"tracked_points": {}}, {"closest_point": {}}])


@pytest.fixture(scope="session")
def field(share: Share) -> Finished:
    """A surrogate of the interface; the tilt is a nuisance input."""
    return share("field", **FIELD)


@pytest.fixture(scope="session")
def active(share: Share) -> Finished:
    """A surrogate of the interface, whose runs an active design chose."""
    return share("active", **NOISY, design={"active": {"runs": 40}})


@pytest.fixture
def copy_of(tmp_path: Path) -> Callable[[Finished], Path]:
    """A copy of a finished study's folder, which the test may change."""

    return lambda finished: finished.copied(tmp_path / "study")
