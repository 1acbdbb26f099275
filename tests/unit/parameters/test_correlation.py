"""Correlated inputs: their marginals, ranks and density, and what is refused."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from strandline.calibration.what_if import Alternative
from strandline.foundations import InvalidInput
from strandline.parameters import LogNormal, LogUniform, Normal, Parameter, ParameterSpace, ScaledBeta, Uniform

INPUTS = (
    Parameter("E", LogNormal(5.9, 0.3), box=(150.0, 800.0)),
    Parameter("nu", ScaledBeta(2.0, 3.0, -0.8, 0.5)),
    Parameter("load", Uniform(50.0, 150.0)),
    Parameter("tau", LogUniform(0.1, 10.0)),
    Parameter("tilt", Normal(0.0, 1.0), box=(-1.0, 3.0)),
)
R = {("E", "nu"): 0.6, ("tau", "nu"): -0.4, ("E", "tilt"): 0.3}
SPACE = ParameterSpace(INPUTS, R)
DRAWS = SPACE.prior_quantiles(np.random.default_rng(0).random((20000, 5)))


def matrix():
    found = np.eye(5)
    for pair, value in R.items():
        i, j = (SPACE.names.index(name) for name in pair)
        found[i, j] = found[j, i] = value
    return found


def test_each_input_keeps_its_prior_and_ranks_are_those_of_the_copula():
    for k, one in enumerate(SPACE):
        assert stats.kstest(DRAWS[:, k], one.truncated_prior.cdf).pvalue > 1e-3
    ranks = stats.spearmanr(DRAWS).statistic
    np.testing.assert_allclose(ranks, 6 / np.pi * np.arcsin(matrix() / 2), atol=4 / 20000**0.5)


def test_the_log_prior_is_the_normal_density_in_other_variables():
    x = DRAWS[:50]
    priors = [one.truncated_prior for one in SPACE]
    z = np.stack([stats.norm.ppf(prior.cdf(x[:, k])) for k, prior in enumerate(priors)], axis=1)
    jacobian = sum(prior.log_density(x[:, k]) - stats.norm.logpdf(z[:, k]) for k, prior in enumerate(priors))
    exact = stats.multivariate_normal(np.zeros(5), matrix()).logpdf(z) + jacobian
    np.testing.assert_allclose(SPACE.log_prior(x), exact, rtol=1e-10)
    np.testing.assert_allclose(jax.jit(SPACE.log_prior)(jnp.asarray(x)), exact, rtol=1e-9)
    assert np.isfinite(jax.hessian(SPACE.log_prior)(jnp.asarray(x[0]))).all()


def test_the_density_integrates_to_one():
    two = ParameterSpace(INPUTS[:2], {("nu", "E"): 0.6})
    u = (np.stack(np.meshgrid(*[np.arange(400)] * 2), axis=-1).reshape(-1, 2) + 0.5) / 400
    volume = np.prod(two.high - two.low)
    assert np.exp(two.log_prior(two.to_physical(u))).mean() * volume == pytest.approx(1.0, abs=1e-3)


def test_shares_are_the_inverse_and_marginals_know_no_correlation():
    p = np.random.default_rng(1).random((20, 5))
    np.testing.assert_allclose(SPACE.prior_shares(SPACE.prior_quantiles(p)), p, atol=1e-9)
    alone = ParameterSpace(INPUTS)
    np.testing.assert_array_equal(SPACE.marginal_shares(DRAWS), alone.prior_shares(DRAWS))
    np.testing.assert_array_equal(SPACE.marginal_quantiles(p[:, 0]), alone.prior_quantiles(np.tile(p[:, :1], 5)))
    np.testing.assert_array_equal(SPACE.prior_sd, alone.prior_sd)


def test_without_correlation_nothing_changes_and_a_subspace_keeps_it():
    assert repr(ParameterSpace(INPUTS)) == f"ParameterSpace(parameters={INPUTS!r})"
    assert hash(SPACE) != hash(ParameterSpace(INPUTS[:2]))
    assert SPACE.subspace((0, 1, 3, 4)).correlation == R
    assert SPACE.calibrated_space == SPACE
    with pytest.raises(InvalidInput, match="correlation of E and nu"):
        SPACE.subspace((0, 3, 4))
    with pytest.raises(InvalidInput, match="one of the two is known"):
        Alternative("E known", "fix", "E", SPACE, fixed={"E": 400.0})


REFUSED = {
    "two of the inputs": {("E", "mu"): 0.5},
    "two of the inputs .* once": {("E", "nu"): 0.5, ("nu", "E"): 0.4},
    "correlation of E and E": {("E", "E"): 0.5},
    "above -1 and below 1": {("E", "nu"): 1.0},
    "got nan": {("E", "nu"): float("nan")},
    "positive definite": {("E", "nu"): 0.9, ("nu", "load"): 0.9, ("load", "E"): -0.9},
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_no_correlation_is_refused_in_a_line(words):
    with pytest.raises(InvalidInput, match=words) as caught:
        ParameterSpace(INPUTS, REFUSED[words])
    assert "\n" not in str(caught.value)


def test_a_nuisance_input_correlates_with_its_kind_only():
    nuisance = [replace(one, nuisance=one.name in ("load", "tau")) for one in INPUTS]
    with pytest.raises(InvalidInput, match="one of them is nuisance"):
        ParameterSpace(tuple(nuisance), {("E", "load"): 0.5})
    both = ParameterSpace(tuple(nuisance), {("tau", "load"): 0.5, ("E", "nu"): 0.2})
    assert both.calibrated_space.correlation == {("E", "nu"): 0.2}
