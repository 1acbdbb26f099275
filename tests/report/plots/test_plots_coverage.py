"""Figures of repeated experiments: what the artists hold, not how they look."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from strandline.posterior.uniformity import Band, uniformity
from strandline.report.plots import IntervalCoverage, plot_intervals, plot_rank_band, plot_rank_bands
from strandline.report.plots.style import BLUE, RED

EVEN = (np.arange(50) + 0.5) / 50


def bands(number: int) -> dict[str, Band]:
    return {f"E_{k}": uniformity(EVEN**2 if k == 1 else EVEN) for k in range(number)}


def test_ranks_that_leave_the_band_stand_out() -> None:
    right, wrong = bands(2).values()
    for band, colour in ((right, BLUE), (wrong, RED)):
        ax = plot_rank_band(band)
        (line,) = [one for one in ax.lines if len(one.get_xdata()) == 49]
        assert line.get_color() == colour
        np.testing.assert_allclose(line.get_ydata(), band.found - band.places)
        assert "95 % band" in ax.get_legend_handles_labels()[1]


@pytest.mark.parametrize("number", [1, 2, 7])
def test_each_input_has_a_panel(number: int) -> None:
    figure = plot_rank_bands(bands(number))
    assert isinstance(figure, Figure)
    FigureCanvasAgg(figure).draw()
    assert len(figure.axes) == number
    assert figure.axes[0].get_title() == r"E$_{\mathrm{0}}$"
    assert len(figure.legends) == 1


def test_intervals_of_each_input() -> None:
    some = [IntervalCoverage(0.5, 0.46, 0.39, 0.53), IntervalCoverage(0.9, 1.0, 0.98, 1.0)]
    ax = plot_intervals({"E": some, "nu": some[:2]})
    assert [label.get_text() for label in ax.get_xticklabels()] == ["E", "nu"]
    handles, labels = ax.get_legend_handles_labels()
    assert labels == ["50 % intervals", "90 % intervals"]
    assert len(handles[0].get_children()[0].get_xdata()) == 2
    assert isinstance(ax.figure, Figure)
    FigureCanvasAgg(ax.figure).draw()
