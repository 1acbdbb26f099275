"""Gaussian processes with a product kernel, against scikit-learn: a Matérn kernel that is flat in all inputs but one
is a kernel of that input alone, and their product ours."""

import math
import warnings
from functools import reduce
from operator import mul

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from strandline.design import sobol
from strandline.surrogate import (
    KERNELS,
    batched_mean,
    condition,
    evidence,
    fit_hyperparameters,
    fit_log_likelihood,
    validate,
)
from strandline.surrogate.gaussian_process import standardisation

PRODUCT, ISOTROPIC = KERNELS["matern32_product"], KERNELS["matern32"]
LENGTHS, VARIANCE, NUGGET = np.array([0.8, 2.5, 1.3, 4.0, 0.9, 6.0, 1.7]), 2.3, 1e-3
FLAT = 1e9


def peers_kernel(lengths, variance=VARIANCE):
    factors = [
        Matern(np.where(row > 0, length, FLAT), nu=1.5)
        for row, length in zip(np.eye(len(lengths)), lengths, strict=True)
    ]
    return reduce(mul, factors, ConstantKernel(variance))


def runs(number=90, dim=3, seed=0):
    rng = np.random.default_rng(seed)
    x = np.linspace(-5, 5, dim) + rng.random((number, dim)) * np.logspace(2, -2, dim)
    u = (x - x.mean(axis=0)) / x.std(axis=0)
    return x, np.sin(2 * u[:, 0]) + np.cos(u.sum(axis=1)) - 3 * u[:, -1] ** 2


def conditioned(dim=3):
    x, y = runs(dim=dim)
    options = {"length_scale": LENGTHS[:dim], "signal_variance": VARIANCE, "nugget": NUGGET}
    return x, y, condition(x, y, kernel=PRODUCT, **options)


def standardised(number, dim):
    u = sobol(number, dim)
    shift, scale = standardisation(u)
    y = np.cos(5 * u[:, 0]) + 4 * (u**2).sum(axis=1)
    return (u - shift) / scale, y - y.mean()


def drawn(number, lengths, nugget, seed):
    """Return standardised inputs and a draw of the process, from the formula written out input by input."""
    x, _ = standardised(number, len(lengths))
    K = np.full((number, number), 2.0)
    for column, length in zip(x.T, lengths, strict=True):
        t = math.sqrt(3) * np.abs(np.subtract.outer(column, column)) / length
        K = K * (1 + t) * np.exp(-t)
    return x, np.linalg.cholesky(K + nugget * np.eye(number)) @ np.random.default_rng(seed).standard_normal(number)


@pytest.mark.parametrize("dim", [1, 2, 3, 7])
def test_mean_and_variance_equal_another_implementation(dim):
    x, y, gp = conditioned(dim)
    other = GaussianProcessRegressor(peers_kernel(LENGTHS[:dim]), alpha=NUGGET, optimizer=None)
    other.fit((x - x.mean(axis=0)) / x.std(axis=0), y - y.mean())
    points = np.concatenate([runs(200, dim, seed=1)[0], x[:5]])
    mean, sd = other.predict((points - x.mean(axis=0)) / x.std(axis=0), return_std=True)
    np.testing.assert_allclose(gp.mean(points), mean + y.mean(), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(gp.variance(points)), sd, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("number", "dim"), [(5, 2), (64, 3), (65, 3), (300, 2), (150, 7)])
def test_evidence_and_gradient_equal_another_implementation(number, dim):
    x, y = standardised(number, dim)
    options = {"length_scale": LENGTHS[:dim], "signal_variance": VARIANCE, "nugget": NUGGET}
    ours = evidence(x, y, kernel=PRODUCT, **options)
    kernel = peers_kernel(LENGTHS[:dim])
    other = GaussianProcessRegressor(kernel, alpha=NUGGET, optimizer=None).fit(x, y)
    value, slopes = other.log_marginal_likelihood(kernel.theta, eval_gradient=True)
    by_variance, by_lengths = slopes[0], np.diagonal(slopes[1:].reshape(dim, dim))
    assert ours.value == pytest.approx(value, rel=1e-9)
    expected = [by_variance, *(by_lengths + 3 / dim * by_variance)]
    np.testing.assert_allclose(ours.gradient, expected, rtol=1e-6, atol=1e-6)


