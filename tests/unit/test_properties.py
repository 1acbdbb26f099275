"""Round trips of priors, parameters and interfaces."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from strandline.interface import Interface, oriented_like
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import LogNormal, Normal, Prior, ScaledBeta, Uniform, truncate

probability = st.floats(0.001, 0.999)
locations, widths = st.floats(-100.0, 100.0), st.floats(0.01, 100.0)
exponents = st.floats(0.5, 20.0)
quick = settings(max_examples=40, deadline=None)


@st.composite
def priors(draw) -> Prior:
    low, width = draw(locations), draw(widths)
    return draw(
        st.sampled_from(
            [
                Uniform(low, low + width),
                Normal(low, width),
                LogNormal(low / 20, min(width, 2.0)),
                ScaledBeta(draw(exponents), draw(exponents), low, low + width),
            ]
        )
    )


@quick
@given(prior=priors(), p=probability)
def test_cdf_of_a_quantile_is_the_probability(prior, p):
    assert float(prior.cdf(prior.quantile(p))) == pytest.approx(p, abs=1e-7)


@quick
@given(prior=priors(), ends=st.tuples(probability, probability), p=probability)
def test_truncation_keeps_the_ratio_of_densities_and_inverts(prior, ends, p):
    low, high = sorted(float(prior.quantile(q)) for q in ends)
    assume(high - low > 1e-6 * max(abs(low), abs(high), 1.0))
    kept = truncate(prior, low, high)
    x = low + p * (high - low)
    mass = float(prior.cdf(high) - prior.cdf(low))
    assert float(kept.log_density(x)) == pytest.approx(float(prior.log_density(x)) - math.log(mass), abs=1e-9)
    assert low <= float(kept.quantile(p)) <= high
    assert float(kept.cdf(kept.quantile(p))) == pytest.approx(p, abs=1e-5)


@quick
@given(box=st.tuples(locations, widths), u=st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2))
def test_unit_cube_round_trip(box, u):
    low, width = box
    space = ParameterSpace((Parameter("a", Uniform(low, low + width)), Parameter("b", Uniform(0.0, 1.0))))
    x = space.to_physical(np.array(u))
    assert space.to_unit(x) == pytest.approx(np.array(u), abs=1e-9)
    assert math.isfinite(float(space.log_prior(np.clip(x, space.low, space.high))))


@quick
@given(
    y=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=12),
    number=st.integers(2, 40),
    turned=st.booleans(),
)
def test_a_curve_over_the_axis_is_simple_and_can_be_oriented(y, number, turned):
    curve = Interface.polyline(np.stack([np.arange(len(y), dtype=float), np.array(y)], axis=1))
    curve.require_simple()
    other = curve.resampled(number)
    assert other.lengths.sum() <= curve.lengths.sum() * (1 + 1e-12)
    assert oriented_like(other.reversed() if turned else other, curve).flipped == turned
