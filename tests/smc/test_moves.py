import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.smc import metropolis
from strandline.smc.moves import proposal_factor, proposal_scale


def test_the_scale_is_the_papers():
    np.testing.assert_allclose([float(proposal_scale(jnp.asarray(p))) for p in (0.0, 0.25, 1.0)], [1 / 81, 1 / 9, 1])


def test_the_factor_is_that_of_the_weighted_covariance():
    rng = np.random.default_rng(0)
    x, w = rng.normal(size=(300, 3)) * [1, 100, 1e-4], rng.dirichlet(np.ones(300))
    factor = np.asarray(proposal_factor(jnp.asarray(x), jnp.asarray(w), jnp.zeros(3)))
    np.testing.assert_allclose(factor @ factor.T, np.cov(x.T, aweights=w, ddof=0), rtol=1e-8)
    assert np.all(np.triu(factor, 1) == 0)


@pytest.mark.parametrize("kind", ["one point", "a line", "fewer particles than inputs"])
def test_a_collapsed_population_can_still_move(kind):
    x = {
        "one point": np.full((50, 2), 3.7),
        "a line": np.linspace(0, 1, 50)[:, None] * [1.0, 2.0],
        "fewer particles than inputs": np.array([[0.0, 1, 2, 3], [1.0, 1, 5, 2]]),
    }[kind]
    weights = jnp.full(len(x), 1 / len(x))
    factor = proposal_factor(jnp.asarray(x), weights, jnp.full(x.shape[1], 1e-8))
    assert np.isfinite(factor).all()
    assert (np.diagonal(factor) > 0).all()


def ends(log_likelihood, log_prior, start, steps=30, temperature=1.0):
    x = jnp.asarray(start, float)
    return metropolis(
        jax.random.key(1),
        x,
        log_likelihood(x),
        log_prior(x),
        target=(log_likelihood, log_prior),
        temperature=jnp.asarray(temperature),
        factor=0.5 * jnp.eye(1),
        steps=steps,
    )


def unit_interval(x):
    return jnp.where((x[:, 0] >= 0) & (x[:, 0] <= 1), 0.0, -jnp.inf)


def test_no_particle_leaves_the_support_even_where_the_likelihood_lures():
    moved = ends(lambda x: 100 * jnp.abs(x[:, 0] - 0.5), unit_interval, np.full((200, 1), 0.5))
    assert ((moved.positions >= 0) & (moved.positions <= 1)).all()
    assert 0 < float(moved.acceptance) < 1


def test_an_undefined_likelihood_outside_the_support_is_ignored():
    moved = ends(lambda x: jnp.log(x[:, 0]), unit_interval, np.full((200, 1), 0.5))
    assert int(moved.undefined) == 0
    assert np.isfinite(moved.log_likelihood).all()


def test_an_undefined_likelihood_inside_the_support_is_counted_and_rejected():
    moved = ends(lambda x: jnp.log(x[:, 0] - 0.3), unit_interval, np.full((200, 1), 0.5))
    assert int(moved.undefined) > 0
    assert (moved.positions > 0.3).all()


def test_no_particle_enters_a_region_of_zero_likelihood_and_one_inside_may_leave():
    def half(x):
        return jnp.where(x[:, 0] > 0.5, 0.0, -jnp.inf)

    moved = ends(half, unit_interval, np.array([[0.2]] * 50 + [[0.8]] * 50))
    assert (moved.positions > 0.5).all()


def test_density_values_are_those_of_the_positions():
    def slope(x):
        return -3 * x[:, 0]

    moved = ends(slope, unit_interval, np.full((50, 1), 0.5))
    np.testing.assert_array_equal(moved.log_likelihood, slope(moved.positions))
    np.testing.assert_array_equal(moved.log_prior, unit_interval(moved.positions))


def test_acceptance_is_the_share_of_proposals():
    flat = ends(lambda x: 0 * x[:, 0], lambda x: 0 * x[:, 0], np.zeros((10, 1)))
    assert float(flat.acceptance) == pytest.approx(1.0)
