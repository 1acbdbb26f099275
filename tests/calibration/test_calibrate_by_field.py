"""The whole method by a surrogate of the field, on a beam whose posterior is known by quadrature."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import softmax

from strandline.calibration import Calibration, Observer, Problem, Settings, calibrate
from strandline.design.active import Active
from strandline.discrepancy import Currents, Discrepancy, TrackedPoints
from strandline.errors import ForwardModelError
from strandline.interface import Interface, Observation
from strandline.models.protocol import Simulation
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.runs import InProcess, Ledger
from strandline.smc import SMCSettings
from strandline.testing.studies import beam

TRUTH = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
NOISE = 0.006
SPACE = ParameterSpace((Parameter("E", Uniform(200.0, 800.0), "Pa"), Parameter("tilt", Uniform(-0.05, 0.1))))
SETTINGS = Settings(
    runs=8,
    particles=2000,
    smc=SMCSettings(rejuvenation_steps=6, zeta=0.5),
    surrogate="field",
    active=Active(80, batch=4),
)


def problem(*, model: Any = beam, noise: float = NOISE, measure: Discrepancy | None = None) -> Problem:
    observation = Observation(beam(TRUTH, Path()).interface, noise**2)
    return Problem(model, SPACE, {"load": 1e-5}, (observation,), {"measure": measure or TrackedPoints()})


def answer(path: Path, asked: Problem | None = None, settings: Settings = SETTINGS, **options: Any) -> Calibration:
    asked = asked or problem()
    with Ledger.open(path, model=asked.model) as ledger:
        return calibrate(asked, settings, ledger=ledger, executor=InProcess(), **options)


def exact(asked: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of E and the tilt by a sum over a grid, one run a point."""
    (measure,), (seen,) = asked.discrepancies.values(), asked.observations
    E, tilt = np.linspace(200.0, 800.0, 241), np.linspace(-0.05, 0.1, 161)
    x, shape = np.linspace(0.0, 1.0, 17), np.linspace(0.0, 1.0, 17) ** 2 * (3 - np.linspace(0.0, 1.0, 17))
    y = 20.0 / E[:, None, None] * shape + tilt[None, :, None] * x
    if isinstance(measure, TrackedPoints):
        squares = np.sum((y - seen.interface.points[:, 1]) ** 2, axis=2)
    else:
        some = (slice(None, None, 4), slice(None, None, 4))
        E, tilt, y = E[some[0]], tilt[some[1]], y[some]
        flat = y.reshape(-1, 17)
        squares = np.array([measure(Interface.polyline(np.stack([x, row], axis=1)), seen.interface) for row in flat])
        squares = squares.reshape(len(E), len(tilt))
    weights = np.exp(-0.5 * (squares - squares.min()) / seen.noise.scale)
    weights /= weights.sum()
    points = np.stack(np.meshgrid(E, tilt, indexing="ij"), axis=-1)
    mean = np.einsum("ab,abk->k", weights, points)
    return mean, np.sqrt(np.einsum("ab,abk->k", weights, (points - mean) ** 2))


