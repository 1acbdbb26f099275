"""Joint and cut on a linear Gaussian problem, where both have closed forms and differ."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp, ndtri
from scipy.stats import multivariate_normal, qmc

from strandline.errors import InvalidInput
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import (
    Cut,
    Posterior,
    Reading,
    cut_from_datatree,
    from_datatree,
    histogram_mode,
    mode_bins,
    nuisance_values,
    pooled,
    read,
    to_datatree,
    write,
)
from strandline.priors import Normal, ScaledBeta, Uniform

BOX = (-8.0, 8.0)
SPACE = ParameterSpace(
    (
        Parameter("a", Normal(0.0, 1.0), box=BOX),
        Parameter("theta", Normal(0.0, 1.0), box=BOX, nuisance=True),
        Parameter("b", Normal(0.0, 1.0), box=BOX),
    )
)
"""The nuisance input stands between the calibrated ones: mixed up columns would show."""
G = np.array([[1.0, 1.0, 0.0], [0.0, -0.5, 1.0]])
"""Two measurements: a + θ and b - θ/2."""
SD, SEEN = 0.3, np.array([2.0, -0.5])
SHRINK = 1 / (1 + SD**2)
"""Of p(a, b | θ, Y): mean SHRINK·(y - g θ) and variance SHRINK·SD²."""


def log_likelihood(x):
    return -0.5 * (((x @ G.T - SEEN) / SD) ** 2).sum(axis=-1)


def weighted(space, likelihood, mean, covariance, number, seed):
    """Return draws of a normal distribution twice as wide as the posterior, weighted to it, and their evidence."""
    z = ndtri(qmc.Sobol(len(mean), rng=np.random.default_rng(seed)).random(number))
    draws = mean + 2**0.5 * z @ np.linalg.cholesky(covariance).T
    values = likelihood(draws)
    log_weights = values + space.log_prior(draws) - multivariate_normal(mean, 2 * covariance).logpdf(draws)
    log_evidence = float(logsumexp(log_weights) - np.log(number))
    return SimpleNamespace(
        positions=draws, log_weights=log_weights - logsumexp(log_weights), log_likelihood=values,
        log_evidence=log_evidence,
    )  # fmt: skip


def exact_extended():
    covariance = np.linalg.inv(np.eye(3) + G.T @ G / SD**2)
    return covariance @ G.T @ SEEN / SD**2, covariance


def exact_joint():
    """Return mean and covariance of (a, b): the Gaussian posterior of all three, θ left out."""
    mean, covariance = exact_extended()
    return mean[[0, 2]], covariance[np.ix_([0, 2], [0, 2])]


def exact_cut():
    """Return the same of E over θ ~ N(0, 1) of p(a, b | θ, Y)."""
    g = G[:, 1]
    return SHRINK * SEEN, SHRINK * SD**2 * np.eye(2) + SHRINK**2 * np.outer(g, g)


def errors(reading, exact):
    """Return the largest error of a mean, in standard deviations, and of the covariance, relative to the variances."""
    mean, covariance = exact
    sd = np.sqrt(np.diag(covariance))
    return np.abs((reading.mean - mean) / sd).max(), np.abs((reading.covariance - covariance) / np.outer(sd, sd)).max()


@pytest.fixture(scope="module")
def cut() -> Cut:
    values = nuisance_values(SPACE, 32)

    def given(theta, seed):
        def likelihood(x):
            return log_likelihood(np.stack([x[:, 0], np.full(len(x), theta), x[:, 1]], axis=1))

        mean = SHRINK * (SEEN - G[:, 1] * theta)
        return weighted(SPACE.calibrated_space, likelihood, mean, SHRINK * SD**2 * np.eye(2), 256, seed)

    return pooled(SPACE, values, [given(float(theta), k) for k, (theta,) in enumerate(values)])


@pytest.fixture(scope="module")
def joint() -> Reading:
    one = weighted(SPACE, log_likelihood, *exact_extended(), 4096, 0)
    log_prior = SPACE.log_prior(one.positions)
    return Reading(Posterior(SPACE, one.positions, one.log_weights, one.log_likelihood, log_prior, one.log_evidence))


def test_each_reading_is_its_closed_form_and_none_is_taken_for_the_other(joint, cut):
    """Planted: weights with Z(θ) left in, which turn the cut into the joint reading."""
    assert max(errors(joint, exact_joint())) < 0.06
    assert max(errors(cut, exact_cut())) < 0.06
    assert min(errors(joint, exact_cut())) > 0.3
    assert min(errors(cut, exact_joint())) > 0.3
    assert joint.names == cut.names == ("a", "b")
    old = cut.extended
    log_weights = old.log_weights + cut.log_evidence[cut.value_index]
    log_weights -= np.logaddexp.reduce(log_weights)
    wrong = Reading(Posterior(SPACE, old.draws, log_weights, old.log_likelihood, old.log_prior, 0.0))
    assert min(errors(wrong, exact_cut())) > 0.3
    assert max(errors(wrong, exact_joint())) < 0.25


def test_the_parts_of_the_cut(cut, joint):
    total = np.bincount(cut.value_index, weights=cut.extended.weights)
    np.testing.assert_allclose(total, 1 / 32, rtol=1e-10)
    np.testing.assert_array_equal(cut.extended.draws[:, 1], cut.values[cut.value_index, 0])
    raw = log_likelihood(cut.extended.draws)
    np.testing.assert_allclose(cut.extended.log_likelihood, raw - cut.log_evidence[cut.value_index], atol=1e-9)
    np.testing.assert_allclose(cut.extended.log_prior, SPACE.log_prior(cut.extended.draws))
    assert cut.extended.log_evidence == 0.0
    r = SEEN - cut.values @ G[:, 1:2].T
    exact = np.log(SD**2 * SHRINK) - 0.5 * (r**2).sum(axis=1) * SHRINK
    np.testing.assert_allclose(cut.log_evidence, exact, atol=0.05)
    assert cut.joint_log_evidence == pytest.approx(joint.extended.log_evidence, abs=0.1)


def test_summaries_are_those_of_the_calibrated_columns(joint):
    extended = joint.extended
    np.testing.assert_allclose(joint.mean, extended.weights @ extended.draws[:, [0, 2]])
    np.testing.assert_allclose(joint.sd, extended.sd[[0, 2]])
    np.testing.assert_array_equal(joint.quantiles([0.1, 0.9]), extended.quantiles([0.1, 0.9])[:, [0, 2]])
    np.testing.assert_allclose(joint.gaussian.covariance, joint.covariance)
    mode = histogram_mode(extended.draws[:, [0, 2]], extended.weights, bounds=[BOX, BOX], bins=30)
    np.testing.assert_array_equal(joint.map_estimate, mode)
    assert np.abs(joint.map_estimate - exact_joint()[0]).max() < 0.8, "1.5 bins"
    assert [mode_bins(dim) for dim in (1, 2, 3, 4, 6)] == [30, 30, 20, 10, 10]


def test_values_of_nuisance_inputs_are_the_middles_of_strata():
    prior = ScaledBeta(2.6, 1.4, 0.0, 110.0)
    space = ParameterSpace((Parameter("E", Uniform(0.0, 1.0)), Parameter("V", prior, nuisance=True)))
    values = nuisance_values(space, 32)
    assert values.shape == (32, 1)
    np.testing.assert_allclose(prior.cdf(values[:, 0]), (np.arange(32) + 0.5) / 32, atol=1e-12)
    two = [Parameter(name, Uniform(0.0, 1.0), nuisance=True) for name in ("s", "t")]
    both = ParameterSpace((two[0], Parameter("E", Uniform(0.0, 1.0)), two[1]))
    for number in (20, 32):
        values = nuisance_values(both, number)
        assert values.shape == (number, 2)
        assert ((values > 0) & (values < 1)).all()
        for column in values.T:
            np.testing.assert_array_equal(np.sort(column * 32 - 0.5) % 1, 0.0)
            assert len(set(column.tolist())) == number
    assert (np.histogram2d(*values.T, bins=(4, 8))[0] == 1).all(), "the last ones fill the square"


def test_what_is_refused():
    with pytest.raises(InvalidInput, match="0 for 1 nuisance"):
        nuisance_values(SPACE, 0)
    with pytest.raises(InvalidInput, match="32 for 0 nuisance"):
        nuisance_values(SPACE.calibrated_space, 32)
    one = weighted(SPACE.calibrated_space, lambda x: x[:, 0], np.zeros(2), np.eye(2), 4, 0)
    with pytest.raises(InvalidInput, match="one for each of the 2 values"):
        pooled(SPACE, np.zeros((2, 1)), [one])


def test_both_readings_survive_the_file(tmp_path, joint, cut):
    tree = to_datatree(joint.extended, seed=1, number=50, cut=cut)
    write(tree, tmp_path / "posterior.nc")
    back = read(tmp_path / "posterior.nc")
    assert back.identical(tree)
    found = cut_from_datatree(back, SPACE)
    assert found is not None
    for name in ("values", "log_evidence", "value_index"):
        np.testing.assert_array_equal(getattr(found, name), getattr(cut, name))
    np.testing.assert_array_equal(found.extended.draws, cut.extended.draws)
    np.testing.assert_allclose(found.mean, cut.mean, rtol=1e-12)
    np.testing.assert_array_equal(from_datatree(back, SPACE).draws, joint.extended.draws)
    assert back["cut_posterior"]["a"].dims == ("chain", "draw")
    assert back["weighted_cut_posterior"]["nuisance_input"].to_numpy().tolist() == ["theta"]
    assert back["posterior"]["theta"].attrs["nuisance"] == 1
    assert "nuisance" not in back["posterior"]["a"].attrs
    without = to_datatree(joint.extended, seed=1, number=50)
    assert set(without.children) == {"posterior", "weighted_posterior", "prior"}
    assert cut_from_datatree(without, SPACE) is None
