"""Modes of the field, and one coefficient's process: against its own data, refitting, scikit-learn and contrasts."""

import itertools
import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct

from strandline.design import sobol
from strandline.foundations import NumericsError
from strandline.surrogate.field import mode_process
from strandline.surrogate.field.field import decompose
from strandline.surrogate.field.mode_process import ModeData, ModeProcess, condition_mode, fit_mode, restricted_evidence

S = np.linspace(0.0, 1.0, 40)
WEIGHTS = np.random.default_rng(0).uniform(0.5, 1.5, 40)
WEIGHTS /= WEIGHTS.sum()
SHAPES = np.array([S, np.sin(3 * S), np.cos(5 * S), S**3])
FIELDS = 2.0 + (np.random.default_rng(1).normal(size=(30, 4)) * [1.0, 0.1, 0.01, 0.001]) @ SHAPES


def rms(values):
    """Return the root of the mean over runs of the mean square along the interface."""
    return float(np.sqrt(np.mean(values**2 @ WEIGHTS)))


def test_the_fewest_modes_within_the_tolerance_and_no_more_than_there_are_processes():
    for tolerance, most, number in [(1e-7, 9, 4), (2e-4, 9, 3), (5e-3, 9, 2), (0.3, 9, 1), (10.0, 9, 1), (1e-9, 2, 2)]:
        found = decompose(FIELDS, WEIGHTS, None, tolerance=tolerance, most=most)
        np.testing.assert_allclose(found.basis @ found.basis.T, np.eye(number), atol=1e-12)
        fewer = found.coefficients(FIELDS)
        left = rms(FIELDS - found.fields(fewer))
        assert found.remainder == pytest.approx(left, rel=1e-6, abs=1e-12)
        assert left <= tolerance or number == most
        fewer[:, -1] = 0.0
        assert number == 1 or rms(FIELDS - found.fields(fewer)) > tolerance
    np.testing.assert_allclose(found.tail @ found.basis.T, 0.0, atol=1e-12)


def test_coefficients_are_lengths_and_derivatives_are_spanned_and_carried_over():
    """The squared norm of a field is its mean square along the interface. Runs may know a derivative only."""
    found = decompose(FIELDS, WEIGHTS, None, tolerance=1e-9)
    norms = np.sum(found.coefficients(FIELDS) ** 2, axis=1)
    np.testing.assert_allclose(norms, ((FIELDS - FIELDS.mean(axis=0)) ** 2) @ WEIGHTS, rtol=1e-8)
    F = np.outer(np.random.default_rng(2).normal(size=12), SHAPES[0])
    derivatives = np.stack([np.tile(SHAPES[0], (12, 1)), np.tile(SHAPES[1], (12, 1))], axis=2)
    found = decompose(F, WEIGHTS, derivatives, tolerance=1e-6)
    by_input = found.by_input(derivatives)
    change = found.coefficients(F + SHAPES[0]) - found.coefficients(F)
    np.testing.assert_allclose(by_input[:, :, 0], change, rtol=1e-6, atol=1e-9)
    assert np.sum(by_input[0, :, 0] ** 2) == pytest.approx(SHAPES[0] ** 2 @ WEIGHTS, rel=1e-2)


CASES = pytest.mark.parametrize(("gradients", "linear"), list(itertools.product([False, True], [False, True])))
LENGTHS = np.array([1.4, 2.2])
FLAT = 1e5
"""Variance of a prior that says nothing, in variances of the process."""


def slopes(z):
    a, b, grown = np.sin(1.1 * z[:, 0]), np.cos(1.1 * z[:, 0]), np.exp(0.3 * z[:, 1])
    return np.stack([1.1 * b * grown, 0.3 * a * grown + 0.4], axis=1)


def observed(gradients, linear, runs=12):
    z = np.sqrt(12.0) * (sobol(runs, 2) - 0.5)
    values = np.sin(1.1 * z[:, 0]) * np.exp(0.3 * z[:, 1]) + 0.4 * z[:, 1]
    return ModeData(z, values, slopes(z) if gradients else None, linear)


def without(one, run):
    keep = np.arange(len(one.z)) != run
    return ModeData(one.z[keep], one.values[keep], None if one.gradients is None else one.gradients[keep], one.linear)


def conditioned(one, nugget):
    return ModeProcess(one, LENGTHS, nugget, condition_mode(one, LENGTHS, nugget))


