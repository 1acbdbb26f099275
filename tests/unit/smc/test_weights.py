"""Temperatures, effective sample sizes, offspring and joined runs: everything that handles weights alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from strandline.smc import SMCResult, StepInfo, effective_sample_size, next_temperature, systematic
from strandline.smc.halves import joined

WEIGHTS = np.random.default_rng(4).dirichlet(0.5 * np.ones(25))
next_one = jax.jit(next_temperature)


def size(weights):
    return weights.sum() ** 2 / (weights**2).sum()


def test_effective_sample_size_of_any_normalisation():
    weights = np.random.default_rng(0).random(50)
    assert float(effective_sample_size(jnp.log(weights) - 1e4)) == pytest.approx(size(weights))
    assert float(effective_sample_size(jnp.array([0.0, -jnp.inf, 0.0]))) == pytest.approx(2.0)


@pytest.mark.parametrize("zeta", [0.3, 0.995])
@pytest.mark.parametrize(("scale", "temperature"), [(300.0, 0.2), (1e7, 0.0)])
def test_the_step_keeps_the_wanted_share(zeta, scale, temperature):
    rng = np.random.default_rng(1)
    log_weights, log_likelihood = rng.normal(size=400), -scale * rng.random(400) ** 2

    def excess(increment):
        after = np.exp(log_weights + increment * (log_likelihood - log_likelihood.max()))
        return size(after) - zeta * size(np.exp(log_weights))

    expected = brentq(excess, 0.0, 1 - temperature, xtol=1e-16)
    found = float(next_one(log_weights, log_likelihood, temperature, zeta))
    assert found - temperature == pytest.approx(expected, rel=1e-6)


def test_the_last_step_ends_at_one_exactly_and_particles_of_zero_likelihood_do_not_stop_the_tempering():
    slight = 1e-3 * np.random.default_rng(1).normal(size=400)
    assert float(next_one(np.zeros(400), slight, 0.3, 0.9)) == 1.0
    alive = -10 * np.random.default_rng(2).random(240)
    with_dead = np.concatenate([alive, np.full(160, -np.inf)])
    plain, found = (float(next_one(np.zeros(len(v)), v, 0.0, 0.9)) for v in (alive, with_dead))
    assert 0 < plain < 1
    assert found == pytest.approx(plain)


KEYS = jax.random.split(jax.random.key(3), 2000)
ancestors = jax.jit(jax.vmap(systematic, (0, None)))


def worst_z(counts):
    """Return the largest |z| of the mean offspring; the ⌊⌋/⌈⌉ law has variance f(1 - f), f the fraction."""
    expected = 25 * WEIGHTS
    fraction = expected - np.floor(expected)
    error = np.sqrt(fraction * (1 - fraction) / len(counts))
    return np.abs((counts.mean(axis=0) - expected) / error).max()


def test_offspring_are_unbiased_and_one_off_at_most():
    """The planted bug: a constant offset."""
    found = np.asarray(ancestors(KEYS, jnp.log(WEIGHTS)))
    counts = np.stack([np.bincount(row, minlength=25) for row in found])
    assert (counts >= np.floor(25 * WEIGHTS)).all()
    assert (counts <= np.ceil(25 * WEIGHTS)).all()
    assert worst_z(counts) < 4.5
    planted = np.searchsorted(np.cumsum(WEIGHTS), (np.arange(25) + 0.5) / 25)
    assert worst_z(np.tile(np.bincount(planted, minlength=25), (2000, 1))) > 10


def test_zero_weights_have_no_offspring_and_equal_ones_one_each():
    for dead in (0, 3, 24):
        assert dead not in np.asarray(ancestors(KEYS, np.where(np.arange(25) == dead, -np.inf, 0.0)))
    np.testing.assert_array_equal(ancestors(KEYS, np.full(25, -7.0)), np.tile(np.arange(25), (2000, 1)))


@pytest.mark.parametrize("log_evidence", [-4.0, 300.0])
def test_joined_runs_count_by_their_evidence(log_evidence: float) -> None:
    """The second run has three times the particles and a third of the evidence of the first."""

    def run(number: int, at: float, log_evidence: float) -> SMCResult:
        x, equal, zero = np.full((number, 1), at), np.full(number, -np.log(number)), np.zeros(number)
        steps = (StepInfo(1.0, 900.0, 0.3, True, -3.0, 1.0),)
        return SMCResult(x, equal, zero, zero, log_evidence, float(number), steps, 10 * number)

    both = joined(run(100, 0.0, log_evidence + np.log(3)), run(300, 1.0, log_evidence))
    weights = np.exp(both.log_weights)
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ both.positions[:, 0] == pytest.approx(0.5)
    assert both.log_evidence == pytest.approx(log_evidence + np.log(1.5))
    assert both.ess == pytest.approx(1 / (0.25 / 100 + 0.25 / 300))
    assert both.likelihood_evaluations == 4000
