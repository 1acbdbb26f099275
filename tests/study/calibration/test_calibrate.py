"""The whole method, on a beam whose posterior is known."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.study.calibration.beams import NOISE, ONE, SETTINGS, X, answer, exact, learnt, problem, summed

from strandline.calibration import Calibration, Observer, Problem, calibrate
from strandline.calibration.in_notebook import cell_observer, observer_or_default
from strandline.discrepancy import ClosestPoint, TrackedPoints
from strandline.errors import ForwardModelError, InvalidInput, TooFewRuns
from strandline.interface import Interface, Observation
from strandline.runs import InProcess, Ledger, RunRecord, RunRequest
from strandline.testing.models import TwoLoads
from strandline.testing.studies import beam

SHOWN: list[str] = []
"""What a notebook shows below its cell, from step to step."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("calibrate")


@pytest.fixture(scope="module")
def found(folder: Path) -> Calibration:
    """Two measures; the first one makes the posterior."""
    asked = problem(space=ONE, noise=NOISE / 2, closest=ClosestPoint())
    return answer(folder / "ledger.sqlite", asked, SETTINGS, observer=cell_observer(SHOWN.append))


def test_the_posterior_is_exact_and_the_quadrature_agrees(found: Calibration) -> None:
    """Planted: σ_N² taken as twice what it is."""
    mean_error, sd_error, evidence_error = exact(ONE, NOISE / 2).off(found)
    assert mean_error < 0.12
    assert sd_error < 0.07
    assert evidence_error < 0.1
    _, sd_error, evidence_error = exact(ONE, NOISE / np.sqrt(2.0)).off(found)
    assert sd_error > 0.2
    assert evidence_error > 0.25
    assert found.quadrature is not None
    assert found.quadrature.converged
    assert abs(found.posterior.mean[0] - found.quadrature.mean[0]) < 0.12 * found.quadrature.sd[0]
    assert found.posterior.sd[0] == pytest.approx(found.quadrature.sd[0], rel=0.07)


def test_each_measure_has_its_surrogate_and_the_first_makes_the_posterior(found: Calibration) -> None:
    assert list(found.surrogates) == ["tracked", "closest"]
    assert found.surrogate is found.surrogates["tracked"]
    predicted = np.asarray(found.surrogate.process.mean(found.posterior.draws[:50]))
    np.testing.assert_allclose(predicted, found.posterior.log_likelihood[:50], rtol=1e-6, atol=1e-6)
    assert not np.array_equal(found.log_likelihoods["tracked"], found.log_likelihoods["closest"])
    squares = [np.sum(((20 / E - 0.05) * X**2 * (3 - X)) ** 2) for E in found.training[:, 0]]
    expected = -0.5 * np.array(squares) / (NOISE / 2) ** 2
    np.testing.assert_allclose(found.log_likelihoods["tracked"], expected, rtol=1e-9, atol=1e-12)


def test_a_notebook_shows_the_stages_and_how_far_each_has_got(found: Calibration) -> None:
    last = re.sub(r"<[^>]+>", "\n", SHOWN[-1])
    assert "forward runs 32/32: 32 ok, 0 failed" in last
    assert re.search(r"sampling tempering exponent 1\.0000, ESS \d+, accepted \d+%", last)
    assert len(SHOWN) > 34
    shown: list[str] = []
    observer = cell_observer(shown.append)
    observer.note("before any stage")
    assert shown == []
    observer.stage("forward")
    observer.note("<b>bold</b>")
    assert "&lt;b&gt;bold&lt;/b&gt;" in shown[-1]
    own = Observer()
    assert observer_or_default(own) is own
    observer_or_default(None).note("nothing happens outside a notebook")


