"""The surrogate of a log-likelihood on ridges like those of calibrations."""

import numpy as np
import pytest

from strandline.design import sobol
from strandline.foundations import InvalidInput, NumericsError, TooFewRuns
from strandline.surrogate import fit_log_likelihood

LOW, HIGH = np.array([100.0, -0.8]), np.array([800.0, 0.5])


def ridge(x):
    u = (x - LOW) / (HIGH - LOW)
    return -30 * (u[:, 0] - 0.3 - 0.3 * u[:, 1] ** 2) ** 2 - 3 * (u[:, 1] - 0.7) ** 2


def design(number):
    return LOW + sobol(number, 2) * (HIGH - LOW)


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def test_a_ridge_is_learnt_better_with_more_runs_and_left_out_runs_tell_how_well():
    new = sobol(300, 2, scramble=1)
    points, inside = (LOW + u * (HIGH - LOW) for u in (new, 0.1 + 0.8 * new))
    fits = [fit_log_likelihood(design(number), ridge(design(number))) for number in (25, 100, 400)]
    errors = [rms(fit.process.mean(points) - ridge(points)) for fit in fits]
    assert errors[1] < 0.35 * errors[0]
    assert errors[2] < min(0.35 * errors[1], 0.01)
    within = (np.abs((design(100) - LOW) / (HIGH - LOW) - 0.5) < 0.4).all(axis=1)
    error = rms(fits[1].process.mean(inside) - ridge(inside))
    assert error < rms(fits[1].validation.residuals[within]) < 10 * error
    assert fits[0].process.nugget == pytest.approx(1e-5 * np.ptp(ridge(design(25))))


def test_any_noise_level_is_fitted_and_unusable_data_is_refused():
    x, y = design(100), ridge(design(100))
    for scale in (1e-3, 1e5):
        assert fit_log_likelihood(x, scale * y).validation.loo_rms < 0.01 * np.ptp(scale * y)
    for few, values, kernel, error, words in (
        (x[:3], y[:3], "matern32", TooFewRuns, "at least 4"),
        (x[:9], y[:8], "matern32", InvalidInput, "one log-likelihood for each run"),
        (x[:9], np.where(np.arange(9) == 7, -np.inf, y[:9]), "matern32", InvalidInput, "training run 7"),
        (x[:9], np.full(9, -2.5), "matern32", NumericsError, "all 9 training targets equal -2.5"),
        (x[:9] * [1, 0] + [0, 0.2], y[:9], "matern32", InvalidInput, "column 1"),
        (x[:9], y[:9], "gauss", InvalidInput, "kernel"),
    ):
        with pytest.raises(error, match=words):
            fit_log_likelihood(few, values, kernel=kernel)
