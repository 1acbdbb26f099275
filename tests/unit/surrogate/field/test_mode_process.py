"""One coefficient's process against its own data, against refitting, and against scikit-learn."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct

from strandline.design import sobol
from strandline.errors import NumericsError
from strandline.surrogate.field import mode_process
from strandline.surrogate.field.mode_process import ModeProcess, fit_mode
from strandline.surrogate.field.restricted_evidence import Observed, condition_mode

CASES = list(itertools.product([False, True], [False, True]))
LENGTHS = np.array([1.4, 2.2])
FLAT = 1e5
"""Variance of a prior that says nothing, in variances of the process."""


def truth(z: np.ndarray) -> np.ndarray:
    return np.sin(1.1 * z[:, 0]) * np.exp(0.3 * z[:, 1]) + 0.4 * z[:, 1]


def slopes(z: np.ndarray) -> np.ndarray:
    a, b, grown = np.sin(1.1 * z[:, 0]), np.cos(1.1 * z[:, 0]), np.exp(0.3 * z[:, 1])
    return np.stack([1.1 * b * grown, 0.3 * a * grown + 0.4], axis=1)


def observed(gradients: bool, linear: bool, runs: int = 12) -> Observed:
    z = np.sqrt(12.0) * (sobol(runs, 2) - 0.5)
    return Observed(z, truth(z), slopes(z) if gradients else None, linear)


def without(one: Observed, run: int) -> Observed:
    keep = np.arange(len(one.z)) != run
    return Observed(one.z[keep], one.values[keep], None if one.gradients is None else one.gradients[keep], one.linear)


def conditioned(one: Observed, lengths: np.ndarray, nugget: float) -> ModeProcess:
    return ModeProcess(one, lengths, nugget, condition_mode(one, lengths, nugget))


@pytest.mark.parametrize(("gradients", "linear"), CASES)
def test_it_goes_through_what_was_observed(gradients: bool, linear: bool) -> None:
    one = observed(gradients, linear)
    process = conditioned(one, LENGTHS, 1e-10)
    np.testing.assert_allclose(process.mean(one.z), one.values, atol=1e-5)
    assert np.sqrt(process.variance(one.z)).max() < 1e-4
    if gradients:
        step = 1e-4 * np.eye(2)
        found = np.stack([(process.mean(one.z + h) - process.mean(one.z - h)) / 2e-4 for h in step], axis=1)
        np.testing.assert_allclose(found, slopes(one.z), atol=1e-5)
    fitted = fit_mode(one)
    left = np.sqrt(np.mean((fitted.mean(one.z) - one.values) ** 2))
    assert left < min(2 * np.sqrt(fitted.nugget * fitted.scale), 0.01)


@pytest.mark.parametrize(("gradients", "linear"), CASES)
def test_left_out_is_what_refitting_without_the_run_gives(gradients: bool, linear: bool) -> None:
    """And the variance is the diagonal of the covariance."""
    one, nugget = observed(gradients, linear), 1e-4
    process = conditioned(one, LENGTHS, nugget)
    found = process.left_out()
    for run in range(len(one.z)):
        refitted, place = conditioned(without(one, run), LENGTHS, nugget), one.z[run : run + 1]
        error = one.values[run] - float(refitted.mean(place)[0])
        assert found.errors[run] == pytest.approx(error, rel=1e-5, abs=1e-8)
        relative = float(refitted.variance(place)[0]) / refitted.scale + nugget
        assert found.variances[run] / process.scale == pytest.approx(relative, rel=1e-5)
    z = np.random.default_rng(5).uniform(-2.5, 2.5, (30, 2))
    C = process.covariance(z, z)
    np.testing.assert_allclose(process.variance(z), np.diagonal(C), rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(C, C.T, atol=1e-10)
    assert np.linalg.eigvalsh(C).min() > -1e-8


@pytest.mark.parametrize("linear", [False, True])
def test_scikit_learn_says_the_same(linear: bool) -> None:
    """There the unknown mean is a further term of the kernel, of nearly infinite variance."""
    one, nugget = observed(False, linear), 1e-3
    process = conditioned(one, LENGTHS, nugget)
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


def test_residuals_that_are_too_large_widen_the_variance() -> None:
    """Values with noise ten times what the largest nugget allows for; as if four more runs were as expected."""
    one = observed(False, False, runs=20)
    noisy = Observed(one.z, one.values + np.random.default_rng(7).normal(size=20), None, False)
    process = fit_mode(noisy)
    left_out, narrow = process.left_out(), replace(process, widening=1.0).left_out()
    assert 0.3 < np.mean(left_out.errors**2 / left_out.variances) < 1.3
    surprise = float(np.sum(narrow.errors**2 / narrow.variances))
    assert surprise > 20
    assert process.widening == pytest.approx((surprise + 4) / 24)
    assert 1 <= fit_mode(one).widening < 20


def test_a_mode_without_variation_is_refused() -> None:
    one = observed(False, False)
    with pytest.raises(NumericsError, match="no length scales"):
        fit_mode(Observed(one.z, np.zeros(len(one.z)), None, False))


def test_a_fast_response_is_not_taken_for_scatter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs all over the box and many at one place; planted: without the last start, all is called noise."""
    spread, cluster = sobol(60, 2, scramble=1) - 0.5, 0.04 * (sobol(70, 2, scramble=3) - 0.5) - 0.05
    z, search = np.sqrt(12.0) * np.concatenate([spread, cluster]), mode_process.minimize
    observed = Observed(z, np.sin(9 * z.sum(axis=1)), None, True)
    assert fit_mode(observed).nugget < 1e-8

    def from_afar(function: Any, start: np.ndarray, **options: Any) -> Any:
        return search(function, np.where([True, True, False], np.maximum(start, 0.0), start), **options)

    monkeypatch.setattr(mode_process, "minimize", from_afar)
    assert fit_mode(observed).nugget > 1e-3