def test_gradient_of_the_evidence_is_the_finite_difference():
    x, y = standardised(70, 3)

    def found(z):
        lengths = np.exp(z[1:])
        variance = math.exp(z[0]) * float(lengths.prod())  # of three inputs: the cube of the geometric mean
        return evidence(x, y, kernel=PRODUCT, length_scale=lengths, signal_variance=variance, nugget=1e-2)

    at, step = np.array([0.4, -0.5, 0.3, 1.2]), 1e-5
    slopes = [(found(at + step * e).value - found(at - step * e).value) / (2 * step) for e in np.eye(4)]
    np.testing.assert_allclose(found(at).gradient, slopes, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("dim", [1, 2, 7])
def test_gradient_and_hessian_are_the_finite_differences_of_the_mean(dim):
    x, _, gp = conditioned(dim)
    points = np.concatenate([runs(20, dim, seed=2)[0], x[:3]])
    step = 1e-6 * gp.scale
    for d in range(dim):
        shift = step * np.eye(dim)[d]
        slope = (gp.mean(points + shift) - gp.mean(points - shift)) / (2 * step[d])
        np.testing.assert_allclose(gp.gradient(points)[:, d] * gp.scale[d], slope * gp.scale[d], atol=1e-5)
        bend = (gp.gradient(points + shift) - gp.gradient(points - shift)) / (2 * step[d])
        unit = gp.scale * gp.scale[d]
        np.testing.assert_allclose((gp.hessian(points)[:, d] * unit)[:20], (bend * unit)[:20], atol=1e-4)


def test_hessian_at_a_training_point_is_the_limit_of_those_around_it():
    x, _, gp = conditioned()
    unit, errors = np.outer(gp.scale, gp.scale), []
    for distance in (1e-2, 1e-3, 1e-4):
        around = x[4] + distance * gp.scale * np.concatenate([np.eye(3), -np.eye(3)])
        errors.append(np.abs((gp.hessian(around) - gp.hessian(x[4:5])) * unit).max())
    assert errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.2 * errors[1]


@pytest.mark.parametrize("fused", [False, True, None])
def test_the_jitted_mean_equals_the_plain_one(fused):
    x, _, gp = conditioned(7)
    points = np.concatenate([runs(300, 7, seed=3)[0], x])
    np.testing.assert_allclose(jax.jit(batched_mean(gp, fused=fused))(points), gp.mean(points), rtol=1e-11, atol=1e-10)


def test_the_jitted_mean_has_the_gradient_away_from_the_runs():
    _, _, gp = conditioned()
    points = runs(30, seed=4)[0]
    slope = jax.grad(lambda p: jnp.sum(batched_mean(gp)(p)))(jnp.asarray(points))
    np.testing.assert_allclose(slope, gp.gradient(points), rtol=1e-8, atol=1e-10)


def test_leave_one_out_residuals_equal_those_of_leaving_each_run_out():
    x, y, gp = conditioned()
    found, u = validate(gp, y), (x - gp.shift) / gp.scale
    for i in range(0, len(y), 9):
        rest = np.arange(len(y)) != i
        other = GaussianProcessRegressor(peers_kernel(LENGTHS[:3]), alpha=NUGGET, optimizer=None)
        other.fit(u[rest], (y - y.mean())[rest])
        mean, sd = other.predict(u[i : i + 1], return_std=True)
        assert found.residuals[i] == pytest.approx(y[i] - y.mean() - mean[0], abs=1e-8)
        standardised_residual = found.residuals[i] / math.sqrt(sd[0] ** 2 + NUGGET)
        assert found.standardised_residuals[i] == pytest.approx(standardised_residual, abs=1e-6)


def test_with_one_input_it_is_the_isotropic_kernel():
    x, y = standardised(80, 1)
    product, isotropic = (fit_hyperparameters(x, y, kernel=k, nugget=1e-3) for k in (PRODUCT, ISOTROPIC))
    assert product.log_evidence == pytest.approx(isotropic.log_evidence, abs=1e-6)
    assert product.length_scale[0] == pytest.approx(isotropic.length_scale, rel=1e-3)


def test_the_fit_is_a_maximum_within_its_box_and_the_same_from_both_starts():
    x, y = drawn(200, [0.6, 2.0, 1.0], 1e-3, seed=1)
    fit = fit_hyperparameters(x, y, kernel=PRODUCT, nugget=1e-3)
    assert not fit.at_bound
    assert fit.verdict == "converged" or fit.verdict.startswith("accepted")
    assert np.ptp([a.log_evidence for a in fit.attempts]) < 0.01
    at = {"length_scale": fit.length_scale, "signal_variance": fit.signal_variance}
    best = evidence(x, y, kernel=PRODUCT, nugget=1e-3, **at)
    assert best.value == pytest.approx(fit.log_evidence, abs=1e-6)
    assert np.abs(best.gradient).max() < 0.05
    for factor in (*(1 + 0.1 * np.eye(3)), *(1 - 0.1 * np.eye(3))):
        moved = {**at, "length_scale": fit.length_scale * factor}
        assert evidence(x, y, kernel=PRODUCT, nugget=1e-3, **moved).value < fit.log_evidence


def test_the_fit_reaches_the_best_that_another_optimiser_finds():
    x, y = drawn(120, [0.6, 2.0], 1e-3, seed=2)
    free, fixed = (1e-2, 10.0), (FLAT, FLAT * (1 + 1e-9))
    kernel = (
        ConstantKernel(1.0, (1e-3, 1e5))
        * Matern([1.0, FLAT], [free, fixed], nu=1.5)
        * Matern([FLAT, 1.0], [fixed, free], nu=1.5)
    )
    other = GaussianProcessRegressor(kernel, alpha=1e-3, n_restarts_optimizer=2, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the lengths that are held at their bound
        other.fit(x, y)
    fit = fit_hyperparameters(x, y, kernel=PRODUCT, nugget=1e-3)
    assert fit.log_evidence == pytest.approx(other.log_marginal_likelihood_value_, abs=1e-3)


def test_known_hyperparameters_are_found_again_on_average():
    true = np.array([0.5, 1.5])
    fits = [
        fit_hyperparameters(*drawn(150, true, 1e-4, seed), kernel=PRODUCT, nugget=1e-4, starting_lengths=(1.0,))
        for seed in range(10)
    ]
    found = np.array([[f.signal_variance / length**3 for length in f.length_scale] for f in fits])
    error = np.log(found) - np.log(2.0 / true**3)
    assert (np.abs(error.mean(axis=0)) < 4 * error.std(axis=0) / math.sqrt(10)).all()


def test_an_input_without_influence_ends_at_the_bound():
    x, _ = standardised(120, 3)
    y = np.sin(2 * x[:, 0]) + np.cos(3 * x[:, 2])
    fit = fit_hyperparameters(x, y - y.mean(), kernel=PRODUCT, nugget=1e-4)
    assert fit.at_bound
    assert fit.length_scale[1] == pytest.approx(10.0)
    assert max(fit.length_scale[0], fit.length_scale[2]) < 10.0


def test_lengths_of_their_own_help_where_inputs_differ():
    low, high = np.array([100.0, -0.8, 0.0, 100.0]), np.array([800.0, 0.5, 110.0, 800.0])

    def ridge(u):
        return -40 * (u[:, 0] - 0.3 - 0.3 * u[:, 1] ** 2) ** 2 - 0.5 * u[:, 2] - 0.1 * u[:, 3]

    u, new = sobol(200, 4), sobol(500, 4, scramble=1)
    x, points = low + u * (high - low), low + new * (high - low)
    errors = {
        name: np.sqrt(np.mean((fit_log_likelihood(x, ridge(u), kernel=name).process.mean(points) - ridge(new)) ** 2))
        for name in ("matern32", "matern32_product")
    }
    assert errors["matern32_product"] < 0.7 * errors["matern32"]
