"""The surrogate of a log-likelihood on ridges like those of calibrations, and its errors against the number of runs."""

import math

import numpy as np
import pytest

from strandline.design import sobol
from strandline.errors import InvalidInput, NumericsError, TooFewRuns
from strandline.surrogate import convergence_study, fit_log_likelihood
from strandline.surrogate.log_likelihood import relative_error, relative_error_of_exponentials

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


U = sobol(250, 2)


def quadratic(u):
    return -20 * (u[:, 0] - 0.4) ** 2 - 15 * (u[:, 1] - u[:, 0] ** 2) ** 2


def study(train=210, test=40, **options):
    few, new = U[:train], U[210 : 210 + test]
    return convergence_study(few, quadratic(few), new, quadratic(new), **options)


def test_errors_fall_with_the_number_of_runs_of_which_only_the_first_are_used():
    """By default the sizes are those of a study, as far as there are runs."""
    found = study(sizes=[25, 100])
    assert found.sizes.tolist() == [25, 100]
    for errors in (found.log_likelihood, found.likelihood):
        assert errors[1] < 0.4 * errors[0]
    few, many = (study(train, sizes=[50]) for train in (50, 210))
    assert few.log_likelihood[0] == many.log_likelihood[0]
    assert study().sizes.tolist() == [100, 200]
    for sizes, test, words in (([211], 9, "210"), ([], 9, "210"), ([50], 0, "test points")):
        with pytest.raises(InvalidInput, match=words):
            study(test=test, sizes=sizes)


def test_relative_errors_by_hand():
    """Of likelihoods also beyond the range of numbers."""
    truth = np.array([3.0, 4.0])
    assert relative_error(np.array([3.0, 4.5]), truth) == pytest.approx(0.1)
    for shift in (-2000.0, 0.0, 2000.0):
        found = relative_error_of_exponentials(np.log([3.0, 4.5]) + shift, np.log(truth) + shift)
        assert found == pytest.approx(0.1)
    assert relative_error_of_exponentials(truth - 1e4, truth) == pytest.approx(1.0)
    assert relative_error_of_exponentials(truth + 1e4, truth) == math.inf
