"""The corner plot: what its regions hold, and that a notebook shows figures that pyplot does not know."""

from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline

from strandline.errors import InvalidInput
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import Uniform
from strandline.report.plots import plot_corner, plot_hexagons
from strandline.report.plots.of_posterior import PosteriorPlots

PNG = b"\x89PNG"
DRAWS = np.random.default_rng(3).multivariate_normal([400.0, 0.1], [[400.0, 1.2], [1.2, 0.01]], 4000)


def posterior(dim: int = 2) -> Posterior:
    space = ParameterSpace((Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", Uniform(-0.8, 0.5))))
    space = ParameterSpace(space.parameters[:dim])
    zeros = np.zeros(len(DRAWS))
    return Posterior(space, DRAWS[:, :dim], zeros - np.log(len(DRAWS)), zeros, zeros, 0.0)


def labels(figure: Any) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize("masses", [(0.68, 0.95), (0.5,), (0.95, 0.68)])
def test_regions_hold_their_probabilities(masses: tuple[float, ...]) -> None:
    figure = plot_corner(posterior(), masses=masses)
    lines = figure.axes[1].collections[-1]  # the outlines, the largest region first
    held = [np.mean(Outline.contains_points(path, DRAWS)) for path in lines.get_paths()]
    np.testing.assert_allclose(sorted(held), sorted(masses), atol=0.04)  # smoothing widens the draws


def test_truths_priors_and_regions_are_in_the_legend() -> None:
    figure = plot_corner(posterior(), truth={"E": 400.0})
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "posterior",
        "prior",
        "truth",
        "68 %",
        "95 %",
    ]
    bare = plot_corner(posterior(1), prior=False)
    assert [text.get_text() for text in bare.legends[0].get_texts()] == ["posterior"]
    assert len(bare.axes) == 1


@pytest.mark.parametrize("masses", [(), (0.0,), (0.5, 1.0)])
def test_impossible_probabilities_are_refused(masses: tuple[float, ...]) -> None:
    with pytest.raises(InvalidInput, match="between 0 and 1"):
        plot_corner(posterior(), masses=masses)


def test_a_notebook_shows_figures_and_axes() -> None:
    plots = PosteriorPlots(posterior())
    for drawing in (plots.corner(), plots.joint(), plots.marginal()):
        assert drawing._repr_png_().startswith(PNG)


def test_axes_of_ones_own_are_drawn_in_and_returned() -> None:
    ax = Figure().add_subplot()
    assert plot_hexagons(posterior(), ("E", "nu"), ax=ax) is ax
    figure = Figure()
    assert plot_corner(posterior(), figure=figure) is figure
