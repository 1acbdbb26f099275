"""Studies with an active design: results, resume, another analysis of the same runs, a cheaper model."""

import json
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from tests.study.conftest import finish
from tests.study.studies import exact

from strandline.calibration import Observer
from strandline.foundations import InvalidStudy
from strandline.models.fidelities import is_cheaper
from strandline.posterior import read
from strandline.runs import InProcess, Ledger
from strandline.studies import load_study, run_study
from strandline.studies.load.progress import progress_of
from strandline.studies.run import load_result
from strandline.studies.write.summary import certificate
from strandline.testing.studies import write_study


def stopped_after(runs, folder):
    """Run the study until it has made some runs."""
    stop = Mock(side_effect=[None] * (runs - 1) + [KeyboardInterrupt])
    with pytest.raises(KeyboardInterrupt):
        run(folder, observer=Observer(run=stop))


def run(folder, **options):
    return run_study(load_study(folder), executor=InProcess(), **options).summary


def like(finished, folder, **changes):
    """Write a finished study again, without a report."""
    content = json.loads((finished.folder / "study.yaml").read_text())
    return write_study(folder, **content | {"report": "none"} | changes)


def test_the_certificate_is_in_the_summary_with_the_posterior_of_the_model_itself(active):
    summary = active.outcome.summary
    found = summary["certificate"]
    assert (found["converged"], found["verdict"]) == (True, "converged"), found
    assert {"initial", "check"} <= {entry["kind"] for entry in found["batches"]}
    assert sum(entry["runs"] for entry in found["batches"]) == found["runs"] == summary["runs"]["ok"] < 40
    check, last = found["check"], found["history"][-1]
    assert (check["passed"], check["failed"], check["reasons"]) == (True, 0, [])
    assert [step["runs"] for step in found["history"]] == list(np.cumsum([entry["runs"] for entry in found["batches"]]))
    assert found["feasible_mass"] == pytest.approx(1.0)
    field = active.outcome.calibration.field
    early = replace(field, certificate=replace(field.certificate, steps=()))
    assert certificate(replace(active.outcome.calibration, field=early))["error_um"] is None
    assert (summary["surrogate"]["kind"], summary["surrogate"]["n_train"]) == ("field", found["runs"])
    expected, _ = exact.posterior(exact.likelihood_of(active.outcome.calibration.problem))
    for name, (mean, sd) in expected.items():
        assert abs(last["mean"][name] - mean) < 0.2 * sd
        assert last["sd"][name] == pytest.approx(sd, rel=0.15)
    # The finished study is known to be so.
    study, number = active.study, found["runs"]
    study.runs.require_finished()
    state = progress_of(study)
    assert (state.planned, state.ok, state.to_do, state.results) == (number, number, 0, "current")
    with Ledger.open(study.ledger_path, model=study.model, read_only=True) as ledger:
        assert {record.key for record in ledger} == set(study.runs.needed_keys)


def test_what_was_stopped_goes_on_to_the_same_bits(active, tmp_path):
    folder = like(active, tmp_path)
    stopped_after(9, folder)
    state = progress_of(load_study(folder))
    assert (state.planned, state.ok, state.active) == (40, 9, True)
    with pytest.raises(InvalidStudy, match="the study is not finished"):
        load_study(folder).runs.require_finished()
    again, straight = run(folder), active.outcome.summary
    assert (again["runs"]["reused"], straight["runs"]["reused"]) == (9, 0)
    assert again["certificate"] == straight["certificate"]
    assert read(folder / "posterior.nc").identical(read(active.folder / "posterior.nc"))


def test_another_noise_takes_the_runs_that_there_are(active, tmp_path):
    """New runs are those of the certificate, where left-out runs do not vouch for the posterior."""
    number = active.outcome.summary["certificate"]["runs"]
    folder = like(active, tmp_path, noise={"sd": 5, "unit": "um"}, reuse=[str(active.folder)])
    again = run(folder)
    batches = again["certificate"]["batches"]
    assert batches[0] == {"kind": "given", "runs": number}
    assert again["certificate"]["converged"]
    assert again["runs"]["new"] == sum(entry["runs"] for entry in batches[1:])
    study = load_study(folder)
    study.runs.require_finished()
    assert (len(study.runs.given or []), progress_of(study).to_do) == (number, 0)
    first, last = (found["certificate"]["history"][-1] for found in (active.outcome.summary, again))
    assert last["sd"]["E"] > 1.2 * first["sd"]["E"]


@pytest.fixture(scope="module")
def cheaper(tmp_path_factory):
    softer = {"model": {"python": {"function": "tests.study.studies.exact:softer"}}, "cost": 0.2}
    content = {"design": {"active": {"runs": 40, "batch": 4}}, "noise": {"sd": 0.006}, "fidelities": [softer]}
    return finish(tmp_path_factory.mktemp("cheaper") / "study", report="none", **content)


def test_the_summary_counts_runs_of_both_models_and_other_posteriors_take_them(cheaper):
    summary = cheaper.outcome.summary
    found = summary["certificate"]["fidelities"]
    assert summary["certificate"]["converged"]
    assert found["cheaper_runs"] + found["model_runs"] == summary["runs"]["ok"] == summary["runs"]["new"]
    assert found["equivalents"] == pytest.approx(found["model_runs"] + 0.2 * found["cheaper_runs"])
    with Ledger.open(cheaper.folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert sum(is_cheaper(record.inputs) for record in ledger) == found["cheaper_runs"]
    other = load_result(cheaper.folder).with_noise(0.006**2)
    posterior = cheaper.outcome.calibration.posterior
    assert np.abs((other.posterior.mean - posterior.mean) / posterior.sd).max() < 0.1


def test_a_stopped_study_with_a_cheaper_model_goes_on_to_the_same_result(cheaper, tmp_path):
    folder = like(cheaper, tmp_path)
    stopped_after(17, folder)
    assert 0 < run(folder)["runs"]["new"] < cheaper.outcome.summary["runs"]["new"]
    one, other = (read(place / "posterior.nc")["posterior"] for place in (cheaper.folder, folder))
    np.testing.assert_array_equal(one["E"], other["E"])
