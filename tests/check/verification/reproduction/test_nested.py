"""Nested designs against a truth in closed form, and the figures of them."""

import numpy as np
import pytest
from verification.reproduction.figures import plot_convergence, plot_nested_likelihoods
from verification.reproduction.grid_posterior import posterior_on_grid, product_grid
from verification.reproduction.nested import NestedDesign, nested_surrogates, two_inputs
from verification.reproduction.page import _place
from verification.reproduction.pictures import FROM_REPORTS, Picture

from strandline.design import sobol
from strandline.errors import InvalidInput
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.surrogate import fit_log_likelihood

SPACE = ParameterSpace((Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", Uniform(-0.8, 0.5))))
PEAK = np.array([400.0, 0.1])
SIZES = (25, 50, 100, 200)


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
    return nested_surrogates(design, truth, SPACE, sizes=SIZES)


def test_more_runs_come_nearer_to_the_truth_and_its_peak(steps):
    variations = [step.total_variation for step in steps]
    assert variations[-1] < 0.02 < variations[0]
    assert np.abs(steps[-1].difference.mean).max() < 0.05
    assert steps[-1].loo_rms_near_mode < 0.3 * steps[0].loo_rms_near_mode
    np.testing.assert_allclose(steps[-1].maximum_likelihood, PEAK, rtol=0.02)
    assert not np.allclose(steps[0].maximum_likelihood, PEAK, rtol=1e-3)


def test_each_step_knows_its_own_successful_runs_alone(design, steps, truth):
    """Planted: what the later runs say must not matter to the earlier designs."""
    alone = NestedDesign(design.x[:50], design.log_likelihoods[:50])
    fitted = fit_log_likelihood(alone.x[alone.ok], alone.log_likelihoods[alone.ok])
    np.testing.assert_array_equal(fitted.process.alpha, steps[1].surrogate.process.alpha)
    assert (steps[1].runs, steps[1].succeeded) == (50, int(alone.ok.sum()))
    assert steps[1].succeeded < 50
    assert steps[-1].succeeded == np.isfinite(design.log_likelihoods).sum() < 200
    with pytest.raises(InvalidInput, match="nested design"):
        nested_surrogates(design, truth, SPACE, sizes=(201,))


def test_a_shifted_surrogate_is_seen_by_the_mean(steps, truth):
    process = steps[-1].surrogate.process
    shifted = posterior_on_grid(lambda x: two_inputs(process)(x - [30.0, 0.0, 0.0]), SPACE, truth.grid)
    assert shifted.mean[0] - truth.mean[0] == pytest.approx(30, rel=0.1)


def test_figures_have_a_panel_a_design_and_two_lines_a_measure(design, steps, truth):
    figure = plot_nested_likelihoods(steps, truth, SPACE, training=design.x[design.ok], ground_truth=PEAK)
    titled = {ax.get_title(): len(ax.lines[0].get_xdata()) for ax in figure.axes if ax.get_title()}
    assert titled == {f"{s.runs} runs, TV {s.total_variation:.2g}": s.succeeded for s in steps}
    figure.canvas.draw()
    ax = plot_convergence({"centre": steps, "refined": steps})
    assert [len(line.get_xdata()) for line in ax.lines] == [4, 4, 4, 4, 0, 0]  # the last two are for the legend
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), [s.loo_rms_near_mode for s in steps])
    ax.figure.canvas.draw()


def test_figures_stand_on_the_page_in_the_order_of_their_numbers():
    drawn = [*(entry[0] for entry in FROM_REPORTS), "8", "8, refined", "8, errors", "11", "12", "12, likelihood"]
    ordered = [p.number for p in sorted((Picture(number, "", b"") for number in drawn), key=_place)]
    assert ordered[:6] == ["3", "4", "5", "6", "7", "8"]
    last = ["9a", "9a, refined", "9b", "9c", "9d", "9d, cut", "10", "11", "12", "12, likelihood", "13", "14", "15"]
    assert ordered[-len(last) :] == last
