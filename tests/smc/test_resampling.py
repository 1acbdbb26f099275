import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.smc import systematic


def offspring(resample, weights, repeats=2000):
    keys = jax.random.split(jax.random.key(3), repeats)
    ancestors = jax.jit(jax.vmap(lambda key: resample(key, jnp.log(weights))))(keys)
    return np.stack([np.bincount(row, minlength=len(weights)) for row in np.asarray(ancestors)])


def worst_z(counts, expected):
    """Return the largest |z| of the mean offspring; the ⌊⌋/⌈⌉ law has variance f(1 - f), f the fraction."""
    fraction = expected - np.floor(expected)
    error = np.sqrt(fraction * (1 - fraction) / len(counts))
    return np.abs((counts.mean(axis=0) - expected) / error).max()


WEIGHTS = np.random.default_rng(4).dirichlet(0.5 * np.ones(25))


def test_offspring_are_unbiased_and_one_off_at_most():
    counts = offspring(systematic, WEIGHTS)
    expected = 25 * WEIGHTS
    assert (counts >= np.floor(expected)).all()
    assert (counts <= np.ceil(expected)).all()
    assert worst_z(counts, expected) < 4.5


def test_the_same_test_catches_a_constant_offset():
    def planted(key, log_weights):
        cumulative = jnp.cumsum(jnp.exp(log_weights)) + 0 * jax.random.uniform(key)
        return jnp.searchsorted(cumulative, (jnp.arange(25) + 0.5) / 25)

    assert worst_z(offspring(planted, WEIGHTS), 25 * WEIGHTS) > 10


@pytest.mark.parametrize("dead", [0, 3, 7])
def test_zero_weights_have_no_offspring(dead):
    log_weights = jnp.zeros(8).at[dead].set(-jnp.inf)
    keys = jax.random.split(jax.random.key(0), 50)
    assert dead not in np.asarray(jax.vmap(systematic, (0, None))(keys, log_weights))


def test_equal_weights_keep_every_particle():
    np.testing.assert_array_equal(systematic(jax.random.key(0), jnp.full(16, -7.0)), np.arange(16))
