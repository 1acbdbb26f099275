"""The simulator's own scatter is measured, allowed for, and named where it keeps a check from passing."""

import hashlib
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.special import softmax

import strandline as sl
from strandline.design.active import Active, learn, simulator_noise
from strandline.design.active.posterior_check import SimulatorNoise
from strandline.posterior import Weighted
from strandline.report.warnings import find_warnings

SPACE = sl.ParameterSpace((sl.Parameter("a", sl.Uniform(0.0, 1.0)), sl.Parameter("b", sl.Uniform(0.0, 1.0))))
X, TRUTH, NOISE = np.linspace(0.0, 1.0, 21), np.array([[0.3, 0.35]]), 0.02
LIMITS = {"draws": 25, "shift": 0.1, "effective": 0.8}


def heights(x):
    """Smooth interfaces (run, 21) of two inputs."""
    a, b = x[:, :1], x[:, 1:]
    return 0.3 * np.sin(2 * a + X) * X + 0.4 * b * X**2 + 0.2 * a * b * np.sin(3 * X)


@dataclass(frozen=True)
class Jittery:
    """A simulator whose interface is off by a share of its displacement, in four waves, by chance in each run."""

    share: float
    seed: int

    @property
    def fingerprint(self):
        return f"test:jittery-{self.share}-{self.seed}"

    def interface(self, x, number=0):
        smooth = heights(x[None])[0]
        digest = hashlib.sha256(x.tobytes() + bytes([self.seed, number])).digest()
        waves = np.cos(np.pi * np.arange(4)[:, None] * X) * np.array([[1.0], [2**0.5], [2**0.5], [2**0.5]]) / 2
        chance = np.random.default_rng(list(digest[:8])).standard_normal(4) @ waves
        y = smooth + self.share * np.sqrt(np.mean(smooth**2)) * chance
        return sl.Interface.polyline(np.stack([X, y], axis=1))

    def __call__(self, inputs, workdir):
        return sl.Simulation.of(self.interface(np.array([inputs["a"], inputs["b"]])))


def seen(seed, noise=NOISE):
    y = heights(TRUTH)[0] + noise * np.random.default_rng(seed + 50).standard_normal(len(X))
    return sl.Observation(sl.Interface.polyline(np.stack([X, y], axis=1)), noise**2)


def test_planted_scatter_is_measured():
    model, x = Jittery(0.03, 1), sl.sobol(48, 2, scramble=1)
    records = [sl.RunRecord(str(i), SPACE.as_mapping(r), "ok", {"": model.interface(r)}) for i, r in enumerate(x)]
    draws = TRUTH + 0.05 * np.random.default_rng(2).standard_normal((16, 2))
    found = simulator_noise(learn(x, records, SPACE, (seen(1),), sl.TrackedPoints()), draws)
    size = np.mean(np.sqrt(np.mean(heights(x) ** 2, axis=1)))
    assert found.rms == pytest.approx(0.03 * size, rel=0.35)
    likelihood = sl.InterfaceLikelihood((seen(1),), sl.TrackedPoints())
    values = [[likelihood({"": model.interface(x, k)}) for k in range(30)] for x in draws]
    assert found.variance == pytest.approx(np.mean(np.var(values, axis=1)), rel=0.6)


def test_when_it_is_the_reason():
    scatter = SimulatorNoise(0.003, 0.006, 0.5)
    assert scatter.share == 0.5
    assert scatter.prevents(observed=0.6, **LIMITS)
    assert scatter.prevents(observed=None, **LIMITS)
    assert not scatter.prevents(observed=5.0, **LIMITS)  # a wrong surrogate scatters more
    assert not SimulatorNoise(0.003, 0.006, 0.01).prevents(observed=0.01, **LIMITS)
    assert SimulatorNoise(0.003, 0.006, 0.15).prevents(observed=0.15, **LIMITS)  # by the shift alone
    assert all(words in scatter.reason for words in ("3 µm", "0.5 times the shift", "by 0.71", "average", "tolerance"))


def calibrated(share, seed, *, noise=NOISE, **settings):
    """Return what is found by an active design, and the certificate of the field."""
    settings = {"runs": 12, "scramble": seed, "surrogate": "field", "particles": 1000, "seed": seed, **settings}
    problem = sl.Problem(Jittery(share, seed), SPACE, {}, (seen(seed, noise),), {"points": sl.TrackedPoints()})
    found = sl.calibrate(problem, sl.Settings(**settings), executor=sl.InProcess())
    return found, found.field.certificate


def exact(seed):
    """Return the posterior of the simulator without scatter."""
    axis, observed = (np.arange(200) + 0.5) / 200, seen(seed).interface.points[:, 1]
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    return Weighted(grid, softmax(-0.5 * np.sum((heights(grid) - observed) ** 2, axis=1) / NOISE**2))


LONG = [pytest.param(share, seed, 80, marks=pytest.mark.long) for share in (0.01, 0.03) for seed in range(5)]


@pytest.mark.parametrize(("share", "seed", "runs"), [(0.03, 1, 44), *LONG])
def test_right_or_not_certified_because_of_the_scatter(share, seed, runs):
    found, certificate = calibrated(share, seed, active=Active(runs, batch=4), draft=runs < 80)
    truth = exact(seed)
    assert np.abs((found.posterior.mean - truth.mean) / truth.sd).max() < (0.2 if certificate.converged else 0.4)
    if not certificate.converged:
        assert certificate.scattered
        assert any("average repeated runs" in warning for warning in find_warnings(found))


def test_a_smooth_simulator_that_does_not_converge_is_not_said_to_scatter():
    """After a dozen runs, curvature looks like scatter: only what all runs show counts."""
    _, certificate = calibrated(0.0, 0, noise=0.0005, active=Active(18, batch=4), draft=True)
    assert not certificate.converged
    assert not certificate.scattered