def off(found: Calibration, asked: Problem | None = None) -> tuple[float, float]:
    """Return the largest error of a mean, in standard deviations, and of a standard deviation, relative."""
    mean, sd = exact(asked or found.problem)
    posterior = found.posterior
    return float((np.abs(posterior.mean - mean) / sd).max()), float(np.abs(posterior.sd / sd - 1).max())


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    """Draw fewer particles after each batch; leave out what is only told beside the posterior."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.design.active.sampling.PARTICLES", {2: 600})
        patch.setattr("strandline.calibration.method._sensitivity", lambda *arguments: None)
        patch.setattr("strandline.calibration.learning._to_compare", lambda *arguments: {})
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("by-field")


@pytest.fixture(scope="module")
def found(folder: Path) -> Calibration:
    return answer(folder / "ledger.sqlite")


def same(one: Calibration, other: Calibration) -> bool:
    return all(
        np.array_equal(getattr(one.posterior, name), getattr(other.posterior, name))
        for name in ("draws", "log_weights", "log_likelihood")
    ) and [r.key for r in one.records] == [r.key for r in other.records]


def test_the_posterior_is_exact_and_certified(found: Calibration) -> None:
    mean_error, sd_error = off(found)
    assert mean_error < 0.1
    assert sd_error < 0.08
    assert found.field is not None
    certificate = found.field.certificate
    assert certificate is not None
    assert certificate.converged
    assert certificate.checked is not None
    assert len(found.records) < 60
    assert found.field.feasible == pytest.approx(1.0)
    assert np.abs(found.field.effect.shift).max() < 0.05
    assert found.quadrature is None


def test_a_planted_bug_shows(found: Calibration) -> None:
    """The exact posterior of a noise variance twice as large."""
    mean_error, sd_error = off(found, problem(noise=NOISE * np.sqrt(2.0)))
    assert max(mean_error, sd_error) > 0.2


@pytest.mark.long
def test_currents_are_calibrated_by_too(folder: Path) -> None:
    asked = problem(noise=0.02, measure=Currents(0.05))
    found = answer(folder / "currents.sqlite", asked)
    mean_error, sd_error = off(found)
    assert mean_error < 0.1
    assert sd_error < 0.1


@pytest.mark.long
def test_the_same_arguments_give_the_same_bits(found: Calibration, tmp_path: Path) -> None:
    assert same(answer(tmp_path / "again.sqlite"), found)


@pytest.mark.long
def test_another_seed_gives_other_draws_of_the_same_posterior(found: Calibration, tmp_path: Path) -> None:
    other = answer(tmp_path / "other.sqlite", settings=replace(SETTINGS, seed=2))
    assert not same(other, found)
    assert off(other)[0] < 0.1


class Stopped(Exception):
    """The driver is stopped."""


@pytest.mark.long
def test_what_was_stopped_goes_on_to_the_same_bits(found: Calibration, tmp_path: Path) -> None:
    runs: list[Any] = []

    def stop(record: Any, progress: Any) -> None:
        runs.append(record)
        if len(runs) == 9:
            raise Stopped

    with pytest.raises(Stopped):
        answer(tmp_path / "stopped.sqlite", observer=Observer(run=stop))
    runs.clear()
    other = answer(tmp_path / "stopped.sqlite", observer=Observer(run=lambda record, progress: runs.append(record)))
    assert len(runs) == len(found.records) - 9
    assert same(other, found)


@dataclass(frozen=True)
class Capricious:
    """`beam`, a share of whose runs fail by the digits of E."""

    share: float = 0.2

    @property
    def fingerprint(self) -> str:
        return f"test:capricious/{self.share!r}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Any:
        if (inputs["E"] * 7919.0) % 1.0 < self.share:
            raise ForwardModelError("newton_stalled", "no convergence")
        return beam(inputs, workdir)


def test_runs_that_fail_at_random_are_gone_round(tmp_path: Path) -> None:
    found = answer(tmp_path / "ledger.sqlite", problem(model=Capricious()))
    failed = sum(not record.ok for record in found.records)
    assert 0.05 < failed / len(found.records) < 0.4
    mean_error, sd_error = off(found)
    assert mean_error < 0.1
    assert sd_error < 0.1
    assert found.field is not None
    assert found.field.certificate is not None
    assert found.field.certificate.converged
    assert found.field.feasible > 0.8


@pytest.mark.long
def test_a_fixed_design_has_no_certificate(tmp_path: Path) -> None:
    found = answer(tmp_path / "ledger.sqlite", settings=replace(SETTINGS, runs=24, active=None))
    assert len(found.records) == 24
    assert found.field is not None
    assert found.field.certificate is None
    assert off(found)[0] < 0.1


@pytest.mark.long
def test_given_runs_take_the_place_of_a_design(found: Calibration, folder: Path) -> None:
    """Another noise of the same runs, enough of which lie inside the posterior: no new ones."""
    runs: list[Any] = []
    own = np.array([[record.inputs[name] for name in SPACE.names] for record in found.records])
    more = own.mean(axis=0) + 0.5 * (own[:40] - own.mean(axis=0))
    given, observer = np.concatenate([own, more]), Observer(run=lambda record, progress: runs.append(record))
    answer(folder / "ledger.sqlite", problem(), given=given, observer=observer)
    assert len(runs) >= len(more)
    runs.clear()
    asked = problem(noise=2 * NOISE)
    other = answer(folder / "ledger.sqlite", asked, given=given, observer=observer)
    assert off(other)[0] < 0.1
    assert other.field is not None
    assert other.field.certificate is not None
    assert other.field.certificate.batches[0].kind == "given"
    assert other.field.certificate.converged
    assert runs == []


class Bent:
    """A line that no few runs make known: its displacement turns over along the first input."""

    fingerprint = "test:bent"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        s = np.linspace(0.0, 1.0, 9)
        y = 0.1 * (np.sin(3 * inputs["a"]) * s + inputs["b"] * s**2 + np.cos(2 * inputs["a"] + inputs["b"]))
        return Simulation.of(Interface.polyline(np.stack([s, y], axis=1)))


def test_what_uncertainty_of_the_field_does_is_told(tmp_path: Path) -> None:
    """From seven runs the expected likelihood is not the plug-in one, which weights of the same draws lead to."""
    model, space = Bent(), ParameterSpace(tuple(Parameter(name, Uniform(-1.0, 1.0)) for name in "ab"))
    seen = Observation(model({"a": 0.2, "b": 0.1}, tmp_path).interfaces[""], 0.02**2)
    asked = Problem(model, space, {}, (seen,), {"tracked": TrackedPoints()})
    found = answer(tmp_path / "ledger.sqlite", asked, replace(SETTINGS, runs=7, active=None))
    assert found.field is not None
    effect, sampled = found.field.effect, found.sampling
    exact = found.field.knowledge.plug_in(sampled.positions)
    plain = softmax(sampled.log_weights + exact - sampled.log_likelihood) @ sampled.positions
    np.testing.assert_allclose(effect.shift * found.posterior.sd, found.posterior.mean - plain, atol=1e-9)
    assert np.abs(np.log(effect.sd_ratio)).max() > 0.02
    assert effect.effective < 0.995
    exact = found.field.knowledge.expected(found.posterior.draws[:20])
    np.testing.assert_allclose(found.posterior.log_likelihood[:20], exact, rtol=1e-8, atol=1e-8)
