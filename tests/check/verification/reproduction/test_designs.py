"""Designs that grow, nested ones and those without runs, against true posteriors in closed form up to quadrature."""

import numpy as np
import pytest
from verification.reproduction.field_table import LoadCoordinates
from verification.reproduction.figures import plot_convergence, plot_nested_likelihoods
from verification.reproduction.grid_posterior import Difference, posterior_on_grid, product_grid
from verification.reproduction.larger_designs import READINGS, LargerDesign, larger_designs, runs_to_find
from verification.reproduction.log_likelihood_field import spline_field
from verification.reproduction.nested import NestedDesign, nested_surrogates, two_inputs

from strandline.design import sobol
from strandline.errors import InvalidInput
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


@pytest.fixture(scope="module")
def design():
    x = SPACE.to_physical(sobol(200, 2))
    values = np.where(x[:, 0] < 100 + 80 * (x[:, 1] + 0.8), np.nan, log_likelihood(x))
    return NestedDesign(x, values)


@pytest.fixture(scope="module")
def truth():
    return posterior_on_grid(log_likelihood, SPACE, product_grid(SPACE, panels=(48, 24, 1), rate=100.0))


@pytest.fixture(scope="module")
def steps(design, truth):
    return nested_surrogates(design, truth, SPACE, sizes=(25, 50, 100, 200))


def test_more_runs_come_nearer_to_the_truth_and_its_peak_and_a_shift_is_seen(steps, truth):
    first, last = steps[0], steps[-1]
    assert last.total_variation < 0.02 < first.total_variation
    assert np.abs(last.difference.mean).max() < 0.05
    assert last.loo_rms_near_mode < 0.3 * first.loo_rms_near_mode
    np.testing.assert_allclose(last.maximum_likelihood, PEAK, rtol=0.02)
    assert not np.allclose(first.maximum_likelihood, PEAK, rtol=1e-3)
    shifted = posterior_on_grid(lambda x: two_inputs(last.surrogate.process)(x - [30.0, 0.0, 0.0]), SPACE, truth.grid)
    assert shifted.mean[0] - truth.mean[0] == pytest.approx(30, rel=0.1)


def test_each_step_knows_its_own_successful_runs_alone(design, steps, truth):
    """Planted: what the later runs say must not matter to the earlier designs."""
    alone = NestedDesign(design.x[:50], design.log_likelihoods[:50])
    fitted = fit_log_likelihood(alone.x[alone.ok], alone.log_likelihoods[alone.ok])
    np.testing.assert_array_equal(fitted.process.alpha, steps[1].surrogate.process.alpha)
    assert (steps[1].runs, steps[1].succeeded) == (50, int(alone.ok.sum()))
    assert steps[-1].succeeded == np.isfinite(design.log_likelihoods).sum() < 200
    with pytest.raises(InvalidInput, match="nested design"):
        nested_surrogates(design, truth, SPACE, sizes=(201,))


def test_figures_have_a_panel_a_design_and_two_lines_a_measure(design, steps, truth):
    figure = plot_nested_likelihoods(steps, truth, SPACE, training=design.x[design.ok], ground_truth=PEAK)
    titled = {ax.get_title(): len(ax.lines[0].get_xdata()) for ax in figure.axes if ax.get_title()}
    assert titled == {f"{s.runs} runs, TV {s.total_variation:.2g}": s.succeeded for s in steps}
    figure.canvas.draw()
    ax = plot_convergence({"centre": steps, "refined": steps})
    assert [len(line.get_xdata()) for line in ax.lines] == [4, 4, 4, 4, 0, 0]  # the last two are for the legend
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), [s.loo_rms_near_mode for s in steps])
    ax.figure.canvas.draw()


def field_about(centre):
    """A ridge along a constant load, so that E goes with V, and a peak in ν."""
    axes = (np.linspace(-1.0, 1.0, 61), np.linspace(-1.0, 1.0, 15), np.linspace(-1.0, 1.0, 11))
    box = LoadCoordinates()
    x = box.from_box(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    load = np.where(np.isfinite(x[..., 0]), box.load(x), 0.0)
    values = -30 * (1 - np.exp(-(((load - centre) / 0.1) ** 2) / 60)) - 0.5 * ((x[..., 1] - 0.1) / 0.25) ** 2
    return spline_field(box, axes, values)


def compared(field, sizes=SIZES, **options):
    """Compare designs that answer `field` with the truth about 0.45."""
    true, grid = field_about(0.45), product_grid(UNCERTAIN, panels=(16, 8, 6))
    posteriors = {reading: posterior_on_grid(true, UNCERTAIN, grid, reading=reading) for reading in READINGS}
    return larger_designs(field, posteriors, UNCERTAIN, sizes=sizes, panels=(16, 8, 6), **options)


def test_larger_designs_come_nearer_until_the_posterior_is_found_and_that_of_another_model_is_not():
    """Planted: designs that answer a softer model than the truth is of."""
    designs = compared(field_about(0.45))
    assert [design.runs for design in designs] == list(SIZES)
    # Points beyond the table are no training points.
    assert all(0.85 * design.runs < design.succeeded < design.runs for design in designs)
    frozen = compared(field_about(0.45), fitted=160)  # hyperparameters of the first runs serve the larger designs
    softer = compared(field_about(0.5), SIZES[-1:])
    for reading in READINGS:
        off = [float(np.abs(d.differences[reading].mean).max()) for d in designs]
        assert off[-1] < 0.15 < off[0], reading
        assert runs_to_find(designs, reading) in SIZES[1:]
        np.testing.assert_array_equal(frozen[1].differences[reading].mean, designs[1].differences[reading].mean)
        assert np.abs(frozen[2].differences[reading].mean - designs[2].differences[reading].mean).max() < 0.1
        assert runs_to_find(softer, reading) is None


def larger(runs, mean, ratio=0.0):
    one = Difference(np.array([0.0, mean]), np.array([ratio, 0.0]), 0.0, 0.0, None)
    return LargerDesign(runs, runs, dict.fromkeys(READINGS, one))


def test_found_is_what_stays_found_in_the_mean_and_the_standard_deviation():
    for found, runs in (((0, 1, 1), 160), ((1, 0, 1), 320), ((1, 1, 1), 40), ((1, 1, 0), None)):
        designs = [larger(n, 0.1 if ok else 0.2) for n, ok in zip(SIZES, found, strict=True)]
        assert runs_to_find(designs, "joint") == runs
    assert larger(9, -0.1).found("cut")
    assert not larger(9, -0.2).found("cut")
    assert not larger(9, 0.0, ratio=-0.2).found("cut")
