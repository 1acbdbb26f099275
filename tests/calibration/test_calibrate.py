"""The whole method, on a beam whose posterior is known."""

import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp

from strandline.calibration import Calibration, Observer, Problem, Settings, calibrate
from strandline.calibration.targets import quadrature
from strandline.discrepancy import ClosestPoint, TrackedPoints
from strandline.errors import ForwardModelError, InvalidInput, TooFewRuns
from strandline.interface import Observation
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.runs import InProcess, Ledger, RunRecord, RunRequest
from strandline.smc import SMCSettings
from strandline.testing.models import TwoLoads
from strandline.testing.studies import beam

TRUTH = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
NOISE = 0.003
SETTINGS = Settings(runs=24, particles=2000, smc=SMCSettings(rejuvenation_steps=5, zeta=0.6))


def problem(*, noise: float = NOISE, measures: Any = None) -> Problem:
    observation = Observation(beam(TRUTH, Path()).interface, noise**2)
    space = ParameterSpace((Parameter("E", Uniform(300.0, 560.0), "Pa"),))
    fixed = {"tilt": 0.02, "load": 1e-5}
    return Problem(beam, space, fixed, (observation,), measures or {"tracked": TrackedPoints()})


def answer(asked: Problem, path: Path, settings: Settings = SETTINGS, **options: Any) -> Calibration:
    options.setdefault("executor", InProcess())
    with Ledger.open(path, model=asked.model) as ledger:
        return calibrate(asked, settings, ledger=ledger, **options)


def exact(noise: float) -> tuple[float, float, float]:
    """Return mean, standard deviation and log-evidence for E by a fine sum over the model's closed form."""
    E = np.linspace(300.0, 560.0, 20001)
    x = np.linspace(0.0, 1.0, 17)
    y = 20.0 / E[:, None] * x**2 * (3 - x)
    log_likelihood = -0.5 * np.sum((y - 0.05 * x**2 * (3 - x)) ** 2, axis=1) / noise**2
    weights = np.exp(log_likelihood - logsumexp(log_likelihood))
    mean = weights @ E
    return float(mean), float(np.sqrt(weights @ (E - mean) ** 2)), float(logsumexp(log_likelihood) - np.log(len(E)))


def differences(found: Calibration, noise: float) -> tuple[float, float, float]:
    """Return the errors of the mean (in sd), of the sd (relative) and of the log-evidence."""
    mean, sd, evidence = exact(noise)
    posterior = found.posterior
    return (
        abs(float(posterior.mean[0]) - mean) / sd,
        abs(float(posterior.sd[0]) / sd - 1),
        abs(posterior.log_evidence - evidence),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("calibrate")


@pytest.fixture(scope="module")
def found(folder: Path) -> Calibration:
    """Two measures; the first one makes the posterior."""
    return answer(problem(measures={"tracked": TrackedPoints(), "closest": ClosestPoint()}), folder / "ledger.sqlite")


def test_the_posterior_is_exact(found: Calibration) -> None:
    mean_error, sd_error, evidence_error = differences(found, NOISE)
    assert mean_error < 0.1
    assert sd_error < 0.06
    assert evidence_error < 0.1


def test_a_planted_bug_shows(folder: Path) -> None:
    """σ_N² taken as twice what it is."""
    wrong = answer(problem(noise=NOISE * np.sqrt(2.0)), folder / "ledger.sqlite")
    _, sd_error, evidence_error = differences(wrong, NOISE)
    assert sd_error > 0.3
    assert evidence_error > 0.25


def test_the_quadrature_agrees_with_the_sampler(found: Calibration) -> None:
    assert found.quadrature is not None
    assert found.quadrature.converged
    assert abs(found.posterior.mean[0] - found.quadrature.mean[0]) < 0.1 * found.quadrature.sd[0]
    assert found.posterior.sd[0] == pytest.approx(found.quadrature.sd[0], rel=0.06)


def test_each_measure_has_its_surrogate_and_the_first_makes_the_posterior(found: Calibration) -> None:
    assert list(found.surrogates) == ["tracked", "closest"]
    assert found.surrogate is found.surrogates["tracked"]
    at = found.posterior.draws[:50]
    np.testing.assert_allclose(
        np.asarray(found.surrogates["tracked"].process.mean(at)),
        found.posterior.log_likelihood[:50],
        rtol=1e-6,
        atol=1e-6,
    )
    assert not np.array_equal(found.log_likelihoods["tracked"], found.log_likelihoods["closest"])


def test_log_likelihoods_are_those_of_the_runs(found: Calibration) -> None:
    E, values = found.training[:, 0], found.log_likelihoods["tracked"]
    x = np.linspace(0.0, 1.0, 17)
    expected = [-0.5 * np.sum(((20 / e - 0.05) * x**2 * (3 - x)) ** 2) / NOISE**2 for e in E]
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-12)


