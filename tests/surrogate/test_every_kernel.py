"""Every kernel of the registry against scikit-learn, finite differences and what a correlation must be.

scikit-learn has no products by input; a Matérn kernel that is flat in all inputs but one is a kernel of that input
alone, and the product of such kernels is ours.
"""

import math
from functools import reduce
from operator import mul

import jax
import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

from strandline.design import sobol
from strandline.errors import NumericsError
from strandline.surrogate import KERNELS, batched_mean, condition, evidence, fit_hyperparameters, fit_log_likelihood
from strandline.surrogate.gaussian_process import standardisation
from strandline.surrogate.kernels import as_length_scale

LENGTHS, VARIANCE, NUGGET = np.array([0.8, 2.5, 1.3, 4.0, 0.9, 6.0, 1.7]), 2.3, 1e-3
FLAT = 1e9
EVERY = pytest.mark.parametrize("name", KERNELS)
DIMENSIONS = pytest.mark.parametrize("dim", [1, 2, 7])


def lengths_of(name, dim):
    return LENGTHS[: dim if KERNELS[name].per_input else 1]


def hyperparameters(name, dim):
    length_scale = as_length_scale(KERNELS[name], lengths_of(name, dim))
    return {"kernel": KERNELS[name], "length_scale": length_scale, "signal_variance": VARIANCE, "nugget": NUGGET}


def matern(nu):
    return lambda length: Matern(length, nu=nu)


def peers_correlation(name, lengths):
    """Return scikit-learn's kernel; `lengths` are one, or one for each input."""
    family, _, form = name.rpartition("_") if name.endswith(("_ard", "_product")) else (name, "", "")
    one = {"matern32": matern(1.5), "matern52": matern(2.5), "squared_exponential": RBF}[family]
    if form == "product":
        rows = zip(np.eye(len(lengths)), lengths, strict=True)
        return reduce(mul, [one(np.where(row > 0, length, FLAT)) for row, length in rows])
    return one(lengths if form == "ard" else float(lengths[0]))


def runs(number=90, dim=3, seed=0):
    rng = np.random.default_rng(seed)
    x = np.linspace(-5, 5, dim) + rng.random((number, dim)) * np.logspace(2, -2, dim)
    u = (x - x.mean(axis=0)) / x.std(axis=0)
    return x, np.sin(2 * u[:, 0]) + np.cos(u.sum(axis=1)) - 3 * u[:, -1] ** 2


def conditioned(name, dim):
    x, y = runs(dim=dim)
    return x, y, condition(x, y, **hyperparameters(name, dim))


def standardised(number, dim):
    u = sobol(number, dim)
    shift, scale = standardisation(u)
    y = np.cos(5 * u[:, 0]) + 4 * (u**2).sum(axis=1)
    return (u - shift) / scale, y - y.mean()


@EVERY
@DIMENSIONS
def test_the_correlation_equals_another_implementation(name, dim):
    x, lengths = np.random.default_rng(3).normal(size=(60, dim)), lengths_of(name, dim)
    x[:30] = x[30:] + np.logspace(-12, 1, 30)[:, None]
    found = KERNELS[name].value((x[:, None] - x) / lengths)
    np.testing.assert_allclose(found, peers_correlation(name, lengths)(x), rtol=1e-7, atol=1e-13)


@EVERY
@DIMENSIONS
def test_the_correlation_is_symmetric_at_most_one_and_positive_definite(name, dim):
    x = np.random.default_rng(4).normal(size=(80, dim))
    c = KERNELS[name].value((x[:, None] - x) / lengths_of(name, dim))
    np.testing.assert_array_equal(c, c.T)
    np.testing.assert_array_equal(np.diagonal(c), 1.0)
    assert np.abs(c).max() == 1.0
    assert np.linalg.eigvalsh(c).min() > -1e-13 * len(x)


@EVERY
@DIMENSIONS
def test_mean_and_variance_equal_another_implementation(name, dim):
    x, y, gp = conditioned(name, dim)
    kernel = ConstantKernel(VARIANCE) * peers_correlation(name, lengths_of(name, dim))
    other = GaussianProcessRegressor(kernel, alpha=NUGGET, optimizer=None)
    other.fit((x - x.mean(axis=0)) / x.std(axis=0), y - y.mean())
    points = np.concatenate([runs(200, dim, seed=1)[0], x[:5]])
    mean, sd = other.predict((points - x.mean(axis=0)) / x.std(axis=0), return_std=True)
    np.testing.assert_allclose(gp.mean(points), mean + y.mean(), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(gp.variance(points)), sd, rtol=1e-6, atol=1e-9)


@EVERY
@pytest.mark.parametrize(("number", "dim"), [(5, 2), (65, 1), (150, 2), (120, 7)])
def test_evidence_and_gradient_equal_another_implementation(name, number, dim):
    x, y = standardised(number, dim)
    ours = evidence(x, y, **hyperparameters(name, dim))
    kernel = ConstantKernel(VARIANCE) * peers_correlation(name, lengths_of(name, dim))
    other = GaussianProcessRegressor(kernel, alpha=NUGGET, optimizer=None).fit(x, y)
    value, slopes = other.log_marginal_likelihood(kernel.theta, eval_gradient=True)
    by_lengths = np.diagonal(slopes[1:].reshape(dim, dim)) if name.endswith("_product") else slopes[1:]
    assert ours.value == pytest.approx(value, rel=1e-9)
    expected = [slopes[0], *(by_lengths + 3 / len(by_lengths) * slopes[0])]
    np.testing.assert_allclose(ours.gradient, expected, rtol=1e-6, atol=1e-6)


