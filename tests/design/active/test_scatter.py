"""The simulator's own scatter is measured, allowed for, and named where it keeps a check from passing."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from tests.design.active.test_checking import TOLERANCES

from strandline.calibration import Calibration, Problem, Settings, calibrate
from strandline.design import sobol
from strandline.design.active import Active, Knowledge, learn, scatter_of
from strandline.design.active.checking import BatchCheck, error_probability, looks, number_of_probes, probes, verdict
from strandline.design.active.parabola import smooth_effect
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
REPLICATES = 24
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


def seen(seed: int) -> Observation:
    noise = NOISE * np.random.default_rng(seed + 50).standard_normal(len(X))
    return Observation(polyline(heights(TRUTH)[0] + noise), NOISE**2)


def learnt(model: Jittery, number: int = 48) -> Knowledge:
    x = sobol(number, 2, scramble=1)
    records = [RunRecord(str(i), SPACE.as_mapping(r), "ok", {"": polyline(model.heights(r))}) for i, r in enumerate(x)]
    return learn(x, records, SPACE, (seen(1),), TrackedPoints())


@pytest.mark.parametrize("share", [0.01, 0.03])
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


def test_known_scatter_is_taken_out_of_the_effective_share_alone() -> None:
    random = np.random.default_rng(3)
    posterior, draws = random.standard_normal((500, 2)), random.standard_normal((60, 2))
    ratios = 0.5 * random.standard_normal(60)
    plain, known = (smooth_effect(draws, ratios, posterior, 0.05, scatter=s) for s in (0.0, 0.25))
    assert known.shift_bounds == pytest.approx(plain.shift_bounds)
    assert known.width_bounds == pytest.approx(plain.width_bounds)
    assert plain.effective_bounds[0] < 0.75
    assert known.effective_bounds[0] == pytest.approx(plain.effective_bounds[0] * np.exp(0.25), rel=1e-6)
    assert smooth_effect(draws, ratios, posterior, 0.05, scatter=9.0).effective_bounds[1] <= 1.0


def share_passed(off: float, scatter: float) -> float:
    """Share of checks that pass a surrogate whose mean is off by so many sd, of a simulator with known scatter."""
    passed = 0
    for seed in range(REPLICATES):
        random = np.random.default_rng(seed)
        posterior, pool, equal = (random.standard_normal((number, 2)) for number in (500, 200, 25))
        number = number_of_probes(2)
        draws = np.concatenate([pool[probes(pool, number)], equal])
        ratios = off * draws[:, 0] + np.sqrt(scatter) * random.standard_normal(len(draws))
        ends = looks(number, len(draws), 2)
        for end in ends:
            options = {
                "probing": number,
                "level": error_probability(ends.index(end), len(ends)),
                "last": end == ends[-1],
                "scatter": scatter,
            }
            found = verdict(draws[:end], ratios[:end], posterior, TOLERANCES, **options)
            if isinstance(found, BatchCheck):
                passed += found.passed
                break
    return passed / REPLICATES


@pytest.mark.parametrize("scatter", [0.01, 0.5])
def test_scatter_excuses_no_wrong_surrogate(scatter: float) -> None:
    assert share_passed(0.3, scatter) <= 2 / REPLICATES


def calibrated(share: float, seed: int, runs: int = 80) -> Calibration:
    active = Active(runs=runs, batch=4)
    settings = Settings(runs=12, scramble=seed, surrogate="field", active=active, particles=2000, seed=seed)
    problem = Problem(Jittery(share, seed), SPACE, {}, (seen(seed),), {"points": TrackedPoints()})
    return calibrate(problem, settings, executor=InProcess())


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
    right_or_explained(calibrated(0.03, 1, runs=44), 1)


def test_a_smooth_simulator_that_does_not_converge_is_not_said_to_scatter(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a dozen runs, curvature looks like scatter: only what all runs show counts."""
    monkeypatch.setattr(f"{__name__}.NOISE", 0.0005)
    certificate = getattr(calibrated(0.0, 0, runs=30).field, "certificate", None)
    assert certificate is not None
    assert not certificate.converged
    assert not certificate.scattered


@pytest.mark.long
@pytest.mark.parametrize("share", [0.01, 0.03])
@pytest.mark.parametrize("seed", range(5))
def test_right_or_not_certified_for_this_reason(share: float, seed: int) -> None:
    right_or_explained(calibrated(share, seed), seed)
