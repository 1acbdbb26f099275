"""Joint and cut on a linear Gaussian problem, where both have closed forms and differ."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

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
from strandline.smc import SMCSettings, sample, sample_each

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
SETTINGS = SMCSettings(rejuvenation_steps=10, zeta=0.5)


def log_likelihood(x):
    return -0.5 * (((x @ G.T - SEEN) / SD) ** 2).sum(axis=-1)


def given(x, theta):
    return log_likelihood(jnp.stack([x[:, 0], jnp.broadcast_to(theta[0], len(x)), x[:, 1]], axis=1))


def exact_joint():
    """Return mean and covariance of (a, b): the Gaussian posterior of all three, θ left out."""
    covariance = np.linalg.inv(np.eye(3) + G.T @ G / SD**2)
    mean = covariance @ G.T @ SEEN / SD**2
    return mean[[0, 2]], covariance[np.ix_([0, 2], [0, 2])]


def exact_cut(theta_variance=1.0):
    """Return the same of E over θ ~ N(0, v) of p(a, b | θ, Y): mean shrink·(y - g θ), g = (1, -½)."""
    shrink = 1 / (1 + SD**2)
    g = G[:, 1]
    return shrink * SEEN, shrink * SD**2 * np.eye(2) + shrink**2 * theta_variance * np.outer(g, g)


def errors(reading, exact):
    """Return the largest error of a mean, in standard deviations, and of the covariance, relative to the variances."""
    mean, covariance = exact
    sd = np.sqrt(np.diag(covariance))
    return np.abs((reading.mean - mean) / sd).max(), np.abs((reading.covariance - covariance) / np.outer(sd, sd)).max()


def conditionals(values, seed=0, number=400):
    calibrated = SPACE.calibrated_space
    uniform = np.random.default_rng(seed).random((len(values) * number, 2))
    initial = calibrated.prior_quantiles(uniform).reshape(len(values), number, 2)
    return sample_each(jax.random.key(seed), given, calibrated.log_prior, initial, values, settings=SETTINGS)


def cut_reading(seed=0) -> Cut:
    values = nuisance_values(SPACE, 32)
    return pooled(SPACE, values, conditionals(values, seed))


@pytest.fixture(scope="module")
def cut() -> Cut:
    return cut_reading()


@pytest.fixture(scope="module")
def joint() -> Reading:
    initial = SPACE.prior_quantiles(np.random.default_rng(0).random((6000, 3)))
    found = sample(jax.random.key(0), log_likelihood, SPACE.log_prior, initial, settings=SETTINGS)
    return Reading(
        Posterior(SPACE, found.positions, found.log_weights, found.log_likelihood, found.log_prior, found.log_evidence)
    )


def test_each_reading_is_its_closed_form(joint, cut):
    assert max(errors(joint, exact_joint())) < 0.06
    assert max(errors(cut, exact_cut())) < 0.06
    assert joint.names == cut.names == ("a", "b")


def test_the_readings_taken_for_each_other_are_caught(joint, cut):
    assert min(errors(joint, exact_cut())) > 0.3
    assert min(errors(cut, exact_joint())) > 0.3


def test_planted_bug_conditionals_that_are_not_normalised_are_caught(cut):
    """Weights with Z(θ) left in: the cut turns into the joint reading."""
    log_weights = cut.extended.log_weights + cut.log_evidence[cut.value_index]
    log_weights -= np.logaddexp.reduce(log_weights)
    old = cut.extended
    wrong = Reading(Posterior(SPACE, old.draws, log_weights, old.log_likelihood, old.log_prior, 0.0))
    assert min(errors(wrong, exact_cut())) > 0.3
    assert max(errors(wrong, exact_joint())) < 0.25


def test_every_value_has_the_same_weight(cut):
    total = np.bincount(cut.value_index, weights=cut.extended.weights)
    np.testing.assert_allclose(total, 1 / 32, rtol=1e-10)
    np.testing.assert_array_equal(cut.extended.draws[:, 1], cut.values[cut.value_index, 0])


def test_evidence_given_each_value_is_exact(cut, joint):
    r = SEEN - cut.values @ G[:, 1:2].T
    exact = np.log(SD**2 / (1 + SD**2)) - 0.5 * (r**2).sum(axis=1) / (1 + SD**2)
    np.testing.assert_allclose(cut.log_evidence, exact, atol=0.5)
    assert np.sqrt(np.mean((cut.log_evidence - exact) ** 2)) < 0.2
    assert cut.joint_log_evidence == pytest.approx(joint.extended.log_evidence, abs=0.2)


def test_the_likelihood_of_the_cut_is_over_the_evidence(cut):
    raw = log_likelihood(cut.extended.draws)
    np.testing.assert_allclose(cut.extended.log_likelihood, raw - cut.log_evidence[cut.value_index], atol=1e-9)
    np.testing.assert_allclose(cut.extended.log_prior, SPACE.log_prior(cut.extended.draws))
    assert cut.extended.log_evidence == 0.0


def test_the_same_seed_gives_the_same_bits(cut):
    again, other = cut_reading(), cut_reading(seed=1)
    np.testing.assert_array_equal(again.extended.draws, cut.extended.draws)
    np.testing.assert_array_equal(again.extended.log_weights, cut.extended.log_weights)
    np.testing.assert_array_equal(again.log_evidence, cut.log_evidence)
    assert not np.array_equal(other.extended.draws, cut.extended.draws)


def test_summaries_are_those_of_the_calibrated_columns(joint):
    extended = joint.extended
    np.testing.assert_allclose(joint.mean, extended.weights @ extended.draws[:, [0, 2]])
    np.testing.assert_allclose(joint.sd, extended.sd[[0, 2]])
    np.testing.assert_array_equal(joint.quantiles([0.1, 0.9]), extended.quantiles([0.1, 0.9])[:, [0, 2]])
    np.testing.assert_allclose(joint.gaussian.covariance, joint.covariance)
    mode = histogram_mode(extended.draws[:, [0, 2]], extended.weights, bounds=[BOX, BOX], bins=30)
    np.testing.assert_array_equal(joint.map_estimate, mode)
    assert np.abs(joint.map_estimate - exact_joint()[0]).max() < 0.8  # 1.5 bins


@pytest.mark.parametrize(("dim", "bins"), [(1, 30), (2, 30), (3, 20), (4, 10), (6, 10)])
def test_bins_of_the_mode(dim, bins):
    assert mode_bins(dim) == bins


def test_values_of_one_input_are_the_middles_of_strata():
    prior = ScaledBeta(2.6, 1.4, 0.0, 110.0)
    space = ParameterSpace((Parameter("E", Uniform(0.0, 1.0)), Parameter("V", prior, nuisance=True)))
    values = nuisance_values(space, 32)
    assert values.shape == (32, 1)
    np.testing.assert_allclose(prior.cdf(values[:, 0]), (np.arange(32) + 0.5) / 32, atol=1e-12)
    draws = prior.quantile(np.random.default_rng(0).random(200_000))
    assert values.mean() == pytest.approx(draws.mean(), rel=0.005)
    assert values.std() == pytest.approx(draws.std(), rel=0.02)


@pytest.mark.parametrize("number", [32, 20])
def test_values_of_several_inputs_fill_the_square(number):
    two = [Parameter(name, Uniform(0.0, 1.0), nuisance=True) for name in ("s", "t")]
    values = nuisance_values(ParameterSpace((two[0], Parameter("E", Uniform(0.0, 1.0)), two[1])), number)
    assert values.shape == (number, 2)
    assert ((values > 0) & (values < 1)).all()
    for column in values.T:
        np.testing.assert_array_equal(np.sort(column * 32 - 0.5) % 1, 0.0)
        assert len(set(column.tolist())) == number
    if number == 32:
        counts = np.histogram2d(*values.T, bins=(4, 8))[0]
        assert (counts == 1).all()


def test_bad_requests():
    with pytest.raises(InvalidInput, match="0 for 1 nuisance"):
        nuisance_values(SPACE, 0)
    with pytest.raises(InvalidInput, match="32 for 0 nuisance"):
        nuisance_values(SPACE.calibrated_space, 32)
    one = SimpleNamespace(
        positions=np.zeros((1, 2)), log_weights=np.zeros(1), log_likelihood=np.zeros(1), log_evidence=0.0
    )
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


def test_a_file_without_the_cut_reading_opens(joint):
    tree = to_datatree(joint.extended, seed=1, number=50)
    assert set(tree.children) == {"posterior", "weighted_posterior", "prior"}
    assert cut_from_datatree(tree, SPACE) is None
