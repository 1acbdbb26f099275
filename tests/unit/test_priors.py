"""Priors against scipy.stats, their own integrals, and JAX."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

from strandline.errors import InvalidInput
from strandline.priors import PRIORS, LogNormal, LogUniform, Normal, Prior, ScaledBeta, Truncated, Uniform, truncate


def cut(base, low, high):
    """Return scipy's distribution of `base` restricted to [low, high], as (logpdf, cdf)."""
    kept = base.cdf(high) - base.cdf(low)

    def logpdf(x):
        return np.where((x >= low) & (x <= high), base.logpdf(x) - math.log(kept), -np.inf)

    return logpdf, lambda x: (base.cdf(np.clip(x, low, high)) - base.cdf(low)) / kept


def whole(base):
    return base.logpdf, base.cdf


CASES = {
    "uniform": (Uniform(-0.8, 0.5), whole(stats.uniform(-0.8, 1.3))),
    "loguniform": (LogUniform(100.0, 800.0), whole(stats.loguniform(100.0, 800.0))),
    "normal": (Normal(3.0, 0.7), whole(stats.norm(3.0, 0.7))),
    "lognormal": (LogNormal(5.86, 0.4), whole(stats.lognorm(s=0.4, scale=math.exp(5.86)))),
    "beta": (ScaledBeta(43 / 13, 22 / 13, -0.8, 0.5), whole(stats.beta(43 / 13, 22 / 13, -0.8, 1.3))),
    "beta, one exponent 1": (ScaledBeta(1.0, 2.0, 0.0, 110.0), whole(stats.beta(1.0, 2.0, 0.0, 110.0))),
    "truncated normal": (Truncated(Normal(3.0, 0.7), 2.0, 3.5), cut(stats.norm(3.0, 0.7), 2.0, 3.5)),
    "truncated lognormal": (
        Truncated(LogNormal(5.86, 0.4), 100.0, 800.0),
        cut(stats.lognorm(s=0.4, scale=math.exp(5.86)), 100.0, 800.0),
    ),
    "truncated twice": (
        Truncated(Truncated(Normal(0.0, 1.0), -1.0, 2.0), 0.0, 3.0),
        cut(stats.norm(0.0, 1.0), 0.0, 2.0),
    ),
}


def inner_points(prior: Prior) -> np.ndarray:
    return np.asarray(prior.quantile(np.linspace(0.001, 0.999, 101)))


def bounds(prior: Prior) -> list[tuple[float, float, float]]:
    """Return each finite end of the support, a point beyond it, and the mass below that point."""
    low, high = prior.support
    return [one for one in ((low, low - 1.0, 0.0), (high, high + 1.0, 1.0)) if math.isfinite(one[0])]


@pytest.mark.parametrize("name", CASES)
def test_a_prior_is_that_of_scipy_and_a_density(name):
    prior, (logpdf, cdf) = CASES[name]
    x, p = inner_points(prior), np.linspace(0.0005, 0.9995, 201)
    assert prior.log_density(x) == pytest.approx(logpdf(x), abs=1e-10)
    assert prior.cdf(x) == pytest.approx(cdf(x), abs=1e-12)
    assert prior.cdf(prior.quantile(p)) == pytest.approx(p, abs=1e-11)
    assert prior.quantile(prior.cdf(x)) == pytest.approx(x, rel=1e-9)
    low, high = prior.support
    low, high = max(low, float(prior.quantile(1e-13))), min(high, float(prior.quantile(1 - 1e-13)))
    total, _ = integrate.quad(lambda x: math.exp(float(prior.log_density(x))), low, high, epsabs=1e-11, limit=200)
    assert total == pytest.approx(1.0, abs=1e-9)
    for edge, outside, mass in bounds(prior):
        assert float(prior.log_density(outside)) == -math.inf
        assert float(prior.cdf(outside)) == mass
        assert float(prior.quantile(mass)) == pytest.approx(edge)


@pytest.mark.parametrize("name", CASES)
def test_a_prior_on_jax_is_that_on_numpy_with_a_gradient(name):
    prior, _ = CASES[name]
    x = np.concatenate([inner_points(prior), [outside for _, outside, _ in bounds(prior)]])
    exact = np.asarray(prior.log_density(x))
    assert np.asarray(prior.log_density(jnp.asarray(x))) == pytest.approx(exact, rel=1e-12, abs=1e-12)
    assert np.asarray(jax.jit(prior.log_density)(x)) == pytest.approx(exact, rel=1e-12, abs=1e-12)
    x = inner_points(prior)[5:-5]
    slope = jax.vmap(jax.grad(prior.log_density))(jnp.asarray(x))
    h = 1e-5 * (x[-1] - x[0])
    rounding = 1e-14 / h
    differences = (np.asarray(prior.log_density(x + h)) - np.asarray(prior.log_density(x - h))) / (2 * h)
    assert np.asarray(slope) == pytest.approx(differences, rel=1e-5, abs=rounding + 1e-9)
    assert all(np.isfinite(jax.grad(prior.log_density)(outside)) for _, outside, _ in bounds(prior))


