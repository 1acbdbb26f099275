"""The sampler on a surrogate against a tensor Gauss-Legendre rule of the same surrogate, over seeds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.design import sobol
from strandline.smc import STUDY, SMCResult, SMCSettings, sample, steps
from strandline.surrogate import KERNELS, GaussianProcess, batched_mean, condition

PARTICLES, LIMIT = 5000, 4.5
HASTY = SMCSettings(rejuvenation_steps=1, zeta=0.9, resample_below=0.0)
Log = Callable[[Any], Any]


@dataclass(frozen=True)
class Reference:
    """Exact moments and evidence of exp(surrogate) on the unit cube."""

    mean: np.ndarray
    sd: np.ndarray
    log_evidence: float


@dataclass(frozen=True)
class Errors:
    """Errors over seeds, one row a seed: means in standard deviations, relative standard deviations, log evidence."""

    mean: np.ndarray
    sd: np.ndarray
    log_evidence: np.ndarray

    @property
    def all(self) -> np.ndarray:
        return np.concatenate([self.mean, self.sd, self.log_evidence[:, None]], axis=1)

    @property
    def worst_z(self) -> float:
        """Return the largest |z| of the errors' means over seeds."""
        errors = self.all
        return float(np.abs(errors.mean(axis=0) / (errors.std(axis=0, ddof=1) / np.sqrt(len(errors)))).max())


def rms(errors: np.ndarray) -> float:
    """Return the largest root mean square over seeds."""
    return float(np.sqrt(np.mean(np.square(errors), axis=0)).max())


def unit_prior(x: jax.Array) -> jax.Array:
    return jnp.where(jnp.all((x >= 0) & (x <= 1), axis=1), 0.0, -jnp.inf)


def sampled(mean: Log, dim: int, settings: SMCSettings, seed: int, particles: int = PARTICLES) -> SMCResult:
    initial = np.random.default_rng(1000 + seed).random((particles, dim))
    return sample(jax.random.key(seed), mean, unit_prior, initial, settings=settings)


def moments(x: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean = w @ x
    return mean, np.sqrt(w @ (x - mean) ** 2)


def errors(found: Sequence[SMCResult], exact: Reference, *, weighted: bool = True) -> Errors:
    means, sds = [], []
    for result in found:
        w = np.exp(result.log_weights) if weighted else np.full(len(result.positions), 1 / len(result.positions))
        mean, sd = moments(result.positions, w)
        means.append((mean - exact.mean) / exact.sd)
        sds.append(sd / exact.sd - 1)
    return Errors(np.array(means), np.array(sds), np.array([r.log_evidence for r in found]) - exact.log_evidence)


def legendre(process: GaussianProcess, nodes: int) -> Reference:
    place, weight = np.polynomial.legendre.leggauss(nodes)
    grid = np.stack(np.meshgrid(0.5 * (place + 1), 0.5 * (place + 1), indexing="ij"), axis=-1).reshape(-1, 2)
    mass = 0.25 * np.outer(weight, weight).ravel() * np.exp(process.mean(grid))
    return Reference(*moments(grid, mass / mass.sum()), float(np.log(mass.sum())))


def bent_ridge() -> GaussianProcess:
    """Return a surrogate of a ridge along x(1 + y²) = 0.6, as those of a stiffness and a Poisson ratio are."""
    x = sobol(300, 2)
    y = -200.0 * (x[:, 0] * (1 + x[:, 1] ** 2) - 0.6) ** 2 - 2.0 * x[:, 1]
    return condition(x, y, kernel=KERNELS["matern32"], length_scale=1.3, signal_variance=2000.0, nugget=1e-3)


@pytest.fixture(scope="module")
def ridge() -> GaussianProcess:
    return bent_ridge()


@pytest.fixture(scope="module")
def exact_ridge(ridge: GaussianProcess) -> Reference:
    exact, coarser = legendre(ridge, 200), legendre(ridge, 160)
    np.testing.assert_allclose(exact.mean, coarser.mean, atol=1e-3 * exact.sd.min())
    np.testing.assert_allclose(exact.sd, coarser.sd, rtol=1e-3)
    np.testing.assert_allclose(exact.log_evidence, coarser.log_evidence, atol=1e-3)
    return exact


@pytest.mark.long
def test_study_settings_agree_with_gauss_legendre(ridge: GaussianProcess, exact_ridge: Reference) -> None:
    """Over 12 seeds: rms of every mean and sd below 0.03 sd, of log Z below 0.02; none above three times that."""
    mean = batched_mean(ridge)
    found = errors([sampled(mean, 2, STUDY, seed) for seed in range(12)], exact_ridge)
    print(f"\nrms mean {rms(found.mean):.4f} sd, sd {rms(found.sd):.4f}, log Z {rms(found.log_evidence):.4f}")
    print(f"worst {np.abs(found.all).max(axis=0).round(4)}, z {found.worst_z:.2f}")
    assert rms(found.mean) < 0.03
    assert rms(found.sd) < 0.03
    assert rms(found.log_evidence) < 0.02
    assert np.abs(found.all).max() < 0.09
    assert np.abs(found.log_evidence).max() < 0.06
    assert found.worst_z < LIMIT


@pytest.mark.long
def test_temperature_left_out_of_the_acceptance_is_noticed(
    ridge: GaussianProcess, exact_ridge: Reference, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = steps.metropolis

    def without_temperature(*arguments: Any, temperature: jax.Array, **others: Any) -> Any:
        return original(*arguments, temperature=jnp.ones_like(temperature), **others)

    monkeypatch.setattr(steps, "metropolis", without_temperature)
    mean = batched_mean(ridge)
    found = errors([sampled(mean, 2, STUDY, seed) for seed in range(3)], exact_ridge)
    assert rms(found.log_evidence) > 0.1
    assert found.worst_z > LIMIT


@pytest.mark.long
def test_a_summary_that_forgets_the_weights_is_noticed(ridge: GaussianProcess, exact_ridge: Reference) -> None:
    """One move a step, and no resampling: the weights carry what the moves have not."""
    mean = batched_mean(ridge)
    runs = [sampled(mean, 2, HASTY, seed) for seed in range(10)]
    right, wrong = errors(runs, exact_ridge), errors(runs, exact_ridge, weighted=False)
    assert right.worst_z < LIMIT
    assert wrong.worst_z > 2 * LIMIT
    assert rms(wrong.sd) > 0.1
