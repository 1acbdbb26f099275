"""Figures of answers: several models, repeated experiments, other assumptions, sensitivity, errors of a surrogate."""

import warnings

import numpy as np
import pytest
from matplotlib.figure import Figure
from tests.unit.report.plots.drawn import entries, rendered

from strandline.posterior import SobolIndices
from strandline.posterior.uniformity import uniformity
from strandline.report import plots
from strandline.report.plots import ErrorsAlong, IntervalCoverage, Whisker
from strandline.report.plots.style import BLUE, RED, SINGLE, figure_of

EDGES = np.linspace(0.0, 2.0, 5)


def marginals(label: str) -> plots.ModelMarginals:
    densities = {"a": np.array([1.0, 1.0, 0.0, 0.0]), "b_c$": np.array([0.0, 0.0, 1.0, 1.0])}
    return plots.ModelMarginals(label, "Pa", EDGES, np.full(4, 0.5), densities)


def test_marginals_are_steps_of_each_model_and_of_the_average() -> None:
    ax = plots.plot_model_marginals(marginals("E"))
    drawn = {patch.get_label(): patch.get_data() for patch in ax.patches}
    assert list(drawn) == ["a", r"b_c\$", "averaged"]
    np.testing.assert_array_equal(drawn["a"].values, [1.0, 1.0, 0.0, 0.0])
    np.testing.assert_array_equal(drawn["averaged"].edges, EDGES)
    assert "Pa" in ax.get_xlabel()
    figure = plots.plot_averaged({str(k): marginals(f"E{k}") for k in range(4)})
    assert (len(figure.axes), len(figure.legends)) == (4, 1)


def test_predictions_have_a_row_for_each_condition_and_a_column_for_each_model() -> None:
    s, flat = np.linspace(0.0, 1.0, 6), np.full(6, 0.001)
    bands = {
        (condition, name): plots.OffsetBand(s, -flat, 0 * flat, flat, s, np.full(6, float(k)))
        for k, name in enumerate("ab")
        for condition in ("slow", "fast")
    }
    figure = plots.plot_predictions(bands)
    assert [ax.get_title() for ax in figure.axes] == ["a, slow", "b, slow", "a, fast", "b, fast"]
    observed = [float(ax.lines[-1].get_ydata()[0]) for ax in figure.axes]
    assert observed == [0.0, 1e3, 0.0, 1e3], "in micrometres"
    assert plots.plot_predictions({("", "a"): bands["slow", "a"]}).axes[0].get_title() == "a"


def test_ranks_that_leave_the_band_stand_out() -> None:
    even = (np.arange(50) + 0.5) / 50
    right, wrong = uniformity(even), uniformity(even**2)
    for band, colour in ((right, BLUE), (wrong, RED)):
        ax = plots.plot_rank_band(band)
        (line,) = [one for one in ax.lines if len(one.get_xdata()) == 49]
        assert line.get_color() == colour
        np.testing.assert_allclose(line.get_ydata(), band.found - band.places)
        assert "95 % band" in ax.get_legend_handles_labels()[1]
    for number in (1, 7):
        figure = rendered(plots.plot_rank_bands({f"E_{k}": wrong if k == 1 else right for k in range(number)}))
        assert (len(figure.axes), len(figure.legends)) == (number, 1)
        assert figure.axes[0].get_title() == r"E$_{\mathrm{0}}$"


def test_intervals_of_each_input() -> None:
    some = [IntervalCoverage(0.5, 0.46, 0.39, 0.53), IntervalCoverage(0.9, 1.0, 0.98, 1.0)]
    ax = plots.plot_intervals({"E": some, "nu": some})
    rendered(ax.figure)
    assert [label.get_text() for label in ax.get_xticklabels()] == ["E", "nu"]
    handles, labels = ax.get_legend_handles_labels()
    assert labels == ["50 % intervals", "90 % intervals"]
    assert len(handles[0].get_children()[0].get_xdata()) == 2


def test_other_assumptions_that_move_an_input_stand_out_and_fixed_ones_have_no_mark() -> None:
    present = {"E": Whisker(1.0, 0.5, 1.5), "nu": Whisker(0.0, -0.1, 0.1)}
    some = [("noise", [Whisker(1.4, 0.9, 1.9, moves=True), None]), ("prior", [Whisker(1.1, 0.6, 1.6), None])]
    figure = rendered(plots.plot_alternatives(present, some))
    left, right = figure.axes
    prior, noise = left.containers
    assert [one.lines[0].get_color() for one in (noise, prior)] == [RED, BLUE]
    (segment,) = noise.lines[2][0].get_segments()
    np.testing.assert_allclose(segment[:, 0], [0.9, 1.9])
    np.testing.assert_allclose(noise.lines[0].get_xdata(), [1.4])
    assert not right.containers
    assert [label.get_text() for label in left.get_yticklabels()] == ["noise", "prior"]
    seven = {f"E_{k}": Whisker(1.0, 0.5, 1.5) for k in range(7)}
    figure = rendered(plots.plot_alternatives(seven, [("prior", [Whisker(1.1, 0.6, 1.6)] * 7)]))
    assert [ax.get_xlabel() for ax in figure.axes] == list(seven)
    assert len(figure.legends) == 1


def test_bars_are_the_sensitivity_indices_from_the_top_down() -> None:
    first, total = np.array([0.2, -0.01, 0.5]), np.array([0.3, 0.02, 0.7])
    indices = SobolIndices(first, first - 0.05, first + 0.04, total, total - 0.1, total + 0.1, 10)
    ax = plots.plot_sensitivity(indices, ("E", "nu", "V"))
    rendered(ax.figure)
    drawn = [[bar.get_width() for bar in container] for container in ax.containers if hasattr(container, "patches")]
    np.testing.assert_allclose(drawn, [first, total])
    assert [text.get_text() for text in ax.get_yticklabels()] == ["E", "nu", "V"]
    assert ax.yaxis_inverted()
    low, high = ax.get_xlim()
    assert low <= -0.06
    assert high >= 1.0


@pytest.mark.parametrize("number", [1, 2, 10])
def test_errors_along_the_interface_leave_room_for_the_axes_beside_their_legend(number: int) -> None:
    s = np.linspace(0.0, 1.5, 40)
    along = [1e-5 * (1 + k) * np.sin(2 * s) ** 2 for k in range(number)]
    names = [f"t{k + 1}" for k in range(number)] if number > 1 else [""]
    ax = plots.plot_field_error({name: ErrorsAlong(s, e, 0.7 * e) for name, e in zip(names, along, strict=True)})
    figure = figure_of(ax)
    assert isinstance(figure, Figure)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.get_layout_engine().execute(figure)
    box = ax.get_position()
    assert box.width * box.height > 0.45
    assert figure.get_figwidth() == SINGLE
    kinds = ["runs, each from the others", "its own estimate at draws"]
    assert entries(figure) == [*kinds, *(names if number > 1 else [])]
    assert len({tuple(np.atleast_1d(line.get_color())) for line in ax.lines}) == number
