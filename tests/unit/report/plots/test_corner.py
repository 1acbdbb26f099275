"""The corner plot: what its regions hold, and that a notebook shows figures that pyplot does not know."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline
from tests.unit.report.plots.drawn import NU, E, entries

from strandline.errors import InvalidInput
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior
from strandline.report.plots import plot_corner, plot_hexagons
from strandline.report.plots.of_posterior import PosteriorPlots

DRAWS = np.random.default_rng(3).multivariate_normal([400.0, 0.1], [[400.0, 1.2], [1.2, 0.01]], 4000)


def posterior(dim: int = 2) -> Posterior:
    zeros = np.zeros(len(DRAWS))
    space = ParameterSpace((E, NU)[:dim])
    return Posterior(space, DRAWS[:, :dim], zeros - np.log(len(DRAWS)), zeros, zeros, 0.0)


def test_regions_hold_their_probabilities_and_all_is_in_the_legend() -> None:
    figure = plot_corner(posterior(), truth={"E": 400.0})
    outlines = figure.axes[1].collections[-1]
    held = [np.mean(Outline.contains_points(path, DRAWS)) for path in outlines.get_paths()]
    np.testing.assert_allclose(held, (0.95, 0.68), atol=0.04, err_msg="the largest region first")
    assert entries(figure) == ["posterior", "prior", "truth", "68 %", "95 %"]
    own = Figure()
    assert plot_corner(posterior(1), prior=False, figure=own) is own
    assert entries(own) == ["posterior"]
    assert len(own.axes) == 1
    for masses in ((), (0.0,), (0.5, 1.0)):
        with pytest.raises(InvalidInput, match="between 0 and 1"):
            plot_corner(posterior(), masses=masses)


def test_a_notebook_shows_figures_and_axes_and_draws_into_those_of_ones_own() -> None:
    plots = PosteriorPlots(posterior())
    for drawing in (plots.joint(), plots.marginal()):
        assert drawing._repr_png_().startswith(b"\x89PNG")
    ax = Figure().add_subplot()
    assert plot_hexagons(posterior(), ("E", "nu"), ax=ax) is ax
