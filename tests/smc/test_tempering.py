import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from strandline.smc import effective_sample_size, next_temperature


def size(weights):
    return weights.sum() ** 2 / (weights**2).sum()


def test_effective_sample_size_of_any_normalisation():
    weights = np.random.default_rng(0).random(50)
    assert float(effective_sample_size(jnp.log(weights) - 1e4)) == pytest.approx(size(weights))
    assert float(effective_sample_size(jnp.array([0.0, -jnp.inf, 0.0]))) == pytest.approx(2.0)


@pytest.mark.parametrize("zeta", [0.3, 0.9, 0.995])
@pytest.mark.parametrize("scale", [300.0, 1e7])
@pytest.mark.parametrize("temperature", [0.0, 0.2])
def test_the_step_keeps_the_wanted_share(zeta, scale, temperature):
    rng = np.random.default_rng(1)
    log_weights, log_likelihood = rng.normal(size=400), -scale * rng.random(400) ** 2

    def excess(increment):
        return size(np.exp(log_weights + increment * (log_likelihood - log_likelihood.max()))) - zeta * size(
            np.exp(log_weights)
        )

    expected = brentq(excess, 0.0, 1 - temperature, xtol=1e-16)
    found = next_temperature(jnp.asarray(log_weights), jnp.asarray(log_likelihood), jnp.asarray(temperature), zeta)
    assert float(found) - temperature == pytest.approx(expected, rel=1e-6)


def test_the_last_step_ends_at_one_exactly():
    log_likelihood = 1e-3 * jax.random.normal(jax.random.key(0), (100,))
    assert float(next_temperature(jnp.zeros(100), log_likelihood, jnp.asarray(0.3), 0.9)) == 1.0


def test_particles_of_zero_likelihood_do_not_stop_the_tempering():
    alive = -10 * np.random.default_rng(2).random(60)
    with_dead = np.concatenate([alive, np.full(40, -np.inf)])
    found = [next_temperature(jnp.zeros(len(v)), jnp.asarray(v), jnp.asarray(0.0), 0.9) for v in (alive, with_dead)]
    assert 0 < float(found[0]) < 1
    assert float(found[1]) == pytest.approx(float(found[0]))
