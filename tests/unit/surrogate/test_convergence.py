"""Errors of the surrogate against the number of runs."""

import math

import numpy as np
import pytest

from strandline.design import sobol
from strandline.errors import InvalidInput
from strandline.surrogate import convergence_study
from strandline.surrogate.convergence import STUDY_SIZES, relative_error, relative_error_of_exponentials


def quadratic(u):
    return -20 * (u[:, 0] - 0.4) ** 2 - 15 * (u[:, 1] - u[:, 0] ** 2) ** 2


U = sobol(250, 2)
TRAIN, TEST = U[:210], U[210:]
Y = quadratic(TRAIN)


def test_errors_fall_with_the_number_of_runs():
    found = convergence_study(TRAIN, Y, TEST, quadratic(TEST), sizes=[25, 100])
    assert found.sizes.tolist() == [25, 100]
    for errors in (found.log_likelihood, found.likelihood):
        assert errors[1] < 0.4 * errors[0]


def test_only_the_first_runs_are_used_and_sizes_are_the_studys_as_far_as_there_are_runs():
    few = convergence_study(TRAIN[:50], Y[:50], TEST, quadratic(TEST), sizes=[50], kernel="matern32_product")
    many = convergence_study(TRAIN, Y, TEST, quadratic(TEST), sizes=[50], kernel="matern32_product")
    assert few.log_likelihood[0] == many.log_likelihood[0]
    assert convergence_study(TRAIN, Y, TEST, quadratic(TEST)).sizes.tolist() == [100, 200]
    assert STUDY_SIZES == (100, 200, 500, 1000, 2000, 5000)


@pytest.mark.parametrize(("sizes", "test", "words"), [([211], 9, "210"), ([], 9, "210"), ([50], 0, "test points")])
def test_runs_and_points_that_there_are_not_are_refused(sizes, test, words):
    with pytest.raises(InvalidInput, match=words):
        convergence_study(TRAIN, Y, TEST[:test], quadratic(TEST[:test]), sizes=sizes)


def test_relative_errors_by_hand():
    """Of likelihoods also beyond the range of numbers."""
    truth = np.array([3.0, 4.0])
    assert relative_error(np.array([3.0, 4.5]), truth) == pytest.approx(0.1)
    for shift in (-2000.0, 0.0, 2000.0):
        found = relative_error_of_exponentials(np.log([3.0, 4.5]) + shift, np.log(truth) + shift)
        assert found == pytest.approx(0.1)
    assert relative_error_of_exponentials(truth, truth) == 0.0
    assert relative_error_of_exponentials(truth - 1e4, truth) == pytest.approx(1.0)
    assert relative_error_of_exponentials(truth + 1e4, truth) == math.inf
