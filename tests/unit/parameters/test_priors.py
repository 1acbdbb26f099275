"""Priors against scipy.stats, their own integrals, and JAX."""

import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import integrate, stats

from strandline.foundations import InvalidInput
from strandline.parameters import PRIORS, LogNormal, LogUniform, Normal, Prior, ScaledBeta, Truncated, Uniform
from strandline.parameters.priors import truncate


def cut(base, low, high):
    """Return scipy's distribution of `base` restricted to [low, high]."""
    kept = base.cdf(high) - base.cdf(low)
    return SimpleNamespace(
        logpdf=lambda x: np.where((x >= low) & (x <= high), base.logpdf(x) - math.log(kept), -np.inf),
        cdf=lambda x: (base.cdf(np.clip(x, low, high)) - base.cdf(low)) / kept,
    )


LOGNORMAL = stats.lognorm(s=0.4, scale=math.exp(5.86))
TWICE = Truncated(Truncated(Normal(0.0, 1.0), -1.0, 2.0), 0.0, 3.0)
CASES = {
    "uniform": (Uniform(-0.8, 0.5), stats.uniform(-0.8, 1.3)),
    "loguniform": (LogUniform(100.0, 800.0), stats.loguniform(100.0, 800.0)),
    "normal": (Normal(3.0, 0.7), stats.norm(3.0, 0.7)),
    "lognormal": (LogNormal(5.86, 0.4), LOGNORMAL),
    "beta": (ScaledBeta(43 / 13, 22 / 13, -0.8, 0.5), stats.beta(43 / 13, 22 / 13, -0.8, 1.3)),
    "beta, one exponent 1": (ScaledBeta(1.0, 2.0, 0.0, 110.0), stats.beta(1.0, 2.0, 0.0, 110.0)),
    "truncated lognormal": (Truncated(LogNormal(5.86, 0.4), 100.0, 800.0), cut(LOGNORMAL, 100.0, 800.0)),
    "truncated twice": (TWICE, cut(stats.norm(0.0, 1.0), 0.0, 2.0)),
}


def inner_points(prior: Prior) -> np.ndarray:
    return np.asarray(prior.quantile(np.linspace(0.001, 0.999, 101)))


def bounds(prior: Prior) -> list[tuple[float, float, float]]:
    """Return each finite end of the support, a point beyond it, and the mass below that point."""
    low, high = prior.support
    return [one for one in ((low, low - 1.0, 0.0), (high, high + 1.0, 1.0)) if math.isfinite(one[0])]


def mass(prior: Prior, low: float, high: float) -> float:
    return integrate.quad(lambda x: math.exp(float(prior.log_density(x))), low, high, epsabs=1e-11, limit=200)[0]


@pytest.mark.parametrize("name", CASES)
def test_a_prior_is_that_of_scipy_and_a_density(name):
    prior, exact = CASES[name]
    x, p = inner_points(prior), np.linspace(0.0005, 0.9995, 201)
    assert prior.log_density(x) == pytest.approx(exact.logpdf(x), abs=1e-10)
    assert prior.cdf(x) == pytest.approx(exact.cdf(x), abs=1e-12)
    assert prior.cdf(prior.quantile(p)) == pytest.approx(p, abs=1e-11)
    assert prior.quantile(prior.cdf(x)) == pytest.approx(x, rel=1e-9)
    low, high = prior.support
    low, high = max(low, float(prior.quantile(1e-13))), min(high, float(prior.quantile(1 - 1e-13)))
    assert mass(prior, low, high) == pytest.approx(1.0, abs=1e-9)
    for edge, outside, below in bounds(prior):
        assert float(prior.log_density(outside)) == -math.inf
        assert float(prior.cdf(outside)) == below
        assert float(prior.quantile(below)) == pytest.approx(edge)


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


def test_beta_at_its_edges():
    for a, b, high, x, density in ((2, 2, 1, 0, 0), (1, 2, 1, 0, 2), (3, 1, 2, 2, 1.5), (0.5, 2, 1, 0, math.inf)):
        found = float(ScaledBeta(float(a), float(b), 0.0, float(high)).log_density(float(x)))
        assert math.exp(found) == pytest.approx(density)


def test_a_truncation_tells_the_mass_it_cuts_and_is_normalised_far_in_the_tail():
    prior = Truncated(Normal(0.0, 1.0), -1.0, 2.0)
    assert prior.mass_cut == pytest.approx(stats.norm.cdf(-1) + stats.norm.sf(2), rel=1e-12)
    assert prior.mass + prior.mass_cut == pytest.approx(1.0)
    assert mass(Truncated(Normal(0.0, 1.0), -6.2, -6.0), -6.2, -6.0) == pytest.approx(1.0, abs=1e-9)
    whole = Uniform(0.0, 1.0)
    assert truncate(whole, -1.0, 1.0) is whole
    assert isinstance(truncate(whole, 0.5, 1.0), Truncated)
    assert truncate(whole, 0.5, 2.0).support == (0.5, 1.0)


probability = st.floats(0.001, 0.999)
locations, widths, exponents = st.floats(-100.0, 100.0), st.floats(0.01, 100.0), st.floats(0.5, 20.0)


@st.composite
def priors(draw) -> Prior:
    low, width = draw(locations), draw(widths)
    beta = ScaledBeta(draw(exponents), draw(exponents), low, low + width)
    others = Uniform(low, low + width), Normal(low, width), LogNormal(low / 20, min(width, 2.0))
    return draw(st.sampled_from([*others, beta]))


@settings(max_examples=40, deadline=None)
@given(prior=priors(), ends=st.tuples(probability, probability), p=probability)
def test_the_cdf_of_a_quantile_is_the_probability_and_truncation_keeps_the_ratio_of_densities(prior, ends, p):
    assert float(prior.cdf(prior.quantile(p))) == pytest.approx(p, abs=1e-7)
    low, high = sorted(float(prior.quantile(q)) for q in ends)
    assume(high - low > 1e-6 * max(abs(low), abs(high), 1.0))
    kept = truncate(prior, low, high)
    x = low + p * (high - low)
    share = float(prior.cdf(high) - prior.cdf(low))
    assert float(kept.log_density(x)) == pytest.approx(float(prior.log_density(x)) - math.log(share), abs=1e-9)
    assert low <= float(kept.quantile(p)) <= high
    assert float(kept.cdf(kept.quantile(p))) == pytest.approx(p, abs=1e-5)


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


def test_invalid_numbers_are_refused_by_name_and_the_registry_names_the_classes():
    for named, (kind, *wrong) in REFUSED.items():
        for numbers in wrong:
            with pytest.raises(InvalidInput, match=named):
                kind(*numbers)
    assert set(PRIORS.values()) <= {type(prior) for prior, _ in CASES.values()}
    assert all(isinstance(prior, Prior) for prior, _ in CASES.values())
