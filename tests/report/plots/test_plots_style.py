"""What publishers and readers ask of every figure."""

import io

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Offsets, Posterior
from strandline.priors import Uniform
from strandline.report.plots import (
    FieldGrid,
    OffsetBand,
    mark_doubt,
    plot_failed_runs,
    plot_field,
    plot_marginals,
    plot_offsets,
    plot_run_offsets,
    plot_tempering,
    three_measures,
)
from strandline.report.plots.style import DOUBLE, SINGLE, styled

E, NU = Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", Uniform(-0.8, 0.5), symbol="ν")


def posterior() -> Posterior:
    space = ParameterSpace((E,))
    draws = np.random.default_rng(0).normal(400.0, 30.0, (200, 1))
    weights = np.full(200, -np.log(200.0))
    return Posterior(space, draws, weights, np.zeros(200), space.log_prior(draws), 0.0)


def drawn(figure: object) -> Figure:
    assert isinstance(figure, Figure)
    FigureCanvasAgg(figure).draw()
    return figure


def test_fonts_are_embedded_as_truetype() -> None:
    figure, stream = drawn(plot_tempering([0.1, 1.0], [90.0, 80.0], [0.4, 0.3])), io.BytesIO()
    with styled():
        figure.savefig(stream, format="pdf")
    assert b"/Type3" not in stream.getvalue()
    assert b"/TrueType" in stream.getvalue() or b"/CIDFontType2" in stream.getvalue()


def test_figures_are_as_wide_as_columns_and_their_text_is_legible() -> None:
    one = drawn(plot_marginals(posterior()))
    assert one.get_figwidth() == pytest.approx(SINGLE)
    assert pytest.approx(88) == 25.4 * SINGLE
    assert pytest.approx(180) == 25.4 * DOUBLE
    sizes = [text.get_fontsize() for text in one.findobj(lambda a: hasattr(a, "get_fontsize")) if text.get_text()]
    assert min(sizes) >= 7.0


def test_the_legend_of_a_single_input_is_not_clipped() -> None:
    figure = drawn(plot_marginals(posterior(), truth={"E": 400.0}))
    (legend,) = figure.legends
    extent = legend.get_window_extent()
    assert extent.x0 >= 0.0
    assert extent.x1 <= figure.bbox.width


def test_a_doubt_stands_in_the_figure_and_within_it() -> None:
    figure = plot_marginals(posterior())
    assert isinstance(figure, Figure)
    mark_doubt(figure, "not converged, all 50 runs that were allowed are made and much else besides")
    drawn(figure)
    title = figure.get_suptitle()
    assert title.startswith("DO NOT TRUST THIS POSTERIOR: not converged")
    (text,) = [one for one in figure.texts if one.get_text() == title]
    extent = text.get_window_extent()
    assert extent.x0 >= 0.0
    assert extent.x1 <= figure.bbox.width
    assert extent.y0 >= max(ax.get_window_extent().y1 for ax in figure.axes)


def test_offsets_from_the_median_pass_through_zero() -> None:
    s = np.linspace(0.0, 1.0, 5)
    band = OffsetBand(s, 0.001 * s, 0.003 * s, 0.006 * s, np.array([0.0, 1.0]), np.array([0.0, 0.004]))
    ax = plot_offsets(band)
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    np.testing.assert_allclose(lines["draws, median"], 0.0)
    np.testing.assert_allclose(lines["observed"], [0.0, 1.0])


def test_an_enlarged_part_stands_away_from_the_peak_and_no_line_crosses_it() -> None:
    grid = np.linspace(0.0, 1.0, 31)

    def part(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return -0.5 * (((x[:, None] - 0.85) / 0.02) ** 2 + ((y[None] - 0.15) / 0.02) ** 2)

    unit = [Parameter(name, Uniform(0.0, 1.0)) for name in "ab"]
    near = np.linspace(0.8, 0.9, 11), np.linspace(0.1, 0.2, 11)
    detail = FieldGrid(unit[0], unit[1], *near, part(*near))
    ax = plot_field(FieldGrid(unit[0], unit[1], grid, grid, part(grid, grid), detail=detail), kind="likelihood")
    drawn(ax.figure)
    (inset,) = ax.child_axes
    frame = inset.get_window_extent().transformed(ax.transAxes.inverted())
    assert not (frame.x0 < 0.85 < frame.x1 and frame.y0 < 0.15 < frame.y1)
    assert not [
        patch for patch in ax.figure.findobj() if type(patch).__name__ == "ConnectionPatch" and patch.get_visible()
    ]
    assert isinstance(three_measures({"a": FieldGrid(unit[0], unit[1], grid, grid, part(grid, grid))}), Figure)


def test_failed_runs_of_three_inputs_are_marked_by_kind() -> None:
    space = ParameterSpace((E, NU, Parameter("V_in", Uniform(0.0, 110.0), "mm^2/s")))
    rng = np.random.default_rng(0)
    ok, bad = space.to_physical(rng.random((9, 3))), space.to_physical(rng.random((4, 3)))
    ax = plot_failed_runs(space, ok, {"limit_point": bad[:3], "timeout": bad[3:]})
    drawn(ax.figure)
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["ok: 9", "limit_point: 3", "timeout: 1"]
    found = [collection.get_segments() for collection in ax.collections]
    assert [len(lines) for lines in found] == [9, 3, 1]
    np.testing.assert_allclose(np.array(found[1])[:, :, 1], space.to_unit(bad[:3]))
    assert [label.get_text() for label in ax.get_xticklabels()][1] == "ν"


def test_offsets_of_runs_are_in_micrometres_about_the_best_run() -> None:
    s = np.linspace(0.0, 1.0, 3)
    ax = plot_run_offsets(Offsets(s, 0.001 * s), {"second best run": Offsets(s, -0.002 * s)})
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    np.testing.assert_allclose(lines["observed"], [0.0, 0.5, 1.0])
    np.testing.assert_allclose(lines["second best run"], [0.0, -1.0, -2.0])
    assert set(lines["best run"]) == {0.0}