class Backwards:
    """Makes all runs and hands their records over in reverse."""

    def __call__(self, model: Any, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        yield from reversed(list(InProcess()(model, requests)))


def test_same_bits_whatever_the_order_of_the_runs_and_without_a_ledger(found: Calibration) -> None:
    other = calibrate(found.problem, SETTINGS, executor=Backwards())
    np.testing.assert_array_equal(other.posterior.draws, found.posterior.draws)
    np.testing.assert_array_equal(other.posterior.log_weights, found.posterior.log_weights)
    assert other.posterior.log_evidence == found.posterior.log_evidence


def test_another_seed_gives_other_particles_of_the_same_runs(found: Calibration, folder: Path) -> None:
    runs: list[RunRecord] = []
    stages: list[str] = []
    temperatures: list[float] = []
    observer = Observer(
        stage=stages.append,
        run=lambda record, progress: runs.append(record),
        step=lambda info: temperatures.append(float(info.temperature)),
    )
    settings, path = replace(SETTINGS, seed=2), folder / "ledger.sqlite"
    other = calibrate(found.problem, settings, ledger=str(path), observer=observer)
    assert runs == []
    assert stages == ["forward", "surrogate", "sampling", "check"] == list(other.seconds)
    assert temperatures == sorted(temperatures)
    assert temperatures[-1] == 1.0
    assert not np.array_equal(other.posterior.draws, found.posterior.draws)
    assert abs(other.posterior.mean[0] - found.posterior.mean[0]) < 0.15 * found.posterior.sd[0]
    with Ledger.open(path, model=None, read_only=True) as ledger:
        assert ledger.counts().total == 32


def test_every_calibration_says_whether_the_model_explains_the_observation(found: Calibration) -> None:
    """Planted: a wave that no stiffness causes."""
    (seen,) = found.problem.observations
    bent = seen.interface.points + np.stack([0 * X, 0.03 * X * np.sin(3 * np.pi * X)], axis=1)
    observations = (replace(seen, interface=Interface.polyline(bent)),)
    right, wrong = found, calibrate(replace(found.problem, observations=observations), SETTINGS)
    assert right.misfit is not None
    assert wrong.misfit is not None
    assert (right.misfit.flagged, wrong.misfit.flagged) == (False, True)
    assert repr(wrong.misfit).startswith("<Misfit The model does not explain the observation")
    assert len(right.misfit.conditions[0].residual) == 17
    assert any("best runs" in note for note in right.misfit.notes)
    assert "a wrong value of tilt, load" in right.misfit.notes[-1]


def half_beam(inputs: Any, workdir: Path) -> Any:
    """Return the beam, failing above 430 Pa."""
    if inputs["E"] > 430:
        raise ForwardModelError("stalled", "above 430 Pa")
    return beam(inputs, workdir)


def test_failed_runs_are_kept_and_left_out_of_the_training(tmp_path: Path) -> None:
    found = learnt(tmp_path, problem(space=ONE, model=half_beam), SETTINGS).learnt
    failed = [record for record in found.records if not record.ok]
    assert len(found.records) == 32
    assert 0 < len(failed) < 32
    assert all(record.inputs["E"] > 430 for record in failed)
    kept = [record.inputs["E"] for record in found.records if record.ok]
    np.testing.assert_array_equal(found.training[:, 0], kept)


def test_too_few_runs_are_refused(tmp_path: Path) -> None:
    for runs in (1, 2):
        with pytest.raises(TooFewRuns, match=f"too few successful forward runs: got {runs} of {runs}") as caught:
            learnt(tmp_path, problem(space=ONE), replace(SETTINGS, runs=runs))
        assert "at least 3" in caught.value.expected
    asked = replace(problem(space=ONE), fixed={"tilt": 0.02, "load": 1.0})
    said = r"every forward run failed: got 0 of 4 \(4 × large_deflection; e\.g\. the tip"
    with pytest.raises(TooFewRuns, match=said):
        learnt(tmp_path, asked, replace(SETTINGS, runs=4))


VARIANCES = {"light": 0.01**2, "heavy": 0.02**2}


def two_loads(*conditions: str) -> Problem:
    """Two experiments of one beam; the heavy load says more, its noise is larger."""
    seen = TwoLoads()({"E": 400.0, "load": 1e-5}, Path()).interfaces
    observations = tuple(Observation(seen[name], VARIANCES[name], name) for name in conditions)
    return Problem(TwoLoads(), ONE, {"load": 1e-5}, observations, {"tracked": TrackedPoints()})


def log_likelihoods_of_two_loads(E: np.ndarray, *conditions: str) -> np.ndarray:
    """Return log L of E: the displacement is that at 400 Pa times 400/E."""
    rest, seen = (TwoLoads()({"E": 400.0, "load": load}, Path()).interfaces for load in (0.0, 1e-5))
    squares = sum(np.sum((seen[name].points - rest[name].points) ** 2) / VARIANCES[name] for name in conditions)
    return np.asarray(-0.5 * (400.0 / E - 1.0) ** 2 * squares)


def test_two_conditions_give_the_product_of_their_likelihoods(tmp_path: Path) -> None:
    """Planted: one of the conditions is left out; the one's interface stands in for the other's."""
    found = answer(tmp_path / "ledger.sqlite", two_loads("light", "heavy"), SETTINGS)
    E = np.linspace(300.0, 560.0, 20001)
    mean_error, sd_error, evidence_error = summed(E[:, None], log_likelihoods_of_two_loads(E, "light", "heavy")).off(
        found
    )
    assert mean_error < 0.12
    assert sd_error < 0.07
    assert evidence_error < 0.1
    for alone in VARIANCES:
        assert summed(E[:, None], log_likelihoods_of_two_loads(E, alone)).off(found)[1] > 0.15
    expected = log_likelihoods_of_two_loads(found.training[:, 0], "light", "heavy")
    np.testing.assert_allclose(found.log_likelihoods["tracked"], expected, rtol=1e-9, atol=1e-12)


def test_an_observed_condition_that_the_model_lacks_is_refused_before_any_run(tmp_path: Path) -> None:
    asked = two_loads("light")
    wrong = replace(asked, observations=(replace(asked.observations[0], condition="lite"),))
    with pytest.raises(InvalidInput, match="got lite; expected one of light, heavy"):
        answer(tmp_path / "ledger.sqlite", wrong, SETTINGS)
    with Ledger.open(tmp_path / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().total == 0