@EVERY
@pytest.mark.parametrize("dim", [1, 3])
def test_the_gradient_of_the_evidence_is_the_finite_difference(name, dim):
    x, y = standardised(70, dim)
    count = len(lengths_of(name, dim))

    def found(z):
        lengths = np.exp(z[1:])
        at = {"length_scale": as_length_scale(KERNELS[name], lengths), "nugget": 1e-2}
        variance = math.exp(z[0] + 3 * z[1:].mean())
        return evidence(x, y, kernel=KERNELS[name], signal_variance=variance, **at)

    at, step = np.array([0.4, -0.5, 0.3, 1.2])[: 1 + count], 1e-5
    slopes = [(found(at + step * e).value - found(at - step * e).value) / (2 * step) for e in np.eye(1 + count)]
    np.testing.assert_allclose(found(at).gradient, slopes, rtol=1e-6, atol=2e-5)


@EVERY
@DIMENSIONS
def test_gradient_and_hessian_are_the_finite_differences_of_the_mean(name, dim):
    x, _, gp = conditioned(name, dim)
    points, step = np.concatenate([runs(20, dim, seed=2)[0], x[:3]]), 1e-6 * gp.scale
    for d in range(dim):
        shift = step * np.eye(dim)[d]
        slope = (gp.mean(points + shift) - gp.mean(points - shift)) / (2 * step[d])
        np.testing.assert_allclose(gp.gradient(points)[:, d] * gp.scale[d], slope * gp.scale[d], atol=1e-5)
        bend = (gp.gradient(points + shift) - gp.gradient(points - shift)) / (2 * step[d])
        unit = gp.scale * gp.scale[d]
        np.testing.assert_allclose((gp.hessian(points)[:, d] * unit)[:20], (bend * unit)[:20], atol=1e-4)


@EVERY
def test_the_hessian_at_a_training_point_is_the_limit_of_those_around_it(name):
    x, _, gp = conditioned(name, 3)
    unit, errors = np.outer(gp.scale, gp.scale), []
    for distance in (1e-2, 1e-3, 1e-4):
        around = x[4] + distance * gp.scale * np.concatenate([np.eye(3), -np.eye(3)])
        errors.append(np.abs((gp.hessian(around) - gp.hessian(x[4:5])) * unit).max())
    assert errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.2 * errors[1]


@EVERY
@pytest.mark.parametrize("fused", [False, True])
def test_the_jitted_mean_equals_the_plain_one(name, fused):
    x, _, gp = conditioned(name, 7)
    points = np.concatenate([runs(300, 7, seed=3)[0], x])
    np.testing.assert_allclose(jax.jit(batched_mean(gp, fused=fused))(points), gp.mean(points), rtol=1e-10, atol=1e-9)


@EVERY
def test_with_equal_lengths_the_radial_forms_are_the_isotropic_ones(name):
    isotropic = KERNELS[name.removesuffix("_ard").removesuffix("_product")]
    offset = np.random.default_rng(5).normal(size=(50, 3))
    same = np.allclose(KERNELS[name].value(offset), isotropic.value(offset), rtol=1e-13)
    assert same == (not name.endswith("_product"))


@EVERY
@pytest.mark.parametrize("dim", [2, pytest.param(5, marks=pytest.mark.long)])
def test_a_log_likelihood_is_fitted_by_all(name, dim):
    def log_likelihood(u):
        return -40 * (u[:, 0] - 0.3 - 0.3 * u[:, 1] ** 2) ** 2 - 0.5 * u[:, 2:].sum(axis=1)

    u, new = sobol(150, dim), sobol(300, dim, scramble=1)
    found = fit_log_likelihood(u, log_likelihood(u), kernel=name)
    error = found.process.mean(new) - log_likelihood(new)
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.std(log_likelihood(new))
    assert found.fit.verdict == "converged" or found.fit.verdict.startswith("accepted")
    assert np.max(found.fit.length_scale) <= 10.0


@pytest.mark.parametrize("name", ["squared_exponential", "squared_exponential_ard"])
def test_long_lengths_of_the_squared_exponential_are_refused_and_the_fit_keeps_off_them(name):
    x, _ = standardised(150, 2)
    y = -30 * (x**2).sum(axis=1)
    data, kernel, nugget = (x, y - y.mean()), KERNELS[name], 1e-5 * float(np.ptp(y))
    with pytest.raises(NumericsError, match="bound the length scale lower"):
        evidence(*data, kernel=kernel, length_scale=10.0, signal_variance=1e16, nugget=nugget)
    assert np.isfinite(
        evidence(*data, kernel=KERNELS["matern32"], length_scale=10.0, signal_variance=1e16, nugget=nugget).value
    )
    fit = fit_hyperparameters(*data, kernel=kernel, nugget=nugget)
    assert np.isfinite(fit.log_evidence)
