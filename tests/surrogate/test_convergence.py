import math

import numpy as np
import pytest

from strandline.design import sobol
from strandline.errors import InvalidInput
from strandline.surrogate import convergence_study
from strandline.surrogate.convergence import STUDY_SIZES, relative_error, relative_error_of_exponentials


def quadratic(u):
    return -20 * (u[:, 0] - 0.4) ** 2 - 15 * (u[:, 1] - u[:, 0] ** 2) ** 2


U = sobol(500, 2)
TRAIN, TEST = U[:400], U[400:]


def test_errors_fall_with_the_number_of_runs():
    found = convergence_study(TRAIN, quadratic(TRAIN), TEST, quadratic(TEST), sizes=[25, 100, 400])
    assert found.sizes.tolist() == [25, 100, 400]
    for errors in (found.log_likelihood, found.likelihood):
        assert errors[1] < 0.4 * errors[0]
        assert errors[2] < 0.4 * errors[1]


def test_only_the_first_runs_are_used():
    y = quadratic(TRAIN)
    few = convergence_study(TRAIN[:50], y[:50], TEST, quadratic(TEST), sizes=[50], kernel="matern32_product")
    many = convergence_study(TRAIN, y, TEST, quadratic(TEST), sizes=[50], kernel="matern32_product")
    assert few.log_likelihood[0] == many.log_likelihood[0]


def test_the_sizes_are_the_studys_as_far_as_there_are_runs():
    found = convergence_study(TRAIN, quadratic(TRAIN), TEST, quadratic(TEST))
    assert found.sizes.tolist() == [100, 200]
    assert STUDY_SIZES == (100, 200, 500, 1000, 2000, 5000)


@pytest.mark.parametrize("sizes", [[401], []])
def test_more_runs_than_there_are_and_none_are_refused(sizes):
    with pytest.raises(InvalidInput, match="400"):
        convergence_study(TRAIN, quadratic(TRAIN), TEST, quadratic(TEST), sizes=sizes)


def test_no_test_points_are_refused():
    with pytest.raises(InvalidInput, match="test points"):
        convergence_study(TRAIN, quadratic(TRAIN), TEST[:0], quadratic(TEST[:0]), sizes=[50])


def test_relative_errors_by_hand():
    truth = np.array([3.0, 4.0])
    assert relative_error(np.array([3.0, 4.5]), truth) == pytest.approx(0.1)
    found = relative_error_of_exponentials(np.log([3.0, 4.5]), np.log(truth))
    assert found == pytest.approx(0.1)


@pytest.mark.parametrize("shift", [-2000.0, 0.0, 2000.0])
def test_likelihoods_beyond_the_range_of_numbers_are_compared(shift):
    found = relative_error_of_exponentials(np.log([3.0, 4.5]) + shift, np.log([3.0, 4.0]) + shift)
    assert found == pytest.approx(0.1)


def test_extreme_errors_of_likelihoods():
    truth = np.array([-5.0, -2.0])
    assert relative_error_of_exponentials(truth, truth) == 0.0
    assert relative_error_of_exponentials(truth - 1e4, truth) == pytest.approx(1.0)
    assert relative_error_of_exponentials(truth + 1e4, truth) == math.inf