@CASES
def test_it_goes_through_what_was_observed(gradients, linear):
    one = observed(gradients, linear)
    process = conditioned(one, 1e-10)
    np.testing.assert_allclose(process.mean(one.z), one.values, atol=1e-5)
    assert np.sqrt(process.variance(one.z)).max() < 1e-4
    if gradients:
        step = 1e-4 * np.eye(2)
        found = np.stack([(process.mean(one.z + h) - process.mean(one.z - h)) / 2e-4 for h in step], axis=1)
        np.testing.assert_allclose(found, slopes(one.z), atol=1e-5)
    assert np.sqrt(np.mean((fit_mode(one).mean(one.z) - one.values) ** 2)) < 0.01


@CASES
def test_left_out_is_what_refitting_without_the_run_gives(gradients, linear):
    """And the variance is the diagonal of the covariance."""
    one, nugget = observed(gradients, linear), 1e-4
    process = conditioned(one, nugget)
    found = process.left_out()
    for run in range(len(one.z)):
        refitted, place = conditioned(without(one, run), nugget), one.z[run : run + 1]
        error = one.values[run] - float(refitted.mean(place)[0])
        assert found.errors[run] == pytest.approx(error, rel=1e-5, abs=1e-8)
        relative = float(refitted.variance(place)[0]) / refitted.scale + nugget
        assert found.variances[run] / process.scale == pytest.approx(relative, rel=1e-5)
    z = np.random.default_rng(5).uniform(-2.5, 2.5, (30, 2))
    C = process.covariance(z, z)
    np.testing.assert_allclose(process.variance(z), np.diagonal(C), rtol=1e-8, atol=1e-10)
    assert np.linalg.eigvalsh(C).min() > -1e-8


@pytest.mark.parametrize("linear", [False, True])
def test_scikit_learn_says_the_same(linear):
    """There the unknown mean is a further term of the kernel, of nearly infinite variance."""
    one, nugget = observed(False, linear), 1e-3
    process = conditioned(one, nugget)
    s2 = process.scale
    kernel = ConstantKernel(s2) * RBF(LENGTHS) + ConstantKernel(FLAT * s2)
    if linear:
        kernel = kernel + ConstantKernel(FLAT * s2) * DotProduct(sigma_0=0.0, sigma_0_bounds="fixed")
    other = GaussianProcessRegressor(kernel, alpha=s2 * nugget, optimizer=None).fit(one.z, one.values)
    z = np.random.default_rng(6).uniform(-2.0, 2.0, (50, 2))
    mean, deviation = other.predict(z, return_std=True)
    np.testing.assert_allclose(process.mean(z), mean, atol=2e-4)
    np.testing.assert_allclose(np.sqrt(process.variance(z)), deviation, rtol=1e-3, atol=1e-4 * np.sqrt(s2))
    np.testing.assert_allclose(process.covariance(z, z), other.predict(z, return_cov=True)[1], atol=2e-4 * s2)


def test_residuals_that_are_too_large_widen_the_variance():
    """Values with noise ten times what the largest nugget allows for; as if four more runs were as expected."""
    one = observed(False, False, runs=20)
    process = fit_mode(replace(one, values=one.values + np.random.default_rng(7).normal(size=20)))
    narrow = replace(process, widening=1.0).left_out()
    surprise = float(np.sum(narrow.errors**2 / narrow.variances))
    assert surprise > 20
    assert process.widening == pytest.approx((surprise + 4) / 24)
    assert 1 <= fit_mode(one).widening < 20


def test_a_fast_response_is_not_taken_for_scatter(monkeypatch):
    """Runs all over the box and many at one place; planted: without the last start, all is called noise."""
    spread, cluster = sobol(60, 2, scramble=1) - 0.5, 0.04 * (sobol(70, 2, scramble=3) - 0.5) - 0.05
    z, search = np.sqrt(12.0) * np.concatenate([spread, cluster]), mode_process.minimize
    one = ModeData(z, np.sin(9 * z.sum(axis=1)), None, True)
    assert fit_mode(one).nugget < 1e-8

    def from_afar(function, start, **options):
        return search(function, np.where([True, True, False], np.maximum(start, 0.0), start), **options)

    monkeypatch.setattr(mode_process, "minimize", from_afar)
    assert fit_mode(one).nugget > 1e-3


