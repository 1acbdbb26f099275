"""A finished study of a beam that learns the interface, shared by the tests of its page."""

import shutil
from pathlib import Path

import pytest

import strandline as sl
from strandline.testing.studies import write_study

SMALL = {
    "noise": {"sd": 3, "unit": "um"},
    "observation": {"synthetic": {"E": 400, "tilt": 0.02, "load": 1e-5}, "noise": {"sd": 0.003}},
    "discrepancy": [{"normal_offset": {}}, {"tracked_points": {}}],
    "surrogate": {"field": {}},
    "design": {"sobol": {"runs": 24}},
    "sampler": {"smc": {"particles": 2000, "rejuvenation_steps": 4}, "cut": {"values": 2}},
    "inputs": {
        "E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"},
        "tilt": {"prior": {"uniform": [0.0, 0.04]}, "nuisance": True},
    },
}


@pytest.fixture(scope="session")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_study(tmp_path_factory.mktemp("view") / "beam", **SMALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
        sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    return folder


@pytest.fixture
def folder(analysed: Path, tmp_path: Path) -> Path:
    target = tmp_path / "beam"
    shutil.copytree(analysed, target)
    return target
