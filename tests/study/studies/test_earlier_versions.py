"""Studies that earlier versions ran: their files are read, no run is made again, and the posterior is the same."""

import json
import shutil
from pathlib import Path

import pytest
from tests.study.conftest import SAMPLER
from verification.upgrade_ledger import upgrade

from strandline.runs import InProcess
from strandline.studies import load_study, run_study
from strandline.studies.load.progress import progress_in, recorded_plan
from strandline.testing.studies import write_study

DATA = Path(__file__).parents[2] / "data"
FIRST = {"sobol": 20, "active": 8}
"""Runs that do not depend on others."""
LONG = [
    pytest.param(*case, marks=pytest.mark.long) for case in (("0.2", "active"), ("0.1", "active"), ("0.2", "sobol"))
]


@pytest.mark.parametrize(("version", "kind"), [("0.1", "sobol"), *LONG])
def test_the_posterior_is_the_same(version, kind, tmp_path):
    folder = Path(shutil.copytree(DATA / f"studies-{version}" / kind, tmp_path / kind))
    if version == "0.1":
        upgrade(folder / "ledger.sqlite")
    if kind == "sobol":  # what a draft leaves out does not change the posterior of runs that are given
        text = (folder / "study.yaml").read_text("utf-8")
        (folder / "study.yaml").write_text(text + "draft: true\nreport: none\n", "utf-8")
    expected = json.loads((folder / "expected.json").read_text("utf-8"))
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


def test_an_earlier_study_or_ledger_is_known_to_be_finished_before_it_is_run(tmp_path):
    study = load_study(Path(shutil.copytree(DATA / "studies-0.2" / "active", tmp_path / "active")))
    study.runs.require_finished()
    assert progress_in(study.folder).to_do == 0
    quick = {"draft": True, "report": "none", "sampler": SAMPLER}
    folder = write_study(tmp_path / "old", name="old", fixed={"load": 1e-4}, design={"sobol": {"runs": 8}}, **quick)
    shutil.copy(DATA / "ledger-v2-study.sqlite", folder / "ledger.sqlite")
    (folder / "ledger.sqlite").chmod(0o644)
    upgrade(folder / "ledger.sqlite")
    assert recorded_plan(folder) is None
    before = progress_in(folder)
    assert (before.ok, before.failed, before.to_do) == (4, 4, 0)
    assert run_study(load_study(folder), executor=InProcess()).summary["runs"]["new"] == 0
    after = progress_in(folder)
    assert (after.ok, after.failed, after.failures) == (4, 4, before.failures)
