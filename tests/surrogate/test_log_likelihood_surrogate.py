import numpy as np
import pytest

from strandline.design import sobol
from strandline.errors import InvalidInput, NumericsError, TooFewRuns
from strandline.surrogate import fit_log_likelihood

LOW, HIGH = np.array([100.0, -0.8]), np.array([800.0, 0.5])


def ridge(x):
    u = (x - LOW) / (HIGH - LOW)
    return -30 * (u[:, 0] - 0.3 - 0.3 * u[:, 1] ** 2) ** 2 - 3 * (u[:, 1] - 0.7) ** 2


def design(number):
    return LOW + sobol(number, 2) * (HIGH - LOW)


def test_a_ridge_is_learnt_better_with_more_runs():
    points = LOW + sobol(600, 2, scramble=1) * (HIGH - LOW)
    errors = []
    for number in (25, 100, 400):
        surrogate = fit_log_likelihood(design(number), ridge(design(number)))
        errors.append(np.sqrt(np.mean((surrogate.process.mean(points) - ridge(points)) ** 2)))
    assert errors[1] < 0.35 * errors[0]
    assert errors[2] < 0.35 * errors[1]
    assert errors[2] < 0.01


def test_leave_one_out_bounds_the_error_at_new_points():
    x = design(100)
    surrogate = fit_log_likelihood(x, ridge(x))
    inside = LOW + (0.1 + 0.8 * sobol(600, 2, scramble=1)) * (HIGH - LOW)
    error = np.sqrt(np.mean((surrogate.process.mean(inside) - ridge(inside)) ** 2))
    inner = (np.abs((x - LOW) / (HIGH - LOW) - 0.5) < 0.4).all(axis=1)
    left_out = np.sqrt(np.mean(surrogate.validation.residuals[inner] ** 2))
    assert error < left_out < 10 * error


def test_the_nugget_is_the_studys():
    x = design(50)
    surrogate = fit_log_likelihood(x, ridge(x))
    assert surrogate.process.nugget == pytest.approx(1e-5 * np.ptp(ridge(x)))
    assert surrogate.process.length_scale == surrogate.fit.length_scale


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_any_noise_level_is_fitted(scale):
    x = design(100)
    surrogate = fit_log_likelihood(x, scale * ridge(x))
    assert surrogate.validation.loo_rms < 0.01 * np.ptp(scale * ridge(x))


@pytest.mark.parametrize(
    ("x", "y", "error", "words"),
    [
        (design(3), ridge(design(3)), TooFewRuns, "at least 4"),
        (design(9), ridge(design(9))[:8], InvalidInput, "one log-likelihood for each run"),
        (design(9), np.full(9, -2.5), NumericsError, "all 9 training targets equal -2.5"),
        (design(9), np.full(9, np.nan), InvalidInput, "training run 0"),
        (design(9) * [1, 0] + [0, 0.2], ridge(design(9)), InvalidInput, "column 1"),
    ],
)
def test_unusable_data_is_refused(x, y, error, words):
    with pytest.raises(error, match=words):
        fit_log_likelihood(x, y)


def test_an_unknown_kernel_is_refused():
    with pytest.raises(InvalidInput, match="kernel"):
        fit_log_likelihood(design(20), ridge(design(20)), kernel="gauss")
