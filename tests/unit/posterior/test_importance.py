"""Importance weights against a conjugate posterior, their smoothing against ArviZ and known shapes; bands of ranks."""

import math
import warnings
from itertools import product

import numpy as np
import pytest
from scipy.stats import binomtest, norm

from strandline.foundations import InvalidInput
from strandline.posterior import importance as module
from strandline.posterior import reweight, subset, verdict_on
from strandline.posterior.importance import GeneralisedPareto, fit_generalised_pareto, pareto_smoothed
from strandline.posterior.rank_tests import coverage_of, uniformity, weighted_ranks

PRIOR_SD, NOISE_SD, DATUM = 2.0, 0.5, 1.3
GAIN = PRIOR_SD**2 / (PRIOR_SD**2 + NOISE_SD**2)
MEAN, SD = GAIN * DATUM, math.sqrt(GAIN) * NOISE_SD
"""Of x ~ N(0, 2²) after the datum 1.3 = x + N(0, 0.5²)."""


def checked(seed, *, shift, sd_factor=1.0):
    """Reweight 200 draws of a surrogate's posterior whose mean is off by `shift` sd, and whose sd by a factor."""
    x = MEAN + shift * SD + sd_factor * SD * np.random.default_rng(seed).normal(size=200)
    surrogate = -0.5 * ((x - MEAN - shift * SD) / (sd_factor * SD)) ** 2 + 0.5 * (x / PRIOR_SD) ** 2
    return reweight(x[:, None], -0.5 * ((DATUM - x) / NOISE_SD) ** 2 - surrogate)


def test_a_shifted_surrogate_is_put_right_and_the_error_of_the_shift_is_what_repetitions_show():
    """The mean of 50 repetitions has a seventh of the Monte Carlo error of one."""
    for shift, sd_factor in ((0.3, 1.0), (-0.3, 1.25)):
        found = [checked(seed, shift=shift, sd_factor=sd_factor) for seed in range(50)]
        for values, exact in (
            ([f.reweighted_mean[0] for f in found], MEAN),
            ([f.reweighted_sd[0] for f in found], SD),
            ([f.shift[0] for f in found], -shift / sd_factor),
            ([f.sd_ratio[0] for f in found], 1 / sd_factor),
        ):
            bias = 0.01 * SD  # weights and sds are ratios: off by order 1/S
            assert abs(np.mean(values) - exact) < 3.5 * np.std(values) / math.sqrt(len(values)) + bias
        assert np.mean([f.smoothed.k_hat for f in found]) < 0.5
        assert abs(np.mean([f.mean[0] for f in found]) - MEAN) > 0.25 * SD, "left as it is, it is wrong"
    found = [checked(seed, shift=0.3) for seed in range(150)]
    z = np.array([(f.shift[0] + 0.3) / f.shift_error[0] for f in found])
    assert abs(z.mean()) < 0.25
    assert 0.8 < z.std() < 1.25


def test_an_exact_surrogate_changes_nothing_excluded_draws_have_no_share_and_five_sd_are_caught():
    """The second target is a uniform on [0, 0.5] out of one on [0, 1]."""
    found = [checked(seed, shift=5.0) for seed in range(10)]
    assert min(f.smoothed.k_hat for f in found) > 0.7
    assert {verdict_on(f.smoothed) for f in found} == {"bad"}
    found = checked(1, shift=0.0)
    assert found.smoothed.ess == pytest.approx(200)
    np.testing.assert_allclose([*found.shift, *found.shift_error, *(found.sd_ratio - 1)], 0.0, atol=1e-9)
    x = (np.arange(1000) + 0.5) / 1000
    half = reweight(x[:, None], np.where(x < 0.5, 0.0, -np.inf))
    assert half.smoothed.ess == pytest.approx(500)
    np.testing.assert_allclose(half.reweighted_mean, 0.25)
    np.testing.assert_allclose(half.reweighted_sd, 0.5 / math.sqrt(12), rtol=1e-5)


