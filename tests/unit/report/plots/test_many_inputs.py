"""Figures of a posterior of seven inputs: what the artists hold, not how they look."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from tests.unit.report.plots.drawn import entries, hexagon_mass, rendered

from strandline.errors import InvalidInput
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import Uniform
from strandline.report.plots import plot_marginals, plot_pairs, plot_parallel, plot_selected_pairs
from strandline.report.plots.parallel import DENSITY, _order

NAMES = ("E1", "E2", "E3", "nu1", "nu2", "nu3", "V_in")
SPACE = ParameterSpace(tuple(Parameter(name, Uniform(0.0, 10.0), "Pa" if "E" in name else "1") for name in NAMES))


def seven(number: int = 300) -> Posterior:
    """Return a posterior whose first seven particles have no weight."""
    draws = np.random.default_rng(0).uniform(0.0, 10.0, (number, 7))
    log_likelihood = -0.5 * ((draws[:, 1] - 3.0) / 1.5) ** 2
    log_weights = np.where(np.arange(number) < 7, -np.inf, log_likelihood)
    log_weights -= np.logaddexp.reduce(log_weights)
    return Posterior(SPACE, draws, log_weights, log_likelihood, np.full(number, -7.0), -2.0)


SEVEN = seven()


def test_parallel_axes_hold_every_particle_of_weight_from_low_to_high_density() -> None:
    ax = plot_parallel(SEVEN, truth={"E2": 5.0})
    rendered(ax.figure)
    (lines,) = [c for c in ax.collections if isinstance(c, LineCollection)]
    density = np.asarray(lines.get_array())
    assert len(lines.get_segments()) == len(density) == 293
    assert lines.get_rasterized()
    np.testing.assert_allclose(density, np.sort(SEVEN.log_density[7:]))
    heights = np.asarray(lines.get_segments()[-1])[:, 1]
    np.testing.assert_allclose(heights, [*SEVEN.draws[SEVEN.map_index] / 10.0, 1.0])
    labels = [t.get_text().replace("\n", " ") for t in ax.get_xticklabels()]
    assert labels == ["E1 [Pa]", "E2 [Pa]", "E3 [Pa]", "nu1", "nu2", "nu3", "V_in", DENSITY]
    (dot,) = [line for line in ax.lines if line.get_label() == "ground truth"]
    np.testing.assert_allclose(dot.get_xydata(), [[1.0, 0.5]])
    ticks = {text.get_text(): text.get_position()[1] for text in ax.texts if text.get_position()[0] < 0}
    assert len(ticks) >= 4
    for label, height in ticks.items():
        assert float(label) / 10.0 == pytest.approx(height)


def test_parallel_axes_in_the_order_that_is_asked_and_nuisance_inputs_behind_the_density() -> None:
    ax = plot_parallel(SEVEN, ("nu1", DENSITY, "V_in"))
    assert [t.get_text().replace("\n", " ") for t in ax.get_xticklabels()] == ["nu1", DENSITY, "V_in"]
    with pytest.raises(InvalidInput, match="names of inputs"):
        plot_parallel(SEVEN, ("nu9",))
    space = ParameterSpace((Parameter("V", Uniform(0.0, 10.0), nuisance=True), *SPACE.parameters[:6]))
    posterior = Posterior(space, SEVEN.draws, SEVEN.log_weights, SEVEN.log_likelihood, SEVEN.log_prior, -2.0)
    assert _order(posterior) == (*NAMES[:6], DENSITY, "V")


def test_pairs_have_numbers_at_the_rim_only_and_explain_the_ground_truth() -> None:
    figure = plot_pairs(SEVEN, NAMES[:3], truth={"E1": 5.0, "E2": 5.0})
    panels = np.array(figure.axes[:9]).reshape(3, 3)
    for i, j in zip(*np.tril_indices(3), strict=True):
        shown = panels[i, j].xaxis.get_tick_params()["labelbottom"], panels[i, j].yaxis.get_tick_params()["labelleft"]
        assert shown == (i == 2, j == 0 and i > 0)
    assert "ground truth" in entries(figure)
    assert "ground truth" not in entries(plot_pairs(SEVEN, NAMES[:2]))


def test_selected_pairs_are_those_that_are_named() -> None:
    pairs = [("E2", "E1"), ("E2", "nu2"), ("nu1", "nu2")]
    figure = rendered(plot_selected_pairs(SEVEN, pairs, truth={"E2": 5.0, "nu2": 1.0}))
    assert [(ax.get_xlabel().split()[0], ax.get_ylabel().split()[0]) for ax in figure.axes] == pairs
    for ax in figure.axes:
        assert hexagon_mass(ax) == pytest.approx(1.0, abs=0.02)
    assert [sum(line.get_label() == "ground truth" for line in ax.lines) for ax in figure.axes] == [0, 1, 0]
    with pytest.raises(InvalidInput, match="at least one pair"):
        plot_selected_pairs(SEVEN, [])


def test_seven_marginals_have_a_panel_each() -> None:
    figure = rendered(plot_marginals(SEVEN))
    assert [ax.get_xlabel().split()[0] for ax in figure.axes] == list(NAMES)
