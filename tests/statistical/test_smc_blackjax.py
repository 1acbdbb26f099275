"""An independent sampler, BlackJAX's adaptive tempered SMC, agrees within the errors of both."""

import warnings
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from strandline.smc import SMCSettings, sample
from strandline.testing import densities

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import blackjax
    from blackjax.smc import resampling

TARGET = densities.truncated_gaussian(
    np.array([0.0, 1.0]), np.array([0.7, 0.1]), np.array([0.2, 0.95]), np.array([3.0, 2.0])
)
NUMBER, MOVES, REPLICATES, LIMIT = 1000, 12, 10, 4.5


def one(function: Any, x: Any) -> Any:
    return function(x[None, :])[0]


def summary(log_evidence: float, x: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.concatenate([[log_evidence], weights @ x, weights @ x**2])


def initial(seed: int) -> np.ndarray:
    return TARGET.draw_prior(np.random.default_rng(seed), NUMBER)


def theirs() -> np.ndarray:
    walk, spread = blackjax.additive_step_random_walk, 0.5 * np.sqrt(np.diagonal(TARGET.covariance))
    kernel = walk.build_kernel()

    def move(key: Any, state: Any, log_density: Any) -> Any:
        return kernel(key, state, log_density, lambda k, x: spread * jax.random.normal(k, x.shape))

    target = partial(one, TARGET.log_prior), partial(one, TARGET.log_likelihood)
    algorithm = blackjax.adaptive_tempered_smc(
        *target, move, walk.init, {}, resampling.systematic, 0.5, num_mcmc_steps=MOVES
    )
    step, found = jax.jit(algorithm.step), []
    for seed in range(REPLICATES):
        state, key, log_evidence = algorithm.init(jnp.asarray(initial(100 + seed))), jax.random.key(seed), 0.0
        while float(state.tempering_param) < 1:
            key, now = jax.random.split(key)
            state, info = step(now, state)
            log_evidence += float(info.log_likelihood_increment)
        found.append(summary(log_evidence, np.asarray(state.particles), np.asarray(state.weights)))
    return np.array(found)


def ours(power: float) -> np.ndarray:
    settings, found = SMCSettings(rejuvenation_steps=MOVES, zeta=0.9), []
    log_likelihood = lambda x: power * TARGET.log_likelihood(x)  # noqa: E731
    for seed in range(REPLICATES):
        r = sample(jax.random.key(seed), log_likelihood, TARGET.log_prior, initial(200 + seed), settings=settings)
        found.append(summary(r.log_evidence, r.positions, np.exp(r.log_weights)))
    return np.array(found)


def test_both_samplers_agree() -> None:
    """Planted: a likelihood that is ten percent too narrow."""
    expected = theirs()

    def worst_z(found: np.ndarray) -> float:
        error = np.sqrt((found.var(axis=0, ddof=1) + expected.var(axis=0, ddof=1)) / REPLICATES)
        return float(np.abs((found.mean(axis=0) - expected.mean(axis=0)) / error).max())

    assert worst_z(ours(1.0)) < LIMIT
    assert worst_z(ours(1.2)) > LIMIT
