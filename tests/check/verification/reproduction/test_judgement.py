"""The figures that claims are judged by, on densities where they are known."""

import numpy as np
import pytest
from verification.reproduction.judgement import (
    LikelihoodField,
    angle_between_axes,
    distance_to_prior,
    mass_within,
    modes,
    plateau,
)

from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import GaussianApproximation, Posterior
from strandline.priors import Uniform

SPACE = ParameterSpace((Parameter("a", Uniform(0.0, 10.0), "1"), Parameter("b", Uniform(0.0, 10.0), "1")))
RNG = np.random.default_rng(3)


def posterior_of(a: np.ndarray, b: np.ndarray) -> Posterior:
    zero = np.zeros(len(a))
    return Posterior(SPACE, np.stack([a, b], axis=1), zero - np.log(len(a)), zero, zero, 0.0)


def test_plateaus_modes_and_distances_to_the_prior_are_those_of_the_density() -> None:
    normal, flat = RNG.normal(5.0, 0.8, 4000), RNG.uniform(0.0, 10.0, 4000)
    two = np.where(RNG.random(4000) < 0.6, RNG.normal(2.0, 0.4, 4000), RNG.normal(7.0, 0.4, 4000))
    posterior = posterior_of(normal, flat)
    assert plateau(posterior, "a") == pytest.approx(1.336, abs=0.3)  # of 4000 draws
    assert 2.4 < plateau(posterior, "b") <= np.sqrt(12) + 0.1
    posterior = posterior_of(two, normal)
    assert modes(posterior, "a") == pytest.approx([2.0, 7.0], abs=0.15)  # the highest first
    assert modes(posterior, "b") == pytest.approx([5.0], abs=0.15)
    posterior = posterior_of(RNG.uniform(0.0, 5.0, 20_000), RNG.uniform(0.0, 10.0, 20_000))
    assert distance_to_prior(posterior, "a") == pytest.approx(0.5, abs=0.01)
    assert distance_to_prior(posterior, "b") < 0.03


def test_the_angle_between_axes_is_that_of_the_scaled_inputs() -> None:
    one, other, turned = np.diag([4.0, 1.0]), np.diag([1.0, 4.0]), np.array([[2.5, 1.5], [1.5, 2.5]])
    ones = np.ones(2)
    assert angle_between_axes(one, one, ones) == pytest.approx(0.0, abs=1e-6)
    assert angle_between_axes(one, other, ones) == pytest.approx(90.0)
    assert angle_between_axes(one, turned, ones) == pytest.approx(45.0)
    assert angle_between_axes(one, other, np.array([10.0, 1.0])) == pytest.approx(0.0, abs=1e-6)


def test_the_mass_in_an_ellipse_is_that_of_the_gaussian_it_comes_from() -> None:
    posterior = posterior_of(*RNG.multivariate_normal([5.0, 5.0], [[0.5, 0.3], [0.3, 0.4]], 20_000).T)
    right = GaussianApproximation(posterior.mean, posterior.covariance)
    assert mass_within(posterior, right, 0.9) == pytest.approx(0.9, abs=0.01)
    narrow = GaussianApproximation(posterior.mean, 0.01 * posterior.covariance)
    assert mass_within(posterior, narrow, 0.9) < 0.05


def test_ridge_peak_and_width_of_a_field() -> None:
    x, y = np.linspace(0.0, 10.0, 201), np.linspace(0.0, 10.0, 101)
    along = 2.0 + 0.05 * y**2
    values = -0.5 * ((x[:, None] - along) / 0.5) ** 2 - 0.5 * ((y - 6.0) / 3.0) ** 2
    field = LikelihoodField(x, y, values)
    assert field.peak == pytest.approx((3.8, 6.0), abs=0.05)
    np.testing.assert_allclose(field.ridge, along, atol=0.05)
    narrow = LikelihoodField(x, y, 4.0 * values)
    assert narrow.share_above(0.5) == pytest.approx(0.25 * field.share_above(0.5), rel=0.15)