def test_draws_are_taken_by_weight_repeatably_and_twice_as_many_contain_them():
    w = np.random.default_rng(8).exponential(size=1000)
    w[::7] = 0.0
    w /= w.sum()
    for number in (20, 1000):
        chosen = subset(w, number, seed=1)
        counts = np.bincount(chosen, minlength=len(w))
        assert counts.sum() == number
        assert (np.abs(counts - number * w) < 1).all(), "strides: none is more than one from its share"
        assert (np.diff(chosen) >= 0).all()
        assert (counts[w == 0] == 0).all()
    first, again, more = subset(w, 50, seed=1), subset(w, 50, seed=1), subset(w, 100, seed=1)
    np.testing.assert_array_equal(first, again)
    assert set(first.tolist()) <= set(more.tolist())
    assert not np.array_equal(first, subset(w, 50, seed=2))


def test_weights_and_shape_are_those_of_arviz():
    with warnings.catch_warnings(action="ignore"):
        import arviz
    if not hasattr(arviz, "psislw"):
        pytest.skip("ArviZ 1.x has no psislw and other tails")
    bounded, student = (lambda r, n: np.log(r.uniform(size=n))), (lambda r, n: 0.4 * r.standard_t(3, size=n))
    wide, pareto = (lambda r, n: 4.0 * r.normal(size=n) + 300.0), (lambda r, n: r.exponential(size=n))
    for number, ratios in product((25, 200, 1000), (bounded, student, wide, pareto)):
        log_ratios = ratios(np.random.default_rng(3), number)
        found = pareto_smoothed(log_ratios)
        wanted, k_hat = arviz.psislw(log_ratios)
        np.testing.assert_allclose(found.log_weights, wanted, rtol=0, atol=1e-10)
        assert found.k_hat == pytest.approx(float(k_hat), abs=1e-10)
        assert found.ess == pytest.approx(1 / np.sum(np.exp(wanted) ** 2))


def test_a_constant_changes_nothing_the_largest_raw_weight_is_kept_to_and_equal_weights_have_no_tail():
    log_ratios = 2.0 * np.random.default_rng(6).normal(size=400)
    one, other = pareto_smoothed(log_ratios), pareto_smoothed(log_ratios - 1234.0)
    np.testing.assert_allclose(one.log_weights, other.log_weights, atol=1e-9)
    assert one.weights.sum() == pytest.approx(1.0)
    gain = (one.log_weights - log_ratios)[np.argsort(log_ratios)[:300]]
    np.testing.assert_allclose(gain, gain[0], err_msg="the body keeps its ratios")
    assert one.log_weights.max() <= log_ratios.max() + gain[0] + 1e-12
    rng = np.random.default_rng(7)
    for log_ratios in (np.full(50, 3.0), 100.0 + 1e-13 * rng.normal(size=50)):
        found = pareto_smoothed(log_ratios)
        assert (found.k_hat, verdict_on(found)) == (-math.inf, "good")
        np.testing.assert_allclose(found.weights, 1 / 50)
    log_ratios = np.full(50, -np.inf)
    log_ratios[:4] = [0.0, -0.1, -0.3, -1.0]
    found = pareto_smoothed(log_ratios)
    assert (found.k_hat, verdict_on(found)) == (math.inf, "bad")
    np.testing.assert_allclose(found.weights[:4], np.exp(log_ratios[:4]) / np.exp(log_ratios[:4]).sum())


def test_the_verdict_depends_on_the_number_of_draws_and_their_spread_and_ratios_that_are_none_are_refused():
    """k̂ has no scale: a hundredth of a Cauchy tail changes no estimate, the tail itself rules it."""
    assert [module.reliability_threshold(10**k) for k in (2, 3, 5)] == pytest.approx([0.5, 2 / 3, 0.7])
    log_ratios = np.random.default_rng(1).normal(size=10_000)
    weights = log_ratios - np.log(np.exp(log_ratios).sum())
    found = [verdict_on(module.SmoothedWeights(weights, k)) for k in (0.49, 0.5, 0.69, 0.7, 3.0)]
    assert found == ["good", "usable", "usable", "bad", "bad"]
    tail = np.abs(np.random.default_rng(8).standard_cauchy(500))
    slight, heavy = pareto_smoothed(np.log1p(1e-4 * tail)), pareto_smoothed(np.log(tail))
    assert min(slight.k_hat, heavy.k_hat) > 0.7
    assert [verdict_on(found) for found in (slight, heavy)] == ["good", "bad"]
    for wrong in ([0.0] * 4, [0.0] * 9 + [math.nan], [0.0] * 9 + [math.inf], [-math.inf] * 9):
        with pytest.raises(InvalidInput, match="log ratios of importance sampling"):
            pareto_smoothed(np.array(wrong))


