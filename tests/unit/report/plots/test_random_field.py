"""Figures of a random field: what the artists hold."""

import numpy as np
import pytest
from matplotlib.collections import PathCollection, TriMesh
from tests.unit.report.plots.drawn import E, entries, lines, posterior_of, rendered

from strandline.foundations import InvalidInput
from strandline.parameters import GaussianField, Parameter, Support
from strandline.posterior import FieldPosterior
from strandline.report import plots
from strandline.report.plots.pairs import PosteriorPlots
from strandline.report.plots.random_field import _triangles

GRID = np.stack(np.meshgrid(np.linspace(0.0, 2.0, 21), np.linspace(0.0, 1.0, 11)), axis=-1).reshape(-1, 2)
NOTCHED = GRID[~((GRID[:, 0] > 0.75) & (GRID[:, 0] < 1.25) & (GRID[:, 1] > 0.45))]


def found_at(points, *, log=True):
    field = GaussianField(400.0, 0.5, 0.5, log=log, modes=8).on("E", Support(points, np.ones(len(points))), "Pa")
    draws = np.random.default_rng(0).standard_normal((400, 8)) * np.linspace(0.3, 1.0, 8)
    return FieldPosterior(field, draws, np.full(400, 1 / 400))


def test_along_a_line_there_are_bands_draws_the_truth_and_below_the_share_that_is_left():
    found = found_at(np.linspace(1.0, 0.0, 21)[:, None])
    figure = rendered(plots.plot_random_field(found, truth=np.full(21, 380.0), draws=2))
    top, bottom = figure.axes
    labels = ["prior 90 %", "posterior 90 %", "posterior 50 %", "draws", "mean", "ground truth"]
    assert entries(figure) == labels
    np.testing.assert_allclose(lines(top, "mean")[0][:, 1], found.mean[::-1])
    np.testing.assert_allclose(bottom.lines[0].get_ydata(), found.share_left[::-1])
    assert (top.get_ylabel(), bottom.get_xlabel()) == ("E [Pa]", "x [mm]")


def test_over_a_plane_mean_truth_and_draws_have_one_colour_scale():
    found = found_at(np.column_stack([NOTCHED, np.full(len(NOTCHED), 0.2)]), log=False)
    figure = rendered(plots.plot_random_field(found, truth=found.mean))
    panels = {ax.get_title(): ax for ax in figure.axes if ax.get_title()}
    share = "share of the prior's sd left"
    assert list(panels) == ["mean", "standard deviation", share, "ground truth", "draw 1", "draw 2"]
    drawn = {title: next(one for one in ax.collections if isinstance(one, TriMesh)) for title, ax in panels.items()}
    assert len({drawn[title].get_clim() for title in ("mean", "ground truth", "draw 1", "draw 2")}) == 1
    assert drawn[share].get_clim() == (0.0, 1.0)
    np.testing.assert_array_equal(drawn["mean"].get_array(), found.mean)
    assert {ax.get_ylabel() for ax in figure.axes} == {"E [Pa]", "share", "y [mm]", ""}


@pytest.mark.parametrize("points", [NOTCHED, np.random.default_rng(0).random((400, 2))], ids=["mesh", "scattered"])
def test_triangles_cover_the_region_but_bridge_no_notch(points):
    """Planted: without the mask, the notch is covered."""
    found = _triangles(points)
    centres = points[found.triangles].mean(axis=1)
    hidden = np.zeros(len(centres), bool) if found.mask is None else found.mask
    inside = (np.abs(centres[:, 0] - 1.0) < 0.2) & (centres[:, 1] > 0.6) if points is NOTCHED else ~(centres < 2).all(1)
    assert hidden[inside].all()
    assert (inside.sum() > 0) == (points is NOTCHED)
    middle = (np.abs(centres - [0.4, 0.5]) < 0.3).all(axis=1)
    assert not hidden[middle].any()


def test_points_in_space_are_drawn_in_the_two_directions_in_which_they_extend_most():
    found = found_at(np.random.default_rng(1).random((60, 3)) * [1.0, 0.5, 2.0])
    figure = rendered(plots.plot_random_field(found))
    assert sum(isinstance(one, PathCollection) for ax in figure.axes for one in ax.collections) == 6
    assert {ax.get_xlabel() for ax in figure.axes} == {"", "x [mm]"}
    assert "z [mm]" in {ax.get_ylabel() for ax in figure.axes}


def test_figures_of_a_posterior_leave_out_coefficients():
    found = found_at(NOTCHED)
    draws = np.column_stack([np.random.default_rng(2).uniform(300, 500, 400), found.inputs])
    E_x = Parameter("E_x", E.prior, "Pa")
    both = PosteriorPlots(posterior_of(draws, E_x, *found.field.parameters))
    only = PosteriorPlots(posterior_of(found.inputs, *found.field.parameters))
    assert len(both.marginals().axes) == len(both.corner().axes) == 1
    assert plots.plot_parallel(both.posterior).get_xticks().tolist() == [0, 1]
    assert both.field("E").axes
    for draw, remedy in (
        (both.joint, "marginal"),
        (only.joint, "field"),
        (only.corner, "field"),
        (only.marginal, "field"),
    ):
        with pytest.raises(InvalidInput, match=rf"Draw \.plot\.{remedy}\(\) instead"):
            draw()
    with pytest.raises(InvalidInput, match="field of the posterior: got nu"):
        both.field("nu")