class Backwards:
    """Makes all runs and hands their records over in reverse."""

    def __call__(self, model: Any, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        yield from reversed(list(InProcess()(model, requests)))


def test_same_bits_whatever_the_order_of_the_runs(found: Calibration, tmp_path: Path) -> None:
    other = answer(found.problem, tmp_path / "ledger.sqlite", executor=Backwards())
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
    settings = replace(SETTINGS, seed=2)
    other = answer(found.problem, folder / "ledger.sqlite", settings, observer=observer)
    assert runs == []
    assert stages == ["forward", "surrogate", "sampling", "check"] == list(other.seconds)
    assert temperatures == sorted(temperatures)
    assert temperatures[-1] == 1.0
    assert not np.array_equal(other.posterior.draws, found.posterior.draws)
    assert abs(other.posterior.mean[0] - found.posterior.mean[0]) < 0.15 * found.posterior.sd[0]


class HalfBeam:
    """The beam, failing above 430 Pa."""

    fingerprint = "test:half-beam"

    def __call__(self, inputs: Any, workdir: Path) -> Any:
        if inputs["E"] > 430:
            raise ForwardModelError("stalled", "above 430 Pa")
        return beam(inputs, workdir)


def test_failed_runs_are_kept_and_left_out_of_the_training(tmp_path: Path) -> None:
    asked = replace(problem(), model=HalfBeam())
    found = answer(asked, tmp_path / "ledger.sqlite", replace(SETTINGS, runs=16, particles=50))
    failed = [record for record in found.records if not record.ok]
    assert len(found.records) == 16
    assert 0 < len(failed) < 16
    assert all(record.inputs["E"] > 430 for record in failed)
    kept = [record.inputs["E"] for record in found.records if record.ok]
    np.testing.assert_array_equal(found.training[:, 0], kept)


@pytest.mark.parametrize(("runs", "message"), [(1, "too few"), (2, "too few")])
def test_too_few_runs(tmp_path: Path, runs: int, message: str) -> None:
    with pytest.raises(TooFewRuns, match=f"{message} successful forward runs: got {runs} of {runs}") as caught:
        answer(problem(), tmp_path / "ledger.sqlite", replace(SETTINGS, runs=runs))
    assert "at least 3" in caught.value.expected


def test_all_runs_failed(tmp_path: Path) -> None:
    asked = replace(problem(), fixed={"tilt": 0.02, "load": 1.0})
    with pytest.raises(
        TooFewRuns, match=r"every forward run failed: got 0 of 4 \(4 × large_deflection; e\.g\. the tip"
    ):
        answer(asked, tmp_path / "ledger.sqlite", replace(SETTINGS, runs=4))


VARIANCES = {"light": 0.01**2, "heavy": 0.02**2}


def two_loads(*conditions: str) -> Problem:
    """Two experiments of one beam; the heavy load says more, its noise is larger."""
    seen = TwoLoads()({"E": 400.0, "load": 1e-5}, Path()).interfaces
    observations = tuple(Observation(seen[name], VARIANCES[name], name) for name in conditions)
    space = ParameterSpace((Parameter("E", Uniform(300.0, 560.0), "Pa"),))
    return Problem(TwoLoads(), space, {"load": 1e-5}, observations, {"tracked": TrackedPoints()})


def exact_two_loads(*conditions: str) -> tuple[float, float, float]:
    """Return mean, standard deviation and log-evidence for E: the displacement is that at 400 Pa times 400/E."""
    E = np.linspace(300.0, 560.0, 20001)
    model = TwoLoads()
    rest = model({"E": 400.0, "load": 0.0}, Path()).interfaces
    seen = model({"E": 400.0, "load": 1e-5}, Path()).interfaces
    squares = {name: np.sum((seen[name].points - rest[name].points) ** 2) for name in conditions}
    log_likelihood = sum(-0.5 * (400.0 / E - 1.0) ** 2 * squares[name] / VARIANCES[name] for name in conditions)
    weights = np.exp(log_likelihood - logsumexp(log_likelihood))
    mean = float(weights @ E)
    return mean, float(np.sqrt(weights @ (E - mean) ** 2)), float(logsumexp(log_likelihood) - np.log(len(E)))


def errors_of_two_loads(found: Calibration) -> tuple[float, float, float]:
    mean, sd, evidence = exact_two_loads("light", "heavy")
    posterior = found.posterior
    return (
        abs(float(posterior.mean[0]) - mean) / sd,
        abs(float(posterior.sd[0]) / sd - 1),
        abs(posterior.log_evidence - evidence),
    )


def test_two_conditions_give_the_product_of_their_likelihoods(folder: Path) -> None:
    ledger = folder / "two-loads.sqlite"
    both = answer(two_loads("light", "heavy"), ledger)
    mean_error, sd_error, evidence_error = errors_of_two_loads(both)
    assert mean_error < 0.1
    assert sd_error < 0.06
    assert evidence_error < 0.1
    alone = {name: answer(two_loads(name), ledger) for name in VARIANCES}
    for name, found in alone.items():
        assert float(found.posterior.sd[0]) == pytest.approx(exact_two_loads(name)[1], rel=0.06)
        assert float(both.posterior.sd[0]) < 0.85 * float(found.posterior.sd[0])
    total = sum(found.log_likelihoods["tracked"] for found in alone.values())
    np.testing.assert_allclose(both.log_likelihoods["tracked"], total, rtol=1e-12)


def test_a_condition_that_is_ignored_shows(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bugs: the second condition is left out; or the first one's interface stands in for both."""
    from strandline.likelihood import InterfaceLikelihood

    ledger, whole, matched = (
        folder / "two-loads.sqlite",
        InterfaceLikelihood.discrepancies,
        InterfaceLikelihood._matched,
    )
    with monkeypatch.context() as planted:
        planted.setattr(InterfaceLikelihood, "discrepancies", lambda self, i: whole(self, i) * np.array([1.0, 0.0]))
        _, sd_error, evidence_error = errors_of_two_loads(answer(two_loads("light", "heavy"), ledger))
        assert sd_error > 0.2
        assert evidence_error > 0.2
    monkeypatch.setattr(
        InterfaceLikelihood, "_matched", lambda self, i: dict.fromkeys(matched(self, i), next(iter(i.values())))
    )
    mean_error, _, _ = errors_of_two_loads(answer(two_loads("light", "heavy"), ledger))
    assert mean_error > 1.0


def test_an_observed_condition_that_the_model_lacks_is_refused_before_any_run(tmp_path: Path) -> None:
    asked = two_loads("light")
    wrong = replace(asked, observations=(replace(asked.observations[0], condition="lite"),))
    with pytest.raises(InvalidInput, match="got lite; expected one of light, heavy"):
        answer(wrong, tmp_path / "ledger.sqlite")
    with Ledger.open(tmp_path / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().total == 0


def test_above_three_inputs_there_is_no_quadrature() -> None:
    def never(x: Any) -> Any:
        raise AssertionError("evaluated")

    space = ParameterSpace(tuple(Parameter(name, Uniform(0.0, 1.0)) for name in "abcd"))
    assert quadrature(space, never) is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"space": ("E",)}, "inputs of the problem: got tuple.*a ParameterSpace"),
        ({"observations": None}, "observations of the problem: got NoneType.*a tuple of Observations"),
        ({"observations": ({"points": []},)}, "observations of the problem: got tuple"),
        ({"discrepancies": TrackedPoints()}, "measures of the problem: got TrackedPoints.*by name"),
        ({"fixed": [1.0]}, "known inputs of the problem: got list"),
        ({"model": "beam"}, "model of the problem: got str"),
    ],
)
def test_a_problem_of_other_things_is_refused_in_one_line(changes: dict[str, Any], words: str) -> None:
    program = f"""
import sys
from strandline.calibration import Problem
from strandline.discrepancy import TrackedPoints
from strandline.errors import InvalidInput
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
usual = dict(model=print, space=ParameterSpace((Parameter("E", Uniform(0.0, 1.0)),)), fixed={{}}, observations=(),
             discrepancies={{}})
try:
    Problem(**usual | {changes!r})
except InvalidInput as error:
    print(error)
    sys.exit(2)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ended.returncode == 2, ended.stderr
    (line,) = ended.stdout.splitlines()
    assert re.search(words, line)


def test_a_ledger_may_be_a_path_or_nothing(tmp_path: Path) -> None:
    asked = problem()
    settings = replace(SETTINGS, runs=12, particles=300)
    kept = calibrate(asked, settings, ledger=str(tmp_path / "kept.sqlite"))
    forgotten = calibrate(asked, settings)
    np.testing.assert_array_equal(kept.posterior.draws, forgotten.posterior.draws)
    with Ledger.open(tmp_path / "kept.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().total == 12
