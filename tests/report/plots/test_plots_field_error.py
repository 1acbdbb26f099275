"""Errors of a surrogate along the interface: legends that leave room for the axes."""

import warnings

import numpy as np
import pytest

from strandline.report.plots import ErrorsAlong, plot_field_error
from strandline.report.plots.style import SINGLE, figure_of


def errors(number: int) -> dict[str, ErrorsAlong]:
    s = np.linspace(0.0, 1.5, 40)
    along = [1e-5 * (1 + k) * np.sin(2 * s) ** 2 for k in range(number)]
    return {f"t{k + 1}" if number > 1 else "": ErrorsAlong(s, e, 0.7 * e) for k, e in enumerate(along)}


@pytest.mark.parametrize("number", [1, 2, 5, 10])
def test_axes_keep_most_of_the_figure(number):
    figure = figure_of(ax := plot_field_error(errors(number)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.get_layout_engine().execute(figure)
    box = ax.get_position()
    assert box.width * box.height > 0.45
    assert figure.get_figwidth() == SINGLE


@pytest.mark.parametrize("number", [1, 2, 10])
def test_each_kind_and_condition_has_one_entry(number):
    figure = figure_of(plot_field_error(errors(number)))
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels[:2] == ["runs, each from the others", "its own estimate at draws"]
    assert labels[2:] == ([f"t{k + 1}" for k in range(number)] if number > 1 else [])


def test_each_of_ten_conditions_has_its_own_colour():
    ax = plot_field_error(errors(10))
    assert len({tuple(np.atleast_1d(line.get_color())) for line in ax.lines}) == 10