def test_modes_of_the_study():
    """The excerpt names the modes 300 Pa, 0.2 and 88 mm²/s."""
    for prior, mode in (
        (LogNormal(5.86, 0.4), 300.0),
        (ScaledBeta(43 / 13, 22 / 13, -0.8, 0.5), 0.2),
        (ScaledBeta(2.6, 1.4, 0.0, 110.0), 88.0),
    ):
        x = np.linspace(*prior.quantile(np.array([0.01, 0.999])), 20001)
        assert x[np.argmax(prior.log_density(x))] == pytest.approx(mode, rel=0.006)


def test_beta_at_its_edges():
    assert float(ScaledBeta(2.0, 2.0, 0.0, 1.0).log_density(0.0)) == -math.inf
    assert float(ScaledBeta(1.0, 2.0, 0.0, 1.0).log_density(0.0)) == pytest.approx(math.log(2.0))
    assert float(ScaledBeta(3.0, 1.0, 0.0, 2.0).log_density(2.0)) == pytest.approx(math.log(1.5))
    assert float(ScaledBeta(0.5, 2.0, 0.0, 1.0).log_density(0.0)) == math.inf


def test_mass_cut_of_a_truncation():
    prior = Truncated(Normal(0.0, 1.0), -1.0, 2.0)
    assert prior.mass_cut == pytest.approx(stats.norm.cdf(-1) + stats.norm.sf(2), rel=1e-12)
    assert prior.mass + prior.mass_cut == pytest.approx(1.0)


def test_a_truncation_far_in_the_tail_is_still_normalised():
    prior = Truncated(Normal(0.0, 1.0), -6.2, -6.0)
    total, _ = integrate.quad(lambda x: math.exp(float(prior.log_density(x))), -6.2, -6.0, epsabs=1e-12)
    assert total == pytest.approx(1.0, abs=1e-9)


def test_truncate_leaves_alone_what_needs_no_cut():
    prior = Uniform(0.0, 1.0)
    assert truncate(prior, -1.0, 1.0) is prior
    assert isinstance(truncate(prior, 0.5, 1.0), Truncated)
    assert truncate(prior, 0.5, 2.0).support == (0.5, 1.0)


REFUSED = {
    "bounds of the uniform": (Uniform, (1.0, 0.0), (0.0, math.inf)),
    "sd of the normal": (Normal, (0.0, 0.0)),
    "mean of the normal": (Normal, (math.nan, 1.0)),
    "low of the loguniform": (LogUniform, (0.0, 1.0)),
    "bounds of the loguniform": (LogUniform, (2.0, 1.0)),
    "sigma of the lognormal": (LogNormal, (0.0, -1.0)),
    "mu of the lognormal": (LogNormal, (math.inf, 1.0)),
    "a of the beta": (ScaledBeta, (0.0, 1.0, 0.0, 1.0)),
    "b of the beta": (ScaledBeta, (1.0, math.nan, 0.0, 1.0)),
    "bounds of the beta": (ScaledBeta, (1.0, 1.0, 1.0, 1.0)),
    "bounds of the truncated": (Truncated, (Normal(0.0, 1.0), 1.0, 0.0)),
    "keeps no mass": (Truncated, (Normal(0.0, 1.0), 8.0, 9.0), (Normal(0.0, 1.0), -40.0, -39.0)),
}


def test_invalid_numbers_are_refused_by_name():
    for named, (kind, *given) in REFUSED.items():
        for numbers in given:
            with pytest.raises(InvalidInput, match=named):
                kind(*numbers)


def test_registry_names_classes_that_satisfy_the_protocol():
    numbers = {"uniform": (0.0, 1.0), "loguniform": (1.0, 2.0), "normal": (0.0, 1.0), "lognormal": (0.0, 1.0)}
    numbers |= {"beta": (2.0, 2.0, 0.0, 1.0)}
    assert set(PRIORS) == set(numbers)
    for name, values in numbers.items():
        assert isinstance(PRIORS[name](*values), Prior)
