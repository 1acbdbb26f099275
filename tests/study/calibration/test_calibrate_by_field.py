"""The whole method by a surrogate of the field, on a beam whose posterior is known by quadrature."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import softmax
from tests.study.calibration.beams import ACTIVE, NOISE, TWO, X, answer, exact, problem, summed

from strandline.calibration import Calibration, Observer, Problem
from strandline.discrepancy import Currents, TrackedPoints
from strandline.errors import ForwardModelError
from strandline.interface import Interface, Observation
from strandline.models.protocol import Simulation
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.testing.studies import beam


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("by-field")


@pytest.fixture(scope="module")
def found(folder: Path) -> Calibration:
    return answer(folder / "ledger.sqlite", problem())


def same(one: Calibration, other: Calibration) -> bool:
    return all(
        np.array_equal(getattr(one.posterior, name), getattr(other.posterior, name))
        for name in ("draws", "log_weights", "log_likelihood")
    ) and [r.key for r in one.records] == [r.key for r in other.records]


def test_the_posterior_is_exact_and_certified(found: Calibration) -> None:
    """Planted: a noise variance twice as large."""
    mean_error, sd_error, _ = exact().off(found)
    assert mean_error < 0.12
    assert sd_error < 0.1
    assert max(exact(noise=NOISE * np.sqrt(2.0)).off(found)[:2]) > 0.2
    assert found.field is not None
    certificate = found.field.certificate
    assert certificate is not None
    assert certificate.converged
    assert certificate.checked is not None
    assert len(found.records) < 60
    assert found.field.feasible == pytest.approx(1.0)
    assert np.abs(found.field.effect.shift).max() < 0.05
    assert found.quadrature is None


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
    mean_error, sd_error, _ = exact().off(found)
    assert mean_error < 0.12
    assert sd_error < 0.1
    assert found.field is not None
    assert found.field.certificate is not None
    assert found.field.certificate.converged
    assert found.field.feasible > 0.8


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
    found = answer(tmp_path / "ledger.sqlite", asked, replace(ACTIVE, runs=7, active=None))
    assert found.field is not None
    assert found.field.certificate is None
    effect, sampled = found.field.effect, found.sampling
    plug_in = found.field.knowledge.plug_in(sampled.positions)
    plain = softmax(sampled.log_weights + plug_in - sampled.log_likelihood) @ sampled.positions
    np.testing.assert_allclose(effect.shift * found.posterior.sd, found.posterior.mean - plain, atol=1e-9)
    assert np.abs(np.log(effect.sd_ratio)).max() > 0.02
    assert effect.effective < 0.995
    expected = found.field.knowledge.expected(found.posterior.draws[:20])
    np.testing.assert_allclose(found.posterior.log_likelihood[:20], expected, rtol=1e-8, atol=1e-8)


@pytest.mark.long
def test_currents_are_calibrated_by_too(tmp_path: Path) -> None:
    measure, points = Currents(0.05), np.stack(np.meshgrid(np.linspace(200.0, 800.0, 61), np.linspace(-0.05, 0.1, 41)))
    asked = problem(noise=0.02, measure=measure)
    found = answer(tmp_path / "ledger.sqlite", asked)
    E, tilt = points.reshape(2, -1)
    y = 20.0 / E[:, None] * X**2 * (3 - X) + tilt[:, None] * X
    seen = asked.observations[0].interface
    squares = [measure(Interface.polyline(np.stack([X, row], axis=1)), seen) for row in y]
    mean_error, sd_error, _ = summed(np.stack([E, tilt], axis=1), -0.5 * np.array(squares) / 0.02**2).off(found)
    assert mean_error < 0.12
    assert sd_error < 0.1


class Stopped(Exception):
    """The driver is stopped."""


@pytest.mark.long
def test_what_was_stopped_goes_on_to_the_same_bits(found: Calibration, tmp_path: Path) -> None:
    runs: list[Any] = []

    def stop(record: Any, progress: Any) -> None:
        runs.append(record)
        if len(runs) == 9:
            raise Stopped

    path = tmp_path / "ledger.sqlite"
    with pytest.raises(Stopped):
        answer(path, problem(), observer=Observer(run=stop))
    runs.clear()
    other = answer(path, problem(), observer=Observer(run=lambda record, progress: runs.append(record)))
    assert len(runs) == len(found.records) - 9
    assert same(other, found)


@pytest.mark.long
def test_given_runs_take_the_place_of_a_design(found: Calibration, folder: Path) -> None:
    """Another noise of the same runs, enough of which lie inside the posterior: no new ones."""
    runs: list[Any] = []
    own = np.array([[record.inputs[name] for name in TWO.names] for record in found.records])
    more = own.mean(axis=0) + 0.5 * (own[:40] - own.mean(axis=0))
    given, observer = np.concatenate([own, more]), Observer(run=lambda record, progress: runs.append(record))
    answer(folder / "ledger.sqlite", problem(), given=given, observer=observer)
    assert len(runs) >= len(more)
    runs.clear()
    other = answer(folder / "ledger.sqlite", problem(noise=2 * NOISE), given=given, observer=observer)
    assert exact(noise=2 * NOISE).off(other)[0] < 0.12
    assert other.field is not None
    assert other.field.certificate is not None
    assert other.field.certificate.batches[0].kind == "given"
    assert other.field.certificate.converged
    assert runs == []
