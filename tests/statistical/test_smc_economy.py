"""The moves leave π_γ invariant; BlackJAX's sampler agrees; the defaults give exact moments for little effort."""

import warnings
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.densities import banana, gaussian, linear_exponential, truncated_gaussian

from strandline.posterior import Weighted
from strandline.smc import STUDY, SMCSettings, metropolis, sample

NUMBER, STEPS, LIMIT = 40_000, 5, 4.5
RATE = np.array([3.0, 0.7])
CORNER = linear_exponential(RATE)


def worst_z(x, gamma):
    """Return the largest |z| of means and central second moments of draws that should be independent ones of π_γ."""
    exact = linear_exponential(gamma * RATE)
    deviation = x - exact.mean
    products = deviation[:, [0, 0, 1]] * deviation[:, [0, 1, 1]] - exact.covariance[[0, 0, 1], [0, 1, 1]]
    columns = np.concatenate([deviation, products], axis=1)
    return float(np.abs(columns.mean(axis=0) / (columns.std(axis=0) / np.sqrt(len(x)))).max())


@partial(jax.jit, static_argnames="target")
def move(key, x, temperature, factor, *, target):
    likelihood, prior = target[0](x), target[1](x)
    return metropolis(key, x, likelihood, prior, target=target, temperature=temperature, factor=factor, steps=STEPS)


def moved(of, gamma, log_prior=CORNER.log_prior):
    """Return draws of π_γ for one γ after moves for another."""
    draws = -np.log1p(np.random.default_rng(5).random((NUMBER, 2)) * np.expm1(-of * RATE)) / (of * RATE)
    factor, target = jnp.asarray(np.linalg.cholesky(CORNER.covariance)), (CORNER.log_likelihood, log_prior)
    end = move(jax.random.key(2), jnp.asarray(draws), jnp.asarray(gamma), factor, target=target)
    assert float(end.acceptance) > 0.1
    assert float(jnp.mean(jnp.any(end.positions != draws, axis=1))) > 0.5
    return np.asarray(end.positions)


def test_a_density_cut_by_its_prior_stays():
    """Planted: another temperature in the acceptance; moves that forget the support, or clip to it."""
    for gamma in (0.3, 1.0):
        assert worst_z(moved(gamma, gamma), gamma) < LIMIT
    assert worst_z(moved(0.5, 1.0), 0.5) > 2 * LIMIT
    x = moved(1.0, 1.0, log_prior=lambda x: 0 * x[:, 0])
    for wrong in (x, np.clip(x, 0, 1)):
        assert worst_z(wrong, 1.0) > 2 * LIMIT


WIDE = truncated_gaussian(*np.array([[0.0, 1.0], [0.7, 0.1], [0.2, 0.95], [3.0, 2.0]]))
PARTICLES, MOVES, REPLICATES = 1000, 12, 10


def summary(log_evidence, x, weights):
    return np.concatenate([[log_evidence], weights @ x, weights @ x**2])


def theirs():
    with warnings.catch_warnings(action="ignore"):
        import blackjax
        from blackjax.smc import resampling
    walk, spread = blackjax.additive_step_random_walk, 0.5 * np.sqrt(np.diagonal(WIDE.covariance))
    kernel, one = walk.build_kernel(), lambda function, x: function(x[None, :])[0]

    def move(key, state, log_density):
        return kernel(key, state, log_density, lambda k, x: spread * jax.random.normal(k, x.shape))

    target = partial(one, WIDE.log_prior), partial(one, WIDE.log_likelihood)
    given = *target, move, walk.init, {}, resampling.systematic, 0.5
    algorithm = blackjax.adaptive_tempered_smc(*given, num_mcmc_steps=MOVES)
    step, found = jax.jit(algorithm.step), []
    for seed in range(REPLICATES):
        start = WIDE.draw_prior(np.random.default_rng(100 + seed), PARTICLES)
        state, key, log_evidence = algorithm.init(jnp.asarray(start)), jax.random.key(seed), 0.0
        while float(state.tempering_param) < 1:
            key, now = jax.random.split(key)
            state, info = step(now, state)
            log_evidence += float(info.log_likelihood_increment)
        found.append(summary(log_evidence, np.asarray(state.particles), np.asarray(state.weights)))
    return np.array(found)


