"""Gaussian and Laplace approximations against SciPy, closed forms and finite differences."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from strandline.errors import InvalidInput, NumericsError
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import GaussianApproximation, laplace, log_prior_hessian
from strandline.priors import LogNormal, Normal, ScaledBeta, Uniform

COVARIANCE = np.array([[150.0**2, 30.0, 1.0], [30.0, 0.09, 0.01], [1.0, 0.01, 4.0]])
GAUSSIAN = GaussianApproximation(np.array([400.0, 0.1, 80.0]), COVARIANCE)
DRAWS = np.random.default_rng(1).multivariate_normal(GAUSSIAN.mean, COVARIANCE, 20_000)
PRIORS = ParameterSpace(
    (
        Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0)),
        Parameter("nu", ScaledBeta(43 / 13, 22 / 13, -0.8, 0.5)),
        Parameter("V", Normal(80.0, 9.0), "mm²/s", (20.0, 110.0)),
        Parameter("k", Uniform(0.0, 1.0)),
    )
)


def second_differences(function: Callable[[np.ndarray], float], x: np.ndarray, step: np.ndarray) -> np.ndarray:
    dim, unit = len(x), np.diag(step)
    hessian = np.empty((dim, dim))
    for i, j in np.ndindex(dim, dim):
        corners = [s * t * function(x + s * unit[i] + t * unit[j]) for s in (1, -1) for t in (1, -1)]
        hessian[i, j] = sum(corners) / (4 * step[i] * step[j])
    return hessian


def test_the_density_is_that_of_scipy_and_each_radius_encloses_its_share():
    expected = multivariate_normal(GAUSSIAN.mean, COVARIANCE).logpdf(DRAWS[:20])
    np.testing.assert_allclose(GAUSSIAN.log_density(DRAWS[:20]), expected)
    assert GAUSSIAN.log_density(DRAWS[0]).shape == ()
    assert GAUSSIAN.marginal([0, 1]).percentile_radius(0.5) == pytest.approx(np.sqrt(2 * np.log(2)))
    for p in (0.1, 0.5, 0.9):
        inside = (GAUSSIAN.radius(DRAWS) < GAUSSIAN.percentile_radius(p)).mean()
        assert inside == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / len(DRAWS)))


def test_an_ellipse_is_that_of_the_two_dimensional_marginal():
    curve = GAUSSIAN.ellipse(0.9, pair=(2, 0))
    plane = GaussianApproximation(GAUSSIAN.mean[[2, 0]], COVARIANCE[np.ix_([2, 0], [2, 0])])
    np.testing.assert_allclose(plane.radius(curve), np.sqrt(-2 * np.log(0.1)))
    np.testing.assert_allclose(curve[0], curve[-1])
    planted = plane.radius(DRAWS[:, [2, 0]]) < GAUSSIAN.percentile_radius(0.9)
    assert planted.mean() > 0.93, "the radius of three inputs used in the plane must be caught"


def test_laplace_of_a_gaussian_is_that_gaussian():
    found = laplace(-np.linalg.inv(COVARIANCE), GAUSSIAN.mean)
    assert found.definite
    assert (found.eigenvalues < 0).all()
    np.testing.assert_allclose(found.covariance, COVARIANCE, rtol=1e-9)
    np.testing.assert_allclose(found.gaussian.covariance, COVARIANCE, rtol=1e-9)


def test_laplace_tells_maxima_from_saddles_in_any_unit():
    saddle = laplace(np.array([[-1.0, 2.0], [2.0, -1.0]]), np.zeros(2))
    assert not saddle.definite
    assert saddle.covariance is None
    np.testing.assert_allclose(saddle.eigenvalues, [-3.0, 1.0])
    for hessian in (np.diag([-1.0, 1.0]), np.diag([-1.0, 0.0]), -np.ones((2, 2)), np.zeros((2, 2))):
        assert not laplace(hessian, np.zeros(2)).definite
    units = np.diag([1e9, 1e-9])
    for correlation, definite in ((0.9, True), (1.1, False)):
        hessian = -units @ np.array([[1.0, correlation], [correlation, 1.0]]) @ units
        assert laplace(hessian, np.zeros(2)).definite is definite


def test_the_hessian_of_the_prior_agrees_with_finite_differences_and_closed_forms():
    x = np.array([320.0, 0.15, 75.0, 0.5])
    exact = log_prior_hessian(PRIORS, x)
    differences = second_differences(PRIORS.log_prior, x, np.array([0.3, 3e-4, 0.05, 1e-3]))
    np.testing.assert_allclose(exact, differences, rtol=1e-4, atol=1e-8)
    assert exact[2, 2] == pytest.approx(-1 / 81)
    assert exact[0, 0] == pytest.approx((1 + (np.log(320.0) - 6.86) / 0.16) / 320**2)
    assert exact[3, 3] == 0
    np.testing.assert_array_equal(exact, np.diag(np.diag(exact)))


def test_what_is_refused():
    cases = [
        (lambda: GAUSSIAN.percentile_radius(10.0), InvalidInput, r"0\.1"),
        (lambda: GaussianApproximation(np.zeros(2), np.diag([1.0, 0.0])).log_density(np.zeros(2)), NumericsError,
         "without spread"),
        (lambda: laplace(np.array([[-1.0, 2.0], [2.0, -1.0]]), np.zeros(2)).gaussian, NumericsError,
         "not negative definite"),
        (lambda: laplace(np.array([[-1.0, 0.5], [0.0, -1.0]]), np.zeros(2)), InvalidInput, "finite differences"),
        (lambda: laplace(np.full((2, 2), np.nan), np.zeros(2)), InvalidInput, "finite differences"),
        (lambda: log_prior_hessian(PRIORS, np.array([50.0, 0.15, 75.0, 0.5])), InvalidInput, "inside the support"),
    ]  # fmt: skip
    for call, error, words in cases:
        with pytest.raises(error, match=words):
            call()
