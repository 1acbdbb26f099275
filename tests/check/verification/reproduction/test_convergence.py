"""Errors of the surrogate of a log-likelihood against the number of runs."""

import math

import numpy as np
import pytest
from verification.reproduction.convergence import convergence_study, relative_error, relative_error_of_exponentials

from strandline.design import sobol
from strandline.errors import InvalidInput

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
