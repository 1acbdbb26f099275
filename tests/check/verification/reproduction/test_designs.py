"""Designs that grow, nested ones and those without runs, against true posteriors."""

import numpy as np
from verification.reproduction.field_table import LoadCoordinates
from verification.reproduction.grid_posterior import posterior_on_grid, product_grid
from verification.reproduction.larger_designs import READINGS, larger_designs, runs_to_find
from verification.reproduction.log_likelihood_field import spline_field
from verification.reproduction.nested import NestedDesign, nested_surrogates

from strandline.design import sobol
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
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
    first, second, last = nested_surrogates(NestedDesign(x, values), truth, SPACE, sizes=(25, 50, 200))
    assert last.total_variation < 0.02 < first.total_variation
    assert last.loo_rms_near_mode < 0.3 * first.loo_rms_near_mode
    np.testing.assert_allclose(last.maximum_likelihood, PEAK, rtol=0.02)
    alone = NestedDesign(x[:50], values[:50])
    fitted = fit_log_likelihood(alone.x[alone.ok], alone.log_likelihoods[alone.ok])
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
    posteriors = {reading: posterior_on_grid(true, UNCERTAIN, grid, reading=reading) for reading in READINGS}
    return larger_designs(field, posteriors, UNCERTAIN, sizes=sizes, panels=(16, 8, 6))


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
