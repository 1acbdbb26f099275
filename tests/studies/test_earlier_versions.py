"""Studies that earlier versions ran: their files are read, no run is made again, and the posterior is the same."""

import json
import shutil
from pathlib import Path

import pytest

from strandline.runs import InProcess
from strandline.studies import load_study, run_study

DATA = Path(__file__).parents[1] / "data"
FIRST = {"sobol": 20, "active": 8}
"""Runs that do not depend on others."""


@pytest.mark.parametrize(
    ("version", "kind"),
    [
        ("0.1", "sobol"),
        ("0.2", "active"),
        pytest.param("0.1", "active", marks=pytest.mark.long),
        pytest.param("0.2", "sobol", marks=pytest.mark.long),
    ],
)
def test_the_posterior_is_the_same(version: str, kind: str, tmp_path: Path, without_report: None) -> None:
    folder = Path(shutil.copytree(DATA / f"studies-{version}" / kind, tmp_path / kind))
    expected = json.loads((folder / "expected.json").read_text("utf-8"))
    assert expected["version"] == f"{version}.0"
    found = run_study(load_study(folder), executor=InProcess()).summary
    new, inputs = found["runs"]["new"], found["inputs"]
    if new == 0:
        assert found["log_evidence"] == pytest.approx(expected["log_evidence"], rel=1e-7)
        for name, moments in expected["inputs"].items():
            for moment, value in moments.items():
                assert inputs[name][moment] == pytest.approx(value, rel=1e-7, abs=1e-9)
        return
    # Runs after the first are drawn from the posterior: a processor that rounds in another way draws others.
    assert found["runs"]["reused"] >= FIRST[kind]
    assert found["log_evidence"] == pytest.approx(expected["log_evidence"], abs=0.3)
    for name, moments in expected["inputs"].items():
        assert inputs[name]["mean"] == pytest.approx(moments["mean"], abs=0.3 * moments["sd"])
        assert inputs[name]["sd"] == pytest.approx(moments["sd"], rel=0.3)
