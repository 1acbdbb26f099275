"""Joint and cut on a linear Gaussian problem, where closed forms differ; posteriors in files, also read by ArviZ."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy.special import logsumexp, ndtri
from scipy.stats import multivariate_normal, qmc

from strandline.foundations import InvalidInput
from strandline.interface import Interface, Observation
from strandline.parameters import Normal, Parameter, ParameterSpace, ScaledBeta, Uniform
from strandline.posterior import MarginalPosterior, Posterior, histogram_mode, mode_bins, nuisance_values, pooled
from strandline.posterior.netcdf import cut_from_datatree, from_datatree, read, to_datatree, write

BOX, NORMAL = (-8.0, 8.0), Normal(0.0, 1.0)
SPACE = ParameterSpace(tuple(Parameter(name, NORMAL, box=BOX, nuisance=name == "t") for name in ("a", "t", "b")))
"""The nuisance input stands between the calibrated ones: mixed up columns would show."""
G = np.array([[1.0, 1.0, 0.0], [0.0, -0.5, 1.0]])
"""Two measurements: a + θ and b - θ/2."""
SD, SEEN = 0.3, np.array([2.0, -0.5])
SHRINK = 1 / (1 + SD**2)
"""Of p(a, b | θ, Y): mean SHRINK·(y - g θ) and variance SHRINK·SD²."""
WHOLE = np.linalg.inv(np.eye(3) + G.T @ G / SD**2)
CENTRE = WHOLE @ G.T @ SEEN / SD**2
JOINT = CENTRE[[0, 2]], WHOLE[np.ix_([0, 2], [0, 2])]
"""Mean and covariance of (a, b): the Gaussian posterior of all three, θ left out."""
CUT = SHRINK * SEEN, SHRINK * SD**2 * np.eye(2) + SHRINK**2 * np.outer(G[:, 1], G[:, 1])
"""The same of E over θ ~ N(0, 1) of p(a, b | θ, Y)."""


def log_likelihood(x):
    return -0.5 * (((x @ G.T - SEEN) / SD) ** 2).sum(axis=-1)


def weighted(space, likelihood, mean, covariance, number, seed):
    """Return draws of a normal distribution twice as wide as the posterior, weighted to it, and their evidence."""
    z = ndtri(qmc.Sobol(len(mean), rng=np.random.default_rng(seed)).random(number))
    draws = mean + 2**0.5 * z @ np.linalg.cholesky(covariance).T
    values = likelihood(draws)
    log_weights = values + space.log_prior(draws) - multivariate_normal(mean, 2 * covariance).logpdf(draws)
    total = float(logsumexp(log_weights))
    evidence = {"log_likelihood": values, "log_evidence": total - np.log(number)}
    return SimpleNamespace(positions=draws, log_weights=log_weights - total, **evidence)


def errors(reading, exact):
    """Return the largest error of a mean, in standard deviations, and of the covariance, relative to the variances."""
    mean, covariance = exact
    sd = np.sqrt(np.diag(covariance))
    return np.abs((reading.mean - mean) / sd).max(), np.abs((reading.covariance - covariance) / np.outer(sd, sd)).max()


@pytest.fixture(scope="module")
def cut():
    values = nuisance_values(SPACE, 32)

    def given(theta, seed):
        mean = SHRINK * (SEEN - G[:, 1] * theta)
        likelihood = lambda x: log_likelihood(np.insert(x, 1, theta, axis=1))  # noqa: E731
        return weighted(SPACE.calibrated_space, likelihood, mean, SHRINK * SD**2 * np.eye(2), 256, seed)

    return pooled(SPACE, values, [given(float(theta), k) for k, (theta,) in enumerate(values)])


@pytest.fixture(scope="module")
def joint():
    one = weighted(SPACE, log_likelihood, CENTRE, WHOLE, 4096, 0)
    log_prior = SPACE.log_prior(one.positions)
    return MarginalPosterior(
        Posterior(SPACE, one.positions, one.log_weights, one.log_likelihood, log_prior, one.log_evidence)
    )


def test_each_reading_is_its_closed_form_and_none_is_taken_for_the_other(joint, cut):
    """Planted: weights with Z(θ) left in, which turn the cut into the joint reading."""
    assert max(*errors(joint, JOINT), *errors(cut, CUT)) < 0.06
    assert min(*errors(joint, CUT), *errors(cut, JOINT)) > 0.3
    old = cut.extended
    log_weights = old.log_weights + cut.log_evidence[cut.value_index]
    log_weights -= np.logaddexp.reduce(log_weights)
    wrong = MarginalPosterior(Posterior(SPACE, old.draws, log_weights, old.log_likelihood, old.log_prior, 0.0))
    assert min(errors(wrong, CUT)) > 0.3
    assert max(errors(wrong, JOINT)) < 0.25


def test_the_parts_of_the_cut_and_summaries_of_the_calibrated_columns(cut, joint):
    extended = cut.extended
    total = np.bincount(cut.value_index, weights=extended.weights)
    np.testing.assert_allclose(total, 1 / 32, rtol=1e-10)
    np.testing.assert_array_equal(extended.draws[:, 1], cut.values[cut.value_index, 0])
    raw = log_likelihood(extended.draws)
    np.testing.assert_allclose(extended.log_likelihood, raw - cut.log_evidence[cut.value_index], atol=1e-9)
    r = SEEN - cut.values @ G[:, 1:2].T
    exact = np.log(SD**2 * SHRINK) - 0.5 * (r**2).sum(axis=1) * SHRINK
    np.testing.assert_allclose(cut.log_evidence, exact, atol=0.05)
    assert cut.joint_log_evidence == pytest.approx(joint.extended.log_evidence, abs=0.1)
    extended = joint.extended
    np.testing.assert_allclose(joint.mean, extended.weights @ extended.draws[:, [0, 2]])
    np.testing.assert_array_equal(joint.quantiles([0.1, 0.9]), extended.quantiles([0.1, 0.9])[:, [0, 2]])
    np.testing.assert_array_equal(joint.quantiles(0.9), joint.quantiles([0.1, 0.9])[1])
    mode = histogram_mode(extended.draws[:, [0, 2]], extended.weights, bounds=[BOX, BOX], bins=30)
    np.testing.assert_array_equal(joint.map_estimate, mode)
    assert [mode_bins(dim) for dim in (1, 2, 3, 4, 6)] == [30, 30, 20, 10, 10]


def test_values_of_nuisance_inputs_are_the_middles_of_strata():
    prior = ScaledBeta(2.6, 1.4, 0.0, 110.0)
    values = nuisance_values(ParameterSpace((SPACE["a"], Parameter("V", prior, nuisance=True))), 32)
    np.testing.assert_allclose(prior.cdf(values), (np.arange(32)[:, None] + 0.5) / 32, atol=1e-12)
    first, second = (Parameter(name, Uniform(0.0, 1.0), nuisance=True) for name in ("s", "t"))
    for number in (20, 32):
        values = nuisance_values(ParameterSpace((first, SPACE["a"], second)), number)
        for column in values.T:
            np.testing.assert_array_equal(np.sort(column * 32 - 0.5) % 1, 0.0)
            assert len(set(column.tolist())) == number
    assert (np.histogram2d(*values.T, bins=(4, 8))[0] == 1).all(), "the last ones fill the square"


def test_what_is_refused():
    for call, words in (
        (lambda: nuisance_values(SPACE, 0), "0 for 1 nuisance"),
        (lambda: nuisance_values(SPACE.calibrated_space, 32), "32 for 0 nuisance"),
    ):
        with pytest.raises(InvalidInput, match=words):
            call()


def test_both_readings_survive_the_file(tmp_path, joint, cut):
    tree = to_datatree(joint.extended, seed=1, number=50, cut=cut)
    write(tree, tmp_path / "posterior.nc")
    back = read(tmp_path / "posterior.nc")
    found = cut_from_datatree(back, SPACE)
    for name in ("values", "log_evidence", "value_index"):
        np.testing.assert_array_equal(getattr(found, name), getattr(cut, name))
    np.testing.assert_array_equal(found.extended.draws, cut.extended.draws)
    np.testing.assert_allclose(found.mean, cut.mean, rtol=1e-12)
    assert [back["posterior"][name].attrs.get("nuisance") for name in SPACE.names] == [None, 1, None]
    assert cut_from_datatree(to_datatree(joint.extended, seed=1, number=50), SPACE) is None


INPUTS = ParameterSpace((Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", ScaledBeta(3.0, 2.0, -0.8, 0.5))))
OBSERVED = Observation(Interface.polyline(np.array([[0.0, 0.0], [0.5, 0.4], [1.0, 0.0]])), 5e-4, "t1")


def weighted_posterior(number=300):
    draws = INPUTS.prior_quantiles(np.random.default_rng(0).uniform(size=(number, 2)))
    log_likelihood = -0.5 * ((draws[:, 0] - 300) / 80) ** 2 + 2 * draws[:, 1]
    log_weights = log_likelihood - np.logaddexp.reduce(log_likelihood)
    return Posterior(INPUTS, draws, log_weights, log_likelihood, INPUTS.log_prior(draws), -3.5)


def test_the_summary_of_arviz_is_the_weighted_mean_and_the_prior_group_holds_the_prior(tmp_path):
    posterior, path = weighted_posterior(4000), tmp_path / "posterior.nc"
    tree = to_datatree(posterior, seed=1)
    write(tree, path)
    with warnings.catch_warnings(action="ignore"):
        import arviz

        summary = arviz.summary(arviz.from_netcdf(path), round_to="none")
    error = 4 * posterior.sd / np.sqrt(posterior.ess)
    assert (np.abs(summary["mean"].to_numpy() - posterior.mean) < error).all()
    np.testing.assert_allclose(summary["sd"], posterior.sd, rtol=0.1)
    planted = np.abs(posterior.draws.mean(axis=0) - posterior.mean)
    assert (planted > error).all(), "storing the particles as if they had equal weights must be caught"
    uniform = np.sort(INPUTS["nu"].truncated_prior.cdf(tree["prior"]["nu"].to_numpy().ravel()))
    assert np.abs(uniform - (np.arange(4000) + 0.5) / 4000).max() < 1.63 / np.sqrt(4000)


def test_a_posterior_survives_the_file_which_depends_on_its_content_alone(tmp_path):
    posterior, files, path = weighted_posterior(), [], tmp_path / "posterior.nc"
    for seed in (3, 3, 4):
        tree = to_datatree(posterior, seed=seed, attrs={"study": "S3"}, observed=[OBSERVED], number=50)
        write(tree, path)
        files.append(path.read_bytes())
    assert files[0] == files[1] != files[2]
    back = read(path)
    path.unlink()
    assert back.identical(tree)
    assert back.attrs == {"inference_library": "strandline", "seed": 4, "study": "S3"}
    drawn, seen = back["posterior"], back["observed_data"]["interface_t1"]
    assert (drawn["E"].attrs["units"], drawn["E"].dims, drawn.sizes["draw"]) == ("Pa", ("chain", "draw"), 50)
    np.testing.assert_array_equal(seen, OBSERVED.interface.points)
    again = from_datatree(back, INPUTS)
    np.testing.assert_array_equal(again.draws, posterior.draws)
    np.testing.assert_array_equal(again.log_weights, posterior.log_weights)
    assert again.log_evidence == posterior.log_evidence
    with pytest.raises(InvalidInput, match="rho"):
        from_datatree(back, ParameterSpace((Parameter("rho", Uniform(0.0, 1.0)),)))
    with pytest.raises(InvalidInput, match="netCDF"):
        read(path)


def test_a_write_replaces_the_file_at_once_or_leaves_the_old_one(tmp_path):
    """A reader that holds the old file keeps it whole: it is replaced, not written over."""
    path = tmp_path / "posterior.nc"
    write(to_datatree(weighted_posterior(50), seed=3), path)
    before = path.read_bytes()
    with pytest.raises((TypeError, ValueError)):
        write(xr.DataTree(xr.Dataset({"x": ("n", [object()])})), path)
    assert path.read_bytes() == before
    with path.open("rb") as reader:
        write(to_datatree(weighted_posterior(60), seed=3), path)
        assert reader.read() == before != path.read_bytes()
    assert [p.name for p in tmp_path.iterdir()] == ["posterior.nc"]
