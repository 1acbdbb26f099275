"""Studies with a cheaper model: results, resume, earlier runs, bad input."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.calibration import Observer
from strandline.errors import InvalidStudy
from strandline.interface import Interface
from strandline.models.fidelities import CHEAPER, is_cheaper
from strandline.models.protocol import ForwardModel, Simulation
from strandline.posterior import read
from strandline.runs import InProcess, Ledger, Progress, RunRecord, RunRequest, attempt
from strandline.studies import Outcome, load_study, run_study
from strandline.studies.cheaper import cheaper_lines
from strandline.studies.result import load_result
from strandline.testing.studies import beam, write_study


class Softer:
    """The beam with a modulus that is too small by a tenth."""

    fingerprint = "test:softer-beam"
    inputs = beam.inputs

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation | Interface:
        return beam({**inputs, "E": 0.9 * inputs["E"]}, workdir)


softer = Softer()
FIDELITIES = [{"model": {"python": {"function": "tests.studies.test_cheaper:softer"}}, "cost": 0.2}]
STUDY: dict[str, Any] = {
    "design": {"active": {"runs": 60, "batch": 4, "check": 20}},
    "noise": {"sd": 0.006},
    "sampler": {"smc": {"particles": 400, "rejuvenation_steps": 5, "zeta": 0.5}},
    "fidelities": FIDELITIES,
}


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    """Draw fewer particles after each batch, and no figures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.design.active.sampling.PARTICLES", {2: 600})
        patch.setattr("strandline.calibration.method._sensitivity", lambda *arguments: None)
        patch.setattr("strandline.studies.run.write_report", lambda *a, folder, **o: folder / "report.html")
        yield


def run(folder: Path, observer: Observer | None = None) -> Outcome:
    return run_study(load_study(folder), executor=InProcess(), observer=observer)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return run(write_study(tmp_path_factory.mktemp("whole") / "study", **STUDY))


def test_the_summary_counts_runs_of_both_models(finished: Outcome) -> None:
    summary = finished.summary
    found = summary["certificate"]["fidelities"]
    assert summary["certificate"]["converged"]
    assert found["dropped"] is None
    assert found["cheaper_runs"] + found["model_runs"] == summary["runs"]["ok"] + summary["runs"]["failed"]
    assert found["equivalents"] == pytest.approx(found["model_runs"] + 0.2 * found["cheaper_runs"])
    assert found["error_um"] < 0.1 * found["hidden_um"]
    assert summary["runs"]["new"] == found["cheaper_runs"] + found["model_runs"]


def test_one_ledger_keeps_the_runs_of_both_models(finished: Outcome) -> None:
    folder = finished.report.parent
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        records = list(ledger)
    cheaper = [record for record in records if is_cheaper(record.inputs)]
    assert len(cheaper) == finished.summary["certificate"]["fidelities"]["cheaper_runs"]
    assert all(record.inputs[CHEAPER] == 1.0 for record in cheaper)
    assert len({record.key for record in records}) == len(records)


def test_a_stopped_study_goes_on_to_the_same_result(finished: Outcome, tmp_path: Path) -> None:
    made: list[RunRecord] = []

    class Stopped(Exception):
        pass

    def stop(record: RunRecord, progress: Progress) -> None:
        made.append(record)
        if len(made) == 17:
            raise Stopped

    folder = write_study(tmp_path / "study", **STUDY)
    with pytest.raises(Stopped):
        run(folder, Observer(run=stop))
    again = run(folder)
    assert 0 < again.summary["runs"]["new"] < finished.summary["runs"]["new"]
    one, other = (read(outcome.report.parent / "posterior.nc")["posterior"] for outcome in (finished, again))
    for name in ("E", "tilt"):
        np.testing.assert_array_equal(one[name], other[name])


def test_other_posteriors_take_the_corrected_runs(finished: Outcome) -> None:
    found = load_result(finished.report.parent).with_noise(sd=0.006)
    posterior = finished.calibration.posterior
    assert np.abs((found.posterior.mean - posterior.mean) / posterior.sd).max() < 0.1
    assert len(found.records) < len(found.all_runs)


def test_runs_without_a_cheaper_model_are_kept_when_one_is_added(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", **{**STUDY, "fidelities": None})
    before = run(folder)
    write_study(folder, **{**STUDY, "noise": {"sd": 0.005}})
    after = run(folder)
    kept = before.summary["runs"]["new"] - 1  # without the synthetic observation
    assert after.summary["runs"]["reused"] >= kept
    assert after.summary["certificate"]["fidelities"]["model_runs"] >= kept


def test_a_check_compares_the_two_models(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path / "study", **STUDY))
    inputs = {"E": 400.0, "tilt": 0.02, "load": 1e-5}

    def make(model: ForwardModel, inputs: Mapping[str, float]) -> RunRecord:
        return replace(attempt(model, RunRequest("", inputs), tmp_path), seconds=0.5 if is_cheaper(inputs) else 2.0)

    (line,) = cheaper_lines(study.model, make(study.model, inputs), make)
    off = 1e3 * np.ptp(softer(inputs, tmp_path).interface.points - beam(inputs, tmp_path).interface.points)  # type: ignore[union-attr]
    assert "ok in 0.5 s, 0.25 of the time (stated cost 0.2)" in line
    assert float(line.split("at most ")[1].split(" µm")[0]) == pytest.approx(off, rel=0.1)
    assert list(cheaper_lines(beam, make(beam, inputs), make)) == []

    def in_micrometres(model: ForwardModel, inputs: Mapping[str, float]) -> RunRecord:
        """The planted mistake: the cheaper model's result has another unit."""
        made = make(model, inputs)
        return replace(made, interfaces={"": Interface.polyline(1e3 * made.interface.points)})  # type: ignore[union-attr]

    warning, _ = cheaper_lines(study.model, make(study.model, inputs), in_micrometres)
    assert warning.startswith("warning: the interface of the cheaper model is off by")
    assert "another unit" in warning


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fidelities": "coarse"}, "fidelities: got coarse; expected a list with one cheaper model"),
        ({"fidelities": [{"cost": 0.1}]}, "fidelities: the cheaper model: got the model itself"),
        ({"fidelities": [{**FIDELITIES[0], "cost": 2}]}, "above 0 and below 1"),
        ({"fidelities": [{**FIDELITIES[0], "cost": "low"}]}, "fidelities.cost: got 'low'"),
        ({"fidelities": [{**FIDELITIES[0], "function": "a:b"}]}, "only `cost` beside it"),
        ({"fidelities": [{"model": 3}]}, "fidelities.model: got 3"),
        ({"fidelities": ["coarse"]}, "only a model with meshes has names for them"),
        ({"fidelities": ["coarse"]}, "function: .own_model:cheaper"),
        ({"fidelities": FIDELITIES * 2}, "exactly one entry"),
        ({"design": {"sobol": {"runs": 30}}}, "a cheaper model without an active design"),
    ],
)
def test_bad_fidelities_are_refused(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", **{**STUDY, **changes})
    with pytest.raises(InvalidStudy, match=message):
        load_study(folder)
