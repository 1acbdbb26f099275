"""Reweighting against a conjugate Gaussian posterior, and the choice of the draws."""

import math

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.posterior import reweight, subset, verdict_on
from strandline.posterior.importance import Reweighting

PRIOR_SD, NOISE_SD, DATUM = 2.0, 0.5, 1.3
GAIN = PRIOR_SD**2 / (PRIOR_SD**2 + NOISE_SD**2)
MEAN, SD = GAIN * DATUM, math.sqrt(GAIN) * NOISE_SD
"""Of x ~ N(0, 2²) after the datum 1.3 = x + N(0, 0.5²)."""


def checked(seed: int, *, shift: float, sd_factor: float = 1.0, number: int = 200) -> Reweighting:
    """Reweight draws of a surrogate's posterior whose mean is off by `shift` sd, and whose sd by a factor."""
    x = MEAN + shift * SD + sd_factor * SD * np.random.default_rng(seed).normal(size=number)
    surrogate = -0.5 * ((x - MEAN - shift * SD) / (sd_factor * SD)) ** 2 + 0.5 * (x / PRIOR_SD) ** 2
    return reweight(x[:, None], -0.5 * ((DATUM - x) / NOISE_SD) ** 2 - surrogate)


def weights(number: int = 1000) -> np.ndarray:
    raw = np.random.default_rng(8).exponential(size=number)
    raw[::7] = 0.0
    return raw / raw.sum()


@pytest.mark.parametrize(("shift", "sd_factor"), [(0.3, 1.0), (-0.3, 1.25)])
def test_a_shifted_surrogate_is_put_right(shift: float, sd_factor: float) -> None:
    """The mean of 50 repetitions has a seventh of the Monte Carlo error of one."""
    found = [checked(seed, shift=shift, sd_factor=sd_factor) for seed in range(50)]
    for values, exact in (
        ([f.reweighted_mean[0] for f in found], MEAN),
        ([f.reweighted_sd[0] for f in found], SD),
        ([f.shift[0] for f in found], -shift / sd_factor),
        ([f.sd_ratio[0] for f in found], 1 / sd_factor),
    ):
        bias = 0.01 * SD  # weights and sds are ratios: off by order 1/S
        assert abs(np.mean(values) - exact) < 3.5 * np.std(values) / math.sqrt(len(values)) + bias
        assert np.std(values) < 0.15
    assert np.mean([f.smoothed.k_hat for f in found]) < 0.5
    assert abs(np.mean([f.mean[0] for f in found]) - MEAN) > 0.25 * SD, "left as it is, it is wrong"


def test_the_error_of_the_shift_is_what_repetitions_show() -> None:
    found = [checked(seed, shift=0.3) for seed in range(150)]
    z = np.array([(f.shift[0] + 0.3) / f.shift_error[0] for f in found])
    assert abs(z.mean()) < 0.25
    assert 0.8 < z.std() < 1.25


def test_a_surrogate_that_is_wrong_by_five_sd_is_caught() -> None:
    found = [checked(seed, shift=5.0) for seed in range(10)]
    assert min(f.smoothed.k_hat for f in found) > 0.7
    assert {verdict_on(f.smoothed) for f in found} == {"bad"}
    assert max(f.smoothed.ess for f in found) < 20


def test_an_exact_surrogate_changes_nothing_and_excluded_draws_have_no_share() -> None:
    """The second target is a uniform on [0, 0.5] out of one on [0, 1]."""
    found = checked(1, shift=0.0)
    assert found.smoothed.k_hat < 0.1
    assert found.smoothed.ess == pytest.approx(200)
    np.testing.assert_allclose([*found.shift, *found.shift_error, *(found.sd_ratio - 1)], 0.0, atol=1e-9)
    x = (np.arange(1000) + 0.5) / 1000
    half = reweight(x[:, None], np.where(x < 0.5, 0.0, -np.inf))
    assert half.smoothed.ess == pytest.approx(500)
    np.testing.assert_allclose(half.reweighted_mean, 0.25)
    np.testing.assert_allclose(half.reweighted_sd, 0.5 / math.sqrt(12), rtol=1e-5)
    with pytest.raises(InvalidInput, match="draws that differ"):
        reweight(np.ones((30, 2)), np.zeros(30))


def test_draws_are_taken_by_weight_repeatably_and_twice_as_many_contain_them() -> None:
    w = weights()
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
    equal = subset(np.full(500, 1 / 500), 100, seed=3)
    assert set(np.diff(equal).tolist()) == {5}


def test_every_particle_is_drawn_as_often_as_it_weighs() -> None:
    w = weights(40)
    counts = sum(np.bincount(subset(w, 20, seed=seed), minlength=40) for seed in range(1000))
    expected = 1000 * 20 * w
    assert (np.abs(counts - expected) < 4 * np.sqrt(np.maximum(expected, 1.0))).all()