@pytest.mark.parametrize("gradients", [False, True])
def test_some_of_very_many_runs_tell_the_hyperparameters_and_all_the_response(monkeypatch, gradients):
    """Their errors elsewhere are nearly those of hyperparameters from all runs, far below those of these runs alone."""
    z = np.sqrt(12.0) * (sobol(140, 2, scramble=1) - 0.5)
    values, slopes = np.sin(z[:, 0]) * z[:, 1], np.stack([np.cos(z[:, 0]) * z[:, 1], np.sin(z[:, 0])], axis=1)
    one = ModeData(z[:100], values[:100], slopes[:100] if gradients else None, True)
    every = fit_mode(one)
    monkeypatch.setattr(mode_process, "_ENOUGH", 150 if gradients else 50)
    few = one.thinned()
    assert len(few.z) == 50
    assert set(map(tuple, few.z)) < set(map(tuple, one.z))
    some, alone = fit_mode(one), fit_mode(few)
    assert not np.array_equal(some.lengths, every.lengths)
    errors = [np.sqrt(np.mean((process.mean(z[100:]) - values[100:]) ** 2)) for process in (every, some, alone)]
    assert errors[1] < 3 * errors[0]
    assert errors[2] > 20 * errors[1]


@jax.jit
def all_pairs(z, lengths):
    """Return covariances of value and derivatives of all pairs (run, run, 3, 3), by automatic differentiation."""

    def kernel(a, b):
        return jnp.exp(-0.5 * jnp.sum(((a - b) / lengths) ** 2))

    def both(a, b):
        by_a, by_b = jax.grad(kernel, 0), jax.grad(kernel, 1)
        return jnp.block([[kernel(a, b), by_b(a, b)[None]], [by_a(a, b)[:, None], jax.jacfwd(by_a, 1)(a, b)]])

    return jax.vmap(jax.vmap(both, (None, 0)), (0, None))(z, z)


def plain(one, log_lengths, log_nugget):
    """Return the log density of contrasts that no mean reaches, s² at its largest likelihood, noise as in the code.

    All by the inputs themselves: y = (values, ∂_1, ∂_2).
    """
    lengths, tau = np.exp(log_lengths), math.exp(log_nugget)
    n, dim = one.z.shape
    C = np.asarray(all_pairs(one.z, lengths)).transpose(2, 0, 3, 1).reshape(3 * n, 3 * n)
    noise = tau * np.repeat([1.0, *(1 / lengths**2)], n)
    F = np.zeros((3 * n, 3 if one.linear else 1))
    F[:n, 0] = 1.0
    if one.linear:
        F[:n, 1:] = one.z
        for j in range(dim):
            F[(j + 1) * n : (j + 2) * n, j + 1] = 1.0
    rows = slice(None) if one.gradients is not None else slice(n)
    y = one.values if one.gradients is None else np.concatenate([one.values, one.gradients.T.ravel()])
    C, F = (C + np.diag(noise))[rows, rows], F[rows]
    A = null_space(F.T)
    S, contrasts = A.T @ C @ A, A.T @ y
    variance = float(contrasts @ np.linalg.solve(S, contrasts)) / len(contrasts)
    density = multivariate_normal(cov=variance * S, allow_singular=False).logpdf(contrasts)
    constant = -0.5 * len(contrasts) * (math.log(2 * math.pi) + 1) + 0.5 * np.linalg.slogdet(F.T @ F)[1]
    return float(density - constant)


@CASES
def test_the_evidence_is_the_density_of_contrasts_and_the_gradient_is_its(gradients, linear):
    one, step = observed(gradients, linear, runs=9), 1e-4
    for at in np.array([[0.0, 0.4, -6.0], [0.9, -0.3, -9.0], [1.2, 1.5, -4.0]]):
        value, slope = restricted_evidence(one, at[:2], at[2])
        assert value == pytest.approx(plain(one, at[:2], at[2]), rel=1e-7, abs=1e-6)
        ends = [[restricted_evidence(one, x[:2], x[2])[0] for x in (at + e, at - e)] for e in step * np.eye(3)]
        differences = [(up - down) / (2 * step) for up, down in ends]
        np.testing.assert_allclose(slope, differences, rtol=1e-5, atol=1e-4)


def test_what_has_no_evidence_is_refused():
    flat = replace(observed(False, False), values=np.zeros(12))
    repeated = ModeData(np.zeros((4, 2)), np.arange(4.0), None, False)
    for one, log_nugget, words in ((flat, -6.0, "without variation"), (repeated, -50.0, "not positive definite")):
        with pytest.raises(NumericsError, match=words):
            restricted_evidence(one, np.zeros(2), log_nugget)


def test_the_slope_of_the_evidence_and_its_prior_is_that_of_differences():
    one, at = observed(False, True), np.array([0.3, -0.2, -6.0])
    expected = approx_fprime(at, lambda x: mode_process._objective(x, one)[0], 1e-6)
    np.testing.assert_allclose(mode_process._objective(at, one)[1], expected, rtol=1e-4, atol=1e-3)
