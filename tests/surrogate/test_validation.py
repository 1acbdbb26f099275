import numpy as np
import pytest
from scipy.linalg import cho_solve

from strandline.design import sobol
from strandline.surrogate import KERNELS, condition, validate

MATERN = KERNELS["matern32"]


def process(number=40):
    x = sobol(number, 2)
    y = -40 * (x[:, 0] - 0.4) ** 2 - 25 * (x[:, 1] - x[:, 0] ** 2) ** 2
    gp = condition(x, y, kernel=MATERN, length_scale=1.5, signal_variance=20.0, nugget=1e-3)
    return gp, y


def without(gp, y, i):
    """Return prediction and variance of target i from all other runs, by a new factorisation."""
    keep = np.arange(len(y)) != i
    covariance = 20.0 * MATERN.correlation(np.linalg.norm(gp.x_train[:, None] - gp.x_train, axis=2) / 1.5)
    K = covariance[np.ix_(keep, keep)] + 1e-3 * np.eye(len(y) - 1)
    factor = np.linalg.cholesky(K), True
    k = covariance[i, keep]
    mean = gp.target_mean + k @ cho_solve(factor, y[keep] - gp.target_mean)
    return mean, covariance[i, i] + 1e-3 - k @ cho_solve(factor, k)


def test_residuals_equal_those_of_refitting_without_each_run():
    gp, y = process()
    found = validate(gp, y)
    refitted = np.array([without(gp, y, i) for i in range(len(y))])
    np.testing.assert_allclose(found.residuals, y - refitted[:, 0], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(
        found.standardised_residuals, (y - refitted[:, 0]) / np.sqrt(refitted[:, 1]), rtol=1e-7, atol=1e-9
    )
    assert found.loo_rms == pytest.approx(np.sqrt(np.mean((y - refitted[:, 0]) ** 2)))


def test_near_mode_is_ten_log_units_but_at_least_ten_runs():
    gp, y = process()
    near = validate(gp, y)
    assert near.near_mode_count == (y > y.max() - 10).sum() > 10
    assert near.loo_rms_near_mode == pytest.approx(np.sqrt(np.mean(near.residuals[y > y.max() - 10] ** 2)))
    steep = validate(gp, 1000 * y)
    assert steep.near_mode_count == 10
    assert set(np.flatnonzero(steep.near_mode)) == set(np.argsort(y)[-10:])


def test_fewer_runs_than_ten_all_count():
    x = sobol(6, 2)
    y = 100 * x[:, 0]
    gp = condition(x, y, kernel=MATERN, length_scale=1.0, signal_variance=1.0, nugget=1e-3)
    assert validate(gp, y).near_mode_count == 6


def test_standardised_residuals_of_a_true_process_have_unit_size():
    x = sobol(300, 2)
    z = (x - x.mean(axis=0)) / x.std(axis=0)
    K = 20.0 * MATERN.correlation(np.linalg.norm(z[:, None] - z, axis=2) / 1.5) + 1e-3 * np.eye(300)
    y = np.linalg.cholesky(K) @ np.random.default_rng(0).standard_normal(300)
    gp = condition(x, y, kernel=MATERN, length_scale=1.5, signal_variance=20.0, nugget=1e-3)
    assert validate(gp, y).standardised_rms == pytest.approx(1.0, abs=0.15)