def ours(power):
    settings, found = SMCSettings(rejuvenation_steps=MOVES, zeta=0.9), []
    log_likelihood = lambda x: power * WIDE.log_likelihood(x)  # noqa: E731
    for seed in range(REPLICATES):
        start = WIDE.draw_prior(np.random.default_rng(200 + seed), PARTICLES)
        r = sample(jax.random.key(seed), log_likelihood, WIDE.log_prior, start, settings=settings)
        found.append(summary(r.log_evidence, r.positions, np.exp(r.log_weights)))
    return np.array(found)


def test_an_independent_sampler_agrees_within_the_errors_of_both():
    """BlackJAX's adaptive tempered SMC. Planted: a likelihood that is ten percent too narrow."""
    expected = theirs()

    def far(found):
        error = np.sqrt((found.var(axis=0, ddof=1) + expected.var(axis=0, ddof=1)) / REPLICATES)
        return float(np.abs((found.mean(axis=0) - expected.mean(axis=0)) / error).max())

    assert far(ours(1.0)) < LIMIT < far(ours(1.2))


def ridge(dim):
    """Standard deviations from 1 to 0.05 along axes that are none of the inputs'."""
    axes = np.linalg.qr(np.random.default_rng(3).normal(size=(dim, dim)))[0]
    return gaussian(np.zeros(dim), axes @ np.diag(np.geomspace(1.0, 0.05, dim) ** 2) @ axes.T)


CENTRES, WIDTHS = np.array([[0.2, 0.9, 0.5, 1.2, -0.1, 0.5, 0.4], [0.1, 0.5, 0.05, 0.3, 0.2, 2.0, 0.02]])
TARGETS = {
    "banana in 2-D": banana(centre=1.0, sd=1.0, bend=0.5, width=0.15),
    "ridge in 7-D": ridge(7),
    "box in 7-D": truncated_gaussian(CENTRES, WIDTHS, np.zeros(7), np.ones(7)),
}


def errors(target, settings, seeds=20):
    """Return rms errors over seeds: of means (in sd), of standard deviations (relative), of log Z; and evaluations."""
    sd, found, evaluations = np.sqrt(np.diagonal(target.covariance)), [], []
    for seed in range(seeds):
        initial = target.draw_prior(np.random.default_rng(100 + seed), 5000)
        result = sample(jax.random.key(seed), target.log_likelihood, target.log_prior, initial, settings=settings)
        by, evidence = Weighted(result.positions, np.exp(result.log_weights)), result.log_evidence - target.log_evidence
        found.append([(by.mean - target.mean) / sd, by.sd / sd - 1, np.full(len(sd), evidence)])
        evaluations.append(result.likelihood_evaluations)
    return *np.sqrt(np.mean(np.square(found), axis=0)).max(axis=1), np.mean(evaluations)


@pytest.mark.long
@pytest.mark.parametrize("name", TARGETS)
def test_moments_are_as_good_for_a_twentieth_of_the_evaluations(name):
    mean, sd, evidence, evaluations = errors(TARGETS[name], SMCSettings())
    assert max(mean, sd) < 0.03
    assert evidence < 0.1
    assert errors(TARGETS[name], STUDY, seeds=2)[3] / evaluations >= 20


@pytest.mark.long
def test_too_few_moves_are_noticed():
    """Planted: one move a step; particles stay where resampling has put several of them."""
    assert errors(TARGETS["box in 7-D"], SMCSettings(rejuvenation_steps=1), seeds=8)[0] > 0.1
