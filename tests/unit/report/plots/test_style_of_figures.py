"""What publishers and readers ask of every figure, and the figures of runs and offsets."""

import io

import numpy as np
import pytest
from tests.unit.report.plots.drawn import NU, E, entries, rendered

from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Offsets, Posterior
from strandline.priors import Uniform
from strandline.report.plots import (
    OffsetBand,
    mark_doubt,
    plot_failed_runs,
    plot_marginals,
    plot_offsets,
    plot_run_offsets,
    plot_tempering,
)
from strandline.report.plots.style import DOUBLE, SINGLE, styled


def test_fonts_are_embedded_as_truetype() -> None:
    figure, stream = plot_tempering([0.1, 1.0], [90.0, 80.0], [0.4, 0.3]), io.BytesIO()
    with styled():
        figure.savefig(stream, format="pdf")
    assert b"/Type3" not in stream.getvalue()
    assert b"/TrueType" in stream.getvalue() or b"/CIDFontType2" in stream.getvalue()


def test_figures_are_as_wide_as_columns_their_text_is_legible_and_a_doubt_stands_within_them() -> None:
    space = ParameterSpace((E,))
    draws = np.random.default_rng(0).normal(400.0, 30.0, (200, 1))
    posterior = Posterior(space, draws, np.full(200, -np.log(200.0)), np.zeros(200), space.log_prior(draws), 0.0)
    figure = plot_marginals(posterior, truth={"E": 400.0})
    mark_doubt(figure, "not converged, all 50 runs that were allowed are made and much else besides")
    rendered(figure)
    assert figure.get_figwidth() == pytest.approx(SINGLE)
    assert pytest.approx((88, 180)) == (25.4 * SINGLE, 25.4 * DOUBLE)
    sizes = [text.get_fontsize() for text in figure.findobj(lambda a: hasattr(a, "get_fontsize")) if text.get_text()]
    assert min(sizes) >= 7.0
    title = figure.get_suptitle()
    assert title.startswith("DO NOT TRUST THIS POSTERIOR: not converged")
    (text,) = [one for one in figure.texts if one.get_text() == title]
    (legend,) = figure.legends
    for one in (text, legend):
        extent = one.get_window_extent()
        assert 0.0 <= extent.x0 < extent.x1 <= figure.bbox.width
    assert text.get_window_extent().y0 >= max(ax.get_window_extent().y1 for ax in figure.axes)


def test_offsets_are_in_micrometres_about_the_median_or_the_best_run() -> None:
    s = np.linspace(0.0, 1.0, 5)
    band = OffsetBand(s, 0.001 * s, 0.003 * s, 0.006 * s, np.array([0.0, 1.0]), np.array([0.0, 0.004]))
    lines = {line.get_label(): line.get_ydata() for line in plot_offsets(band).lines}
    np.testing.assert_allclose(lines["draws, median"], 0.0)
    np.testing.assert_allclose(lines["observed"], [0.0, 1.0])
    ax = plot_run_offsets(Offsets(s, 0.001 * s), {"second best run": Offsets(s, -0.002 * s)})
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    np.testing.assert_allclose(lines["observed"], s)
    np.testing.assert_allclose(lines["second best run"], -2 * s)
    assert set(lines["best run"]) == {0.0}


def test_failed_runs_of_three_inputs_are_marked_by_kind() -> None:
    space = ParameterSpace((E, NU, Parameter("V_in", Uniform(0.0, 110.0), "mm^2/s")))
    rng = np.random.default_rng(0)
    ok, bad = space.to_physical(rng.random((9, 3))), space.to_physical(rng.random((4, 3)))
    ax = plot_failed_runs(space, ok, {"limit_point": bad[:3], "timeout": bad[3:]})
    rendered(ax.figure)
    assert entries(ax) == ["ok: 9", "limit_point: 3", "timeout: 1"]
    found = [collection.get_segments() for collection in ax.collections]
    assert [len(lines) for lines in found] == [9, 3, 1]
    np.testing.assert_allclose(np.array(found[1])[:, :, 1], space.to_unit(bad[:3]))
    assert [label.get_text() for label in ax.get_xticklabels()][1] == "ν"
