"""The figure of other assumptions: what the artists hold, not how they look."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from strandline.report.plots import Whisker, plot_alternatives
from strandline.report.plots.style import BLUE, RED


@pytest.mark.parametrize("number", [1, 2, 7])
def test_each_input_has_a_panel(number: int) -> None:
    present = {f"E_{k}": Whisker(1.0, 0.5, 1.5) for k in range(number)}
    some = [("noise", [Whisker(1.4, 0.9, 1.9, moves=True)] * number), ("prior", [Whisker(1.1, 0.6, 1.6)] * number)]
    figure = plot_alternatives(present, some)
    assert isinstance(figure, Figure)
    FigureCanvasAgg(figure).draw()
    assert [ax.get_xlabel() for ax in figure.axes] == list(present)
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["noise", "prior"]
    assert len(figure.legends) == 1


def test_what_moves_stands_out_and_what_is_fixed_has_no_mark() -> None:
    present = {"E": Whisker(1.0, 0.5, 1.5), "nu": Whisker(0.0, -0.1, 0.1)}
    figure = plot_alternatives(present, [("noise", [Whisker(1.4, 0.9, 1.9, moves=True), None])])
    left, right = figure.axes
    (container,) = left.containers
    assert container.lines[0].get_color() == RED
    (segment,) = container.lines[2][0].get_segments()
    np.testing.assert_allclose(segment[:, 0], [0.9, 1.9])
    np.testing.assert_allclose(container.lines[0].get_xdata(), [1.4])
    assert not right.containers
    figure = plot_alternatives({"E": present["E"]}, [("prior", [Whisker(1.1, 0.6, 1.6)])])
    assert figure.axes[0].containers[0].lines[0].get_color() == BLUE
