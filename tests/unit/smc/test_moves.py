"""Metropolis moves: their proposals, and that they respect the target."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.smc import metropolis
from strandline.smc.moves import proposal_factor, proposal_scale


def test_the_scale_is_the_papers_and_the_factor_that_of_the_weighted_covariance():
    np.testing.assert_allclose([float(proposal_scale(jnp.asarray(p))) for p in (0.0, 0.25, 1.0)], [1 / 81, 1 / 9, 1])
    rng = np.random.default_rng(0)
    x, w = rng.normal(size=(300, 3)) * [1, 100, 1e-4], rng.dirichlet(np.ones(300))
    factor = np.asarray(proposal_factor(jnp.asarray(x), jnp.asarray(w), jnp.zeros(3)))
    np.testing.assert_allclose(factor @ factor.T, np.cov(x.T, aweights=w, ddof=0), rtol=1e-8)
    assert np.all(np.triu(factor, 1) == 0)


def test_a_collapsed_population_can_still_move():
    for x in (
        np.full((2, 4), 3.7),
        np.linspace(0, 1, 2)[:, None] * np.arange(4),
        np.array([[0.0, 1, 2, 3], [1, 1, 5, 2]]),
    ):
        factor = proposal_factor(jnp.asarray(x), jnp.full(2, 0.5), jnp.full(4, 1e-8))
        assert np.isfinite(factor).all()
        assert (np.diagonal(factor) > 0).all()


LURES, OUTSIDE, INSIDE, HALF, FLAT = range(5)
"""What the likelihood of a particle is, by its second coordinate, which does not move."""


def log_likelihood(x):
    at, kind = x[:, 0], x[:, 1]
    values = 100 * jnp.abs(at - 0.5), jnp.log(at), jnp.log(at - 0.3), jnp.where(at > 0.5, 0.0, -jnp.inf), 0 * at
    return jnp.select([kind == number for number in range(5)], values)


def log_prior(x):
    """Return that of the unit interval, or a flat one."""
    return jnp.where((x[:, 1] == FLAT) | ((x[:, 0] >= 0) & (x[:, 0] <= 1)), 0.0, -jnp.inf)


@jax.jit
def moved(x):
    options = {"temperature": jnp.asarray(1.0), "factor": jnp.diag(jnp.array([0.5, 0.0])), "steps": 30}
    target = log_likelihood, log_prior
    return metropolis(jax.random.key(1), x, log_likelihood(x), log_prior(x), target=target, **options)


def ends(kind, start=0.5):
    """Return where 100 particles are after thirty moves, and all that is known of them."""
    found = moved(np.stack([np.broadcast_to(start, 100), np.full(100, float(kind))], axis=1))
    return np.asarray(found.positions)[:, 0], found


def test_no_particle_leaves_the_support_even_where_the_likelihood_lures():
    at, found = ends(LURES)
    assert ((at >= 0) & (at <= 1)).all()
    assert 0 < float(found.acceptance) < 1
    np.testing.assert_allclose(found.log_likelihood, log_likelihood(found.positions))
    np.testing.assert_array_equal(found.log_prior, log_prior(found.positions))


def test_an_undefined_likelihood_is_ignored_outside_the_support_and_counted_inside():
    _, found = ends(OUTSIDE)
    assert int(found.undefined) == 0
    assert np.isfinite(found.log_likelihood).all()
    at, found = ends(INSIDE)
    assert int(found.undefined) > 0
    assert (at > 0.3).all()


def test_no_particle_enters_a_region_of_zero_likelihood_and_one_inside_may_leave():
    assert (ends(HALF, start=np.repeat([0.2, 0.8], 50))[0] > 0.5).all()


def test_acceptance_is_the_share_of_proposals():
    assert float(ends(FLAT)[1].acceptance) == pytest.approx(1.0)
