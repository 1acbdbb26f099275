"""Designs that grow, against true posteriors and at test points."""

import math

import numpy as np
import pytest
from verification.reproduction.designs import (
    READINGS,
    convergence_study,
    larger_designs,
    nested_surrogates,
    relative_error,
    relative_error_of_exponentials,
    runs_to_find,
)
from verification.reproduction.field_table import LoadCoordinates
from verification.reproduction.grid_posterior import posterior_on_grid, posteriors_on_grid, product_grid
from verification.reproduction.truth import spline_field

from strandline.design import sobol
from strandline.foundations import InvalidInput
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.surrogate import fit_log_likelihood

E, NU = Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", Uniform(-0.8, 0.5))
SPACE = ParameterSpace((E, NU))
UNCERTAIN = ParameterSpace((E, NU, Parameter("V_in", Uniform(20.0, 100.0), "mm^2/s", nuisance=True)))
PEAK = np.array([400.0, 0.1])
SIZES = (40, 160, 320)


def log_likelihood(x):
    """A tilted Gaussian ridge that levels off far away, as the currents measure does."""
    e, nu = (x[..., 0] - PEAK[0]) / 60, (x[..., 1] - PEAK[1]) / 0.15
    return -30 * (1 - np.exp(-(e**2 + nu**2 - 1.2 * e * nu) / 60))


def test_more_runs_come_nearer_to_the_truth_and_each_step_knows_its_own_successful_runs_alone():
    """Planted: what the later runs say must not matter to the earlier designs."""
    x = SPACE.to_physical(sobol(200, 2))
    values = np.where(x[:, 0] < 100 + 80 * (x[:, 1] + 0.8), np.nan, log_likelihood(x))
    truth = posterior_on_grid(log_likelihood, SPACE, product_grid(SPACE, panels=(48, 24, 1), rate=100.0))
    first, second, last = nested_surrogates(x, values, truth, SPACE, sizes=(25, 50, 200))
    assert last.total_variation < 0.02 < first.total_variation
    near_mode = [step.surrogate.validation.loo_rms_near_mode for step in (first, last)]
    assert near_mode[1] < 0.3 * near_mode[0]
    np.testing.assert_allclose(last.maximum_likelihood, PEAK, rtol=0.02)
    ok = np.isfinite(values[:50])
    fitted = fit_log_likelihood(x[:50][ok], values[:50][ok])
    np.testing.assert_array_equal(fitted.process.alpha, second.surrogate.process.alpha)


def field_about(centre):
    """A ridge along a constant load, so that E goes with V, and a peak in ν."""
    axes = (np.linspace(-1.0, 1.0, 61), np.linspace(-1.0, 1.0, 15), np.linspace(-1.0, 1.0, 11))
    box = LoadCoordinates()
    x = box.from_box(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    load = np.where(np.isfinite(x[..., 0]), box.load(x), 0.0)
    values = -30 * (1 - np.exp(-(((load - centre) / 0.1) ** 2) / 60)) - 0.5 * ((x[..., 1] - 0.1) / 0.25) ** 2
    return spline_field(box, axes, values)


def compared(field, sizes=SIZES):
    """Compare designs that answer `field` with the truth about 0.45."""
    true, grid = field_about(0.45), product_grid(UNCERTAIN, panels=(16, 8, 6))
    return larger_designs(field, posteriors_on_grid(true, UNCERTAIN, grid), UNCERTAIN, sizes=sizes, panels=(16, 8, 6))


def test_larger_designs_come_nearer_until_the_posterior_is_found_and_that_of_another_model_is_not():
    """Planted: designs that answer a softer model than the truth is of."""
    designs = compared(field_about(0.45))
    assert all(0.85 * design.runs < design.succeeded < design.runs for design in designs)  # others leave the table
    softer = compared(field_about(0.5), SIZES[-1:])
    for reading in READINGS:
        off = [float(np.abs(d.differences[reading].mean).max()) for d in designs]
        assert off[-1] < 0.15 < off[0], reading
        assert runs_to_find(designs, reading) in SIZES[1:]
        assert runs_to_find(softer, reading) is None


U = sobol(250, 2)


def quadratic(u):
    return -20 * (u[:, 0] - 0.4) ** 2 - 15 * (u[:, 1] - u[:, 0] ** 2) ** 2


def study(sizes, train=210):
    few, new = U[:train], U[210:]
    return convergence_study(few, quadratic(few), new, quadratic(new), sizes=sizes)


def test_errors_fall_with_the_number_of_runs_of_which_only_the_first_are_used():
    found = study([25, 100])
    assert found.sizes == (25, 100)
    for errors in (found.log_likelihood, found.likelihood):
        assert errors[1] < 0.4 * errors[0]
    few, many = (study([50], train) for train in (50, 210))
    assert few.log_likelihood == many.log_likelihood
    with pytest.raises(InvalidInput, match="none above 210"):
        study([50, 211])


def test_relative_errors_by_hand():
    """Of likelihoods also beyond the range of numbers."""
    truth = np.array([3.0, 4.0])
    assert relative_error(np.array([3.0, 4.5]), truth) == pytest.approx(0.1)
    for shift in (-2000.0, 0.0, 2000.0):
        found = relative_error_of_exponentials(np.log([3.0, 4.5]) + shift, np.log(truth) + shift)
        assert found == pytest.approx(0.1)
    assert relative_error_of_exponentials(truth - 1e4, truth) == pytest.approx(1.0)
    assert relative_error_of_exponentials(truth + 1e4, truth) == math.inf
