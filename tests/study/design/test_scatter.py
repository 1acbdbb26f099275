"""The simulator's own scatter is measured, allowed for, and named where it keeps a check from passing."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.calibration import Calibration, Problem, Settings, calibrate
from strandline.design import sobol
from strandline.design.active import Active, Knowledge, learn, scatter_of
from strandline.design.active.scatter import Scatter, typical_variance
from strandline.discrepancy import TrackedPoints
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.protocol import Simulation
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.report.warnings import find_warnings
from strandline.runs import InProcess, RunRecord

SPACE = ParameterSpace((Parameter("a", Uniform(0.0, 1.0)), Parameter("b", Uniform(0.0, 1.0))))
X = np.linspace(0.0, 1.0, 21)
TRUTH = np.array([[0.3, 0.35]])
NOISE = 0.02
GRID = 200
LIMITS = {"draws": 25, "shift": 0.1, "effective": 0.8}


def heights(x: np.ndarray) -> np.ndarray:
    """Smooth interfaces (run, 21) of two inputs."""
    a, b = x[:, :1], x[:, 1:]
    return 0.3 * np.sin(2 * a + X) * X + 0.4 * b * X**2 + 0.2 * a * b * np.sin(3 * X)


@dataclass(frozen=True)
class Jittery:
    """A simulator whose interface is off by a share of its displacement, in four waves, by chance in each run."""

    share: float
    seed: int

    @property
    def fingerprint(self) -> str:
        return f"test:jittery-{self.share}-{self.seed}"

    def heights(self, x: np.ndarray, number: int = 0) -> np.ndarray:
        smooth = heights(x[None])[0]
        digest = hashlib.sha256(x.tobytes() + bytes([self.seed, number])).digest()
        waves = np.cos(np.pi * np.arange(4)[:, None] * X) * np.array([[1.0], [2**0.5], [2**0.5], [2**0.5]]) / 2
        chance = np.random.default_rng(list(digest[:8])).standard_normal(4) @ waves
        return np.asarray(smooth + self.share * np.sqrt(np.mean(smooth**2)) * chance)

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        return Simulation.of(polyline(self.heights(np.array([inputs["a"], inputs["b"]]))))


def polyline(y: np.ndarray) -> Interface:
    return Interface.polyline(np.stack([X, y], axis=1))


def seen(seed: int, noise: float = NOISE) -> Observation:
    errors = noise * np.random.default_rng(seed + 50).standard_normal(len(X))
    return Observation(polyline(heights(TRUTH)[0] + errors), noise**2)


def learnt(model: Jittery, number: int = 48) -> Knowledge:
    x = sobol(number, 2, scramble=1)
    records = [RunRecord(str(i), SPACE.as_mapping(r), "ok", {"": polyline(model.heights(r))}) for i, r in enumerate(x)]
    return learn(x, records, SPACE, (seen(1),), TrackedPoints())


@pytest.mark.parametrize("share", [0.03])
def test_planted_scatter_is_measured(share: float) -> None:
    model = Jittery(share, 1)
    knowledge = learnt(model)
    size = np.mean(np.sqrt(np.mean(heights(sobol(48, 2, scramble=1)) ** 2, axis=1)))
    draws = TRUTH + 0.05 * np.random.default_rng(2).standard_normal((16, 2))
    found = scatter_of(knowledge, draws)
    assert found.rms == pytest.approx(share * size, rel=0.35)
    assert f"{1e3 * found.rms:.2g} µm" in found.words
    likelihood = InterfaceLikelihood((seen(1),), TrackedPoints())
    values = [[likelihood({"": polyline(model.heights(x, k))}) for k in range(30)] for x in draws]
    assert found.variance == pytest.approx(np.mean(np.var(values, axis=1)), rel=0.6)


def test_a_smooth_simulator_has_none() -> None:
    found = scatter_of(learnt(Jittery(0.0, 1)), TRUTH)
    assert found.share < 0.01
    assert found.variance == 0.0
    assert not found.prevents(observed=4.0, **LIMITS)  # what varies is something else


def test_when_it_is_the_reason() -> None:
    scatter = Scatter(0.003, 0.006, 0.5)
    assert scatter.share == 0.5
    assert scatter.prevents(observed=0.6, **LIMITS)
    assert scatter.prevents(observed=None, **LIMITS)
    assert not scatter.prevents(observed=5.0, **LIMITS)  # a wrong surrogate scatters more
    assert not Scatter(0.003, 0.006, 0.01).prevents(observed=0.01, **LIMITS)
    assert Scatter(0.003, 0.006, 0.15).prevents(observed=0.15, **LIMITS)  # by the shift alone
    assert all(words in scatter.reason for words in ("3 µm", "0.5 times the shift", "by 0.71", "average", "tolerance"))


def test_the_typical_variance_forgets_extremes() -> None:
    values = 2.0 * np.random.default_rng(1).standard_normal(4001)
    values[:3] = 1e6, np.nan, -np.inf
    assert typical_variance(values) == pytest.approx(4.0, rel=0.1)


def calibrated(share: float, seed: int, *, noise: float = NOISE, **settings: Any) -> Calibration:
    settings = {"runs": 12, "scramble": seed, "surrogate": "field", "particles": 1000, "seed": seed, **settings}
    problem = Problem(Jittery(share, seed), SPACE, {}, (seen(seed, noise),), {"points": TrackedPoints()})
    return calibrate(problem, Settings(**settings), executor=InProcess())


def exact(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviations of the posterior of the simulator without scatter."""
    axis = (np.arange(GRID) + 0.5) / GRID
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    log_likelihood = -0.5 * np.sum((heights(grid) - seen(seed).interface.points[:, 1]) ** 2, axis=1) / NOISE**2
    weights = np.exp(log_likelihood - log_likelihood.max())
    weights /= weights.sum()
    mean = weights @ grid
    return mean, np.sqrt(weights @ (grid - mean) ** 2)


def right_or_explained(found: Calibration, seed: int) -> None:
    assert found.field is not None
    certificate = found.field.certificate
    assert certificate is not None
    mean, sd = exact(seed)
    off = float(np.max(np.abs(found.posterior.mean - mean) / sd))
    if certificate.converged:
        assert off < 0.2
    else:
        assert certificate.scattered
        assert "own scatter" in certificate.reasons[-1]
        (warning,) = [one for one in find_warnings(found) if one.startswith("NOT CONVERGED")]
        assert "average repeated runs" in warning
        assert "Allow more runs" not in warning
    assert off < 0.4  # also without a certificate


def test_an_active_design_says_that_the_scatter_stops_it() -> None:
    right_or_explained(calibrated(0.03, 1, active=Active(44, batch=4), draft=True), 1)


def test_a_smooth_simulator_that_does_not_converge_is_not_said_to_scatter() -> None:
    """After a dozen runs, curvature looks like scatter: only what all runs show counts."""
    found = calibrated(0.0, 0, noise=0.0005, active=Active(30, batch=4), draft=True)
    certificate = getattr(found.field, "certificate", None)
    assert certificate is not None
    assert not certificate.converged
    assert not certificate.scattered


@pytest.mark.long
@pytest.mark.parametrize("share", [0.01, 0.03])
@pytest.mark.parametrize("seed", range(5))
def test_right_or_not_certified_for_this_reason(share: float, seed: int) -> None:
    right_or_explained(calibrated(share, seed, active=Active(80, batch=4)), seed)
