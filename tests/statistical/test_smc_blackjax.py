"""An independent sampler, BlackJAX's adaptive tempered SMC, agrees within the errors of both."""

import warnings
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.smc import SMCSettings, sample
from strandline.testing import densities

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import blackjax
    from blackjax.smc import resampling

TARGET = densities.truncated_gaussian(
    np.array([0.0, 1.0]), np.array([0.7, 0.1]), np.array([0.2, 0.95]), np.array([3.0, 2.0])
)
NUMBER, MOVES, REPLICATES, LIMIT = 1000, 12, 12, 4.5


def one(function, x):
    return function(x[None, :])[0]


@pytest.fixture(scope="module")
def theirs():
    walk = blackjax.additive_step_random_walk
    spread = 0.5 * np.sqrt(np.diagonal(TARGET.covariance))
    kernel = walk.build_kernel()

    def move(key, state, log_density):
        return kernel(key, state, log_density, lambda k, x: spread * jax.random.normal(k, x.shape))

    algorithm = blackjax.adaptive_tempered_smc(
        partial(one, TARGET.log_prior),
        partial(one, TARGET.log_likelihood),
        move,
        walk.init,
        {},
        resampling.systematic,
        0.5,
        num_mcmc_steps=MOVES,
    )
    step, found = jax.jit(algorithm.step), []
    for seed in range(REPLICATES):
        draws = TARGET.draw_prior(np.random.default_rng(100 + seed), NUMBER)
        found.append(replicate(step, algorithm.init(jnp.asarray(draws)), jax.random.key(seed)))
    return np.array(found)


def replicate(step, state, key):
    log_evidence = 0.0
    while float(state.tempering_param) < 1:
        key, now = jax.random.split(key)
        state, info = step(now, state)
        log_evidence += float(info.log_likelihood_increment)
    x, w = np.asarray(state.particles), np.asarray(state.weights)
    return np.concatenate([[log_evidence], w @ x, w @ x**2])


def ours(log_likelihood=TARGET.log_likelihood):
    found = []
    for seed in range(REPLICATES):
        draws = TARGET.draw_prior(np.random.default_rng(200 + seed), NUMBER)
        r = sample(
            jax.random.key(seed),
            log_likelihood,
            TARGET.log_prior,
            draws,
            settings=SMCSettings(rejuvenation_steps=MOVES, zeta=0.9),
        )
        w = np.exp(r.log_weights)
        found.append(np.concatenate([[r.log_evidence], w @ r.positions, w @ r.positions**2]))
    return np.array(found)


def worst_z(a, b):
    error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / REPLICATES)
    return np.abs((a.mean(axis=0) - b.mean(axis=0)) / error).max()


def test_both_samplers_agree(theirs):
    assert worst_z(ours(), theirs) < LIMIT


def test_the_comparison_catches_a_likelihood_ten_percent_too_narrow(theirs):
    assert worst_z(ours(lambda x: 1.2 * TARGET.log_likelihood(x)), theirs) > LIMIT
