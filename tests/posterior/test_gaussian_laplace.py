"""Gaussian and Laplace approximations against SciPy, closed forms and finite differences."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from strandline.errors import InvalidInput, NumericsError
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import GaussianApproximation, laplace, log_prior_hessian
from strandline.priors import LogNormal, Normal, ScaledBeta, Uniform

COVARIANCE = np.array([[150.0**2, 30.0, 1.0], [30.0, 0.09, 0.01], [1.0, 0.01, 4.0]])
GAUSSIAN = GaussianApproximation(np.array([400.0, 0.1, 80.0]), COVARIANCE)


def finite_difference_hessian(function: Callable[[np.ndarray], float], x: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Central second differences, an oracle for exact derivatives."""
    dim = len(x)
    unit = np.diag(step)
    hessian = np.empty((dim, dim))
    for i in range(dim):
        for j in range(dim):
            corners = [s * t * function(x + s * unit[i] + t * unit[j]) for s in (1, -1) for t in (1, -1)]
            hessian[i, j] = sum(corners) / (4 * step[i] * step[j])
    return hessian


def test_log_density_equals_scipy():
    points = np.random.default_rng(0).multivariate_normal(GAUSSIAN.mean, COVARIANCE, 20)
    expected = multivariate_normal(GAUSSIAN.mean, COVARIANCE).logpdf(points)
    np.testing.assert_allclose(GAUSSIAN.log_density(points), expected)
    assert GAUSSIAN.log_density(points[0]).shape == ()


@pytest.mark.parametrize("p", [0.1, 0.5, 0.9])
def test_percentile_radius_encloses_its_share(p):
    draws = np.random.default_rng(1).multivariate_normal(GAUSSIAN.mean, COVARIANCE, 20_000)
    inside = (GAUSSIAN.radius(draws) < GAUSSIAN.percentile_radius(p)).mean()
    assert inside == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / 20_000))


def test_radius_in_the_plane_is_the_closed_form():
    assert GAUSSIAN.marginal([0, 1]).percentile_radius(0.5) == pytest.approx(np.sqrt(2 * np.log(2)))


def test_ellipse_is_that_of_the_two_dimensional_marginal():
    curve = GAUSSIAN.ellipse(0.9, pair=(2, 0))
    plane = GaussianApproximation(GAUSSIAN.mean[[2, 0]], COVARIANCE[np.ix_([2, 0], [2, 0])])
    np.testing.assert_allclose(plane.radius(curve), np.sqrt(-2 * np.log(0.1)))
    np.testing.assert_allclose(curve[0], curve[-1])
    draws = np.random.default_rng(2).multivariate_normal(GAUSSIAN.mean, COVARIANCE, 20_000)[:, [2, 0]]
    planted = plane.radius(draws) < GAUSSIAN.percentile_radius(0.9)
    assert planted.mean() > 0.93, "the radius of three inputs used in the plane must be caught"


def test_percentiles_are_fractions():
    with pytest.raises(InvalidInput, match=r"0\.1"):
        GAUSSIAN.percentile_radius(10.0)


def test_degenerate_covariance_is_an_error_that_says_so():
    with pytest.raises(NumericsError, match="without spread"):
        GaussianApproximation(np.zeros(2), np.diag([1.0, 0.0])).log_density(np.zeros(2))


def test_laplace_of_a_gaussian_is_that_gaussian():
    found = laplace(-np.linalg.inv(COVARIANCE), GAUSSIAN.mean)
    assert found.definite
    np.testing.assert_allclose(found.covariance, COVARIANCE, rtol=1e-9)
    assert (found.eigenvalues < 0).all()
    np.testing.assert_allclose(found.gaussian.covariance, COVARIANCE, rtol=1e-9)


def test_laplace_reports_a_saddle():
    found = laplace(np.array([[-1.0, 2.0], [2.0, -1.0]]), np.zeros(2))
    assert not found.definite
    assert found.covariance is None
    np.testing.assert_allclose(found.eigenvalues, [-3.0, 1.0])
    with pytest.raises(NumericsError, match="not negative definite"):
        _ = found.gaussian


@pytest.mark.parametrize("hessian", [np.diag([-1.0, 1.0]), np.diag([-1.0, 0.0]), -np.ones((2, 2)), np.zeros((2, 2))])
def test_laplace_reports_flat_and_rising_directions(hessian):
    assert not laplace(hessian, np.zeros(2)).definite


def test_definiteness_does_not_depend_on_units():
    units = np.diag([1e9, 1e-9])
    assert laplace(-units @ np.array([[1.0, 0.9], [0.9, 1.0]]) @ units, np.zeros(2)).definite
    assert not laplace(-units @ np.array([[1.0, 1.1], [1.1, 1.0]]) @ units, np.zeros(2)).definite


@pytest.mark.parametrize("hessian", [np.array([[-1.0, 0.5], [0.0, -1.0]]), np.full((2, 2), np.nan)])
def test_laplace_refuses_what_is_no_hessian(hessian):
    with pytest.raises(InvalidInput, match="finite differences"):
        laplace(hessian, np.zeros(2))


def ridge(x):
    """A curved ridge like that of the study; NumPy or JAX."""
    xp = jnp if isinstance(x, jax.Array) else np
    return -0.5 * ((x[..., 0] / 100 - 4 - xp.sin(x[..., 1])) / 0.3) ** 2 - x[..., 1] ** 4


def test_finite_differences_agree_with_exact_derivatives_of_the_ridge():
    x = np.array([410.0, 0.3])
    exact = np.asarray(jax.hessian(ridge)(jnp.asarray(x)))
    np.testing.assert_allclose(finite_difference_hessian(ridge, x, np.array([0.5, 1e-3])), exact, rtol=1e-5)
    sloppy = finite_difference_hessian(ridge, x, np.array([200.0, 0.5]))
    assert not np.allclose(sloppy, exact, rtol=1e-2)


PRIORS = ParameterSpace(
    (
        Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0)),
        Parameter("nu", ScaledBeta(43 / 13, 22 / 13, -0.8, 0.5)),
        Parameter("V", Normal(80.0, 9.0), "mm²/s", (20.0, 110.0)),
        Parameter("k", Uniform(0.0, 1.0)),
    )
)


def test_log_prior_hessian_agrees_with_finite_differences_and_closed_forms():
    x = np.array([320.0, 0.15, 75.0, 0.5])
    exact = log_prior_hessian(PRIORS, x)
    differences = finite_difference_hessian(PRIORS.log_prior, x, np.array([0.3, 3e-4, 0.05, 1e-3]))
    np.testing.assert_allclose(exact, differences, rtol=1e-4, atol=1e-8)
    assert exact[2, 2] == pytest.approx(-1 / 81)
    assert exact[0, 0] == pytest.approx((1 + (np.log(320.0) - 6.86) / 0.16) / 320**2)
    assert exact[3, 3] == 0
    np.testing.assert_array_equal(exact, np.diag(np.diag(exact)))


def test_log_prior_hessian_outside_the_support_is_refused():
    with pytest.raises(InvalidInput, match="inside the support"):
        log_prior_hessian(PRIORS, np.array([50.0, 0.15, 75.0, 0.5]))