def test_the_usual_k_hat_is_exceeded_by_one_set_of_normal_log_ratios_in_a_hundred():
    """Few draws show a heavy tail less often than many do. Sets of the same rounded spread share their limit."""
    random = np.random.default_rng(5)
    limit = module.largest_usual_k_hat(0.2 * random.standard_normal(43))
    above = [pareto_smoothed(0.2 * random.standard_normal(43)).k_hat > limit for _ in range(300)]
    assert 0.0 <= np.mean(above) <= 0.03
    ratios = 0.5 * norm.ppf((np.arange(400) + 0.5) / 400)
    assert module.largest_usual_k_hat(ratios) == module._usual_k_hat(400, 0.5)


def ranks(*, shift=0.0, width=1.0, number=200, seed=1):
    """Return ranks of the truth in Gaussian posteriors that are off by `shift` and too wide by `width`."""
    z = np.random.default_rng(seed).normal(size=number)
    return np.asarray(norm.cdf((z - shift) / width))


def test_uniform_ranks_are_inside_as_often_as_stated_and_wrong_posteriors_outside():
    """Planted: a bias, too wide, too narrow, σ² taken for 2σ²."""
    bands = [uniformity(ranks(seed=seed, number=50)) for seed in range(400)]
    assert 0.92 < np.mean([band.inside for band in bands]) < 0.98
    for level in (0.1, 0.5, 0.9):
        assert abs(np.mean([band.p_value <= level for band in bands]) - level) < 0.08
    for planted in ({"shift": 0.4}, {"width": 2.0}, {"width": 0.6}, {"width": np.sqrt(2.0)}):
        assert np.mean([not uniformity(ranks(seed=seed, **planted)).inside for seed in range(20)]) > 0.8


def test_coverage_of_intervals_with_the_bounds_of_wilson_and_ranks_by_weight():
    both = np.stack([ranks(number=4000), ranks(number=4000, width=0.5, seed=2)], axis=1)
    found = coverage_of(both, 0.9)
    assert found.found[0] == pytest.approx(0.9, abs=0.02)
    assert found.low[0] < 0.9 < found.high[0]
    assert found.found[1] == pytest.approx(norm.cdf(0.5 * 1.645) * 2 - 1, abs=0.03)
    few = coverage_of(np.array([0.5] * 17 + [0.99] * 3)[:, None], 0.9)
    wilson = binomtest(17, 20).proportion_ci(0.95, "wilson")
    assert (few.low[0], few.high[0]) == pytest.approx((wilson.low, wilson.high), rel=1e-6)
    x = np.array([[0.0, 5.0], [1.0, 5.0], [2.0, 7.0]])
    found = weighted_ranks(x, np.array([1.0, 1.0, 2.0]), np.array([1.0, 6.0]))
    np.testing.assert_allclose(found, [0.375, 0.5])


def test_the_fit_finds_shape_and_scale_of_its_own_samples_and_the_quantile_inverts_the_distribution():
    """Standard errors of maximum likelihood: (1 + k)/√n for k, σ √(2(1 + k)/n) for σ (Smith 1987)."""
    for shape in (-0.3, 0.0, 0.8):
        truth, number, rng = GeneralisedPareto(shape, 2.0), 1000, np.random.default_rng(5)
        fits = [fit_generalised_pareto(np.sort(truth.quantile(rng.uniform(size=number)))) for _ in range(200)]
        z_shape = np.array([(fit.shape - shape) * math.sqrt(number) / (1 + shape) for fit in fits])
        z_scale = np.array([(fit.scale / 2 - 1) * math.sqrt(number / (2 * (1 + shape))) for fit in fits])
        for z in (z_shape, z_scale):
            assert abs(z.mean()) < 0.25, "three and a half standard errors"
            assert 0.8 < z.std() < 1.2
    p = np.array([0.01, 0.5, 0.99])
    for shape, scaled in ((-0.5, 2 - 2 * (1 - p) ** 0.5), (0.0, -np.log1p(-p)), (1e-9, -np.log1p(-p))):
        np.testing.assert_allclose(GeneralisedPareto(shape, 3.0).quantile(p), 3.0 * scaled, rtol=1e-7)
