"""The sampler on surrogates against integrals of the same surrogate, over seeds, in two and in seven dimensions.

In 2-D the reference is a tensor Gauss-Legendre rule, in 7-D importance sampling from a heavy-tailed proposal: neither
knows anything of tempering, resampling or moves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from strandline.design import sobol
from strandline.smc import STUDY, SMCResult, SMCSettings, sample, steps
from strandline.surrogate import KERNELS, GaussianProcess, batched_mean, condition

PARTICLES, LIMIT = 5000, 4.5
STUDY_OF_SEVEN = SMCSettings(rejuvenation_steps=30, zeta=0.998)
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


def seven() -> GaussianProcess:
    """Return a surrogate of a quadratic form with standard deviations of 0.25 to 0.05 along axes of its own."""
    axes = np.linalg.qr(np.random.default_rng(3).normal(size=(7, 7)))[0]
    x = sobol(600, 7)
    z = (x - 0.5) @ axes / np.geomspace(0.25, 0.05, 7)
    lengths = np.full(7, 6.0)
    return condition(
        x,
        -0.5 * (z**2).sum(axis=1),
        kernel=KERNELS["matern32_product"],
        length_scale=lengths,
        signal_variance=1e6,
        nugget=1e-3,
    )


def importance(mean: Log, pilot: SMCResult, batches: int = 40, size: int = 25_000) -> tuple[Reference, float]:
    """Return the moments by importance sampling, and its effective sample size.

    Proposals are a Student t of 6 degrees around the pilot's particles, a tenth of them uniform; the pilot may be wrong
    by any amount and the result remains unbiased.
    """
    rng, compiled = np.random.default_rng(0), jax.jit(mean)
    w = np.exp(pilot.log_weights)
    centre = w @ pilot.positions
    shape = 1.2 * (w[:, None] * (pilot.positions - centre)).T @ (pilot.positions - centre)
    student = stats.multivariate_t(centre, shape, df=6, seed=rng)
    points, logs = [], []
    for _ in range(batches):
        x = np.where(rng.random((size, 1)) < 0.1, rng.random((size, 7)), student.rvs(size))
        inside = ((x >= 0) & (x <= 1)).all(axis=1)
        proposal = np.logaddexp(np.log(0.9) + student.logpdf(x), np.log(0.1) + np.where(inside, 0.0, -np.inf))
        points.append(x)
        logs.append(np.where(inside, np.asarray(compiled(x)), -np.inf) - proposal)
    x, log_w = np.concatenate(points), np.concatenate(logs)
    w = np.exp(log_w - log_w.max())
    log_evidence = float(np.log(w.mean()) + log_w.max())
    return Reference(*moments(x, w / w.sum()), log_evidence), float(w.sum() ** 2 / (w**2).sum())


@pytest.fixture(scope="module")
def mean_of_seven() -> Log:
    return batched_mean(seven())


@pytest.fixture(scope="module")
def exact_seven(mean_of_seven: Log) -> Reference:
    exact, size = importance(mean_of_seven, sampled(mean_of_seven, 7, SMCSettings(), 99))
    assert size > 100_000  # the reference's own error is below 0.004 standard deviations
    return exact


@pytest.mark.long
def test_seven_inputs_need_a_twentieth_of_the_evaluations(mean_of_seven: Log, exact_seven: Reference) -> None:
    """Over 20 seeds of the default settings: rms of every mean and sd below 0.03 sd; the study's steps are counted."""
    runs = [sampled(mean_of_seven, 7, SMCSettings(), seed) for seed in range(20)]
    found = errors(runs, exact_seven)
    few = 1000  # the study's number of steps does not depend on the number of particles
    study = sampled(mean_of_seven, 7, STUDY_OF_SEVEN, 1, few).likelihood_evaluations / few
    saved = study / np.mean([r.likelihood_evaluations / PARTICLES for r in runs])
    print(f"\nrms mean {rms(found.mean):.4f} sd, sd {rms(found.sd):.4f}, log Z {rms(found.log_evidence):.4f}")
    print(f"{saved:.1f} times fewer evaluations")
    print(f"worst {np.abs(found.all).max(axis=0).round(4)}, z {found.worst_z:.2f}")
    assert rms(found.mean) < 0.03
    assert rms(found.sd) < 0.03
    assert rms(found.log_evidence) < 0.1
    assert saved >= 20


@pytest.mark.long
def test_too_few_moves_in_seven_dimensions_are_noticed(mean_of_seven: Log, exact_seven: Reference) -> None:
    hurried = SMCSettings(rejuvenation_steps=1)
    found = errors([sampled(mean_of_seven, 7, hurried, seed) for seed in range(6)], exact_seven)
    assert max(rms(found.mean), rms(found.sd)) > 0.1
