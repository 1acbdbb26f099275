"""Figures of interfaces, flow, fields, diagnostics and answers: what the artists hold, in columns of journals."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection, QuadMesh, TriMesh
from matplotlib.tri import Triangulation
from tests.unit.report.plots.drawn import NU, E, entries, lines, posterior_of, rendered

from strandline.foundations import InvalidInput
from strandline.interface import Interface
from strandline.posterior import Offsets, SobolIndices
from strandline.posterior.rank_tests import uniformity
from strandline.report import plots
from strandline.report.plots import FieldGrid, OffsetBand
from strandline.report.plots.style import BLUE, DOUBLE, RED, SINGLE, root_scale, root_ticks

LINE = Interface.polyline(np.array([[0.0, 0.0], [0.3, 0.4], [0.9, 0.4], [1.0, 0.0]]))
LABELS = ["undeformed", "observed", "E = 200 Pa", "E = 800 Pa"]


def ridge_field(width: float = 20.0, **more: Any) -> FieldGrid:
    x, y = np.linspace(100, 800, 41), np.linspace(-0.8, 0.5, 31)
    values = -0.5 * ((x[:, None] - 400 + 150 * (y[None] - 0.3)) / width) ** 2 - 7.0
    return FieldGrid(E, NU, x, y, values, **more)


def mesh_of(ax: Any) -> Any:
    (mesh,) = [c for c in ax.collections if isinstance(c, QuadMesh)]
    return mesh


def points(ax: Any, label: str) -> int:
    return sum(map(len, lines(ax, label)))


def test_interfaces_in_millimetres_at_equal_scales_with_a_panel_for_each_condition():
    seen = {"slow": LINE, "fast": Interface.polyline(LINE.points * [1.0, 2.0])}
    simulated = {name: dict.fromkeys(LABELS[2:], line) for name, line in seen.items()}
    figure = rendered(plots.plot_conditions(seen, reference=LINE, simulated=simulated))
    assert [ax.get_legend() is not None for ax in figure.axes] == [False, True]
    for ax, line in zip(figure.axes, seen.values(), strict=True):
        drawn = {artist.get_label(): artist for artist in ax.lines}
        assert list(drawn) == LABELS
        for label in ("observed", "E = 800 Pa"):
            np.testing.assert_array_equal(drawn[label].get_xydata(), line.points)
        assert len({(one.get_color(), one.get_linestyle()) for one in drawn.values()}) == 4
        assert ax.get_aspect() == 1.0
    loop = plots.plot_interfaces(Interface.polyline(LINE.points, closed=True)).lines[0].get_xydata()
    np.testing.assert_array_equal(loop[0], loop[-1])
    with pytest.raises(InvalidInput, match="plane"):
        plots.plot_interfaces(Interface(np.eye(3), np.array([[0, 1, 2]])))


def test_a_flat_interface_is_stretched_and_the_axis_says_so():
    x = np.linspace(0.0, 1.0, 20)
    for height, stretch, label in ((0.02, 15, "y [mm], 15 × stretched"), (0.4, 1, "y [mm]")):
        ax = plots.plot_interfaces(Interface.polyline(np.column_stack([x, height * x * (2 - x)])))
        assert (ax.get_aspect(), ax.get_ylabel()) == (stretch, label)


def channel() -> SimpleNamespace:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 2, 21), np.linspace(0, 1, 11)))
    triangles = Triangulation(x, y).triangles.astype(int)
    centre = np.stack([x, y], axis=1)[triangles].mean(axis=1)
    solid = (np.abs(centre[:, 0] - 1.0) < 0.3) & (centre[:, 1] < 0.4)
    return SimpleNamespace(
        points=np.stack([x + 0.05 * y, y], axis=1),
        triangles=triangles,
        cell_part=solid.astype(int),
        velocity=np.stack([3 * y, 4 * y], axis=1),
        pressure=2.0 - x,
        displacement=np.stack([0.05 * y, 0 * y], axis=1),
    )


def test_flow_draws_magnitudes_on_the_deformed_mesh_and_outlines_the_interface_if_there_is_a_solid():
    fields = channel()
    figure = rendered(plots.plot_flow(fields, title="E = 1"))
    panels = figure.axes[:3]
    limits = [next(c for c in ax.collections if isinstance(c, TriMesh)).get_clim() for ax in panels]
    assert limits[0][1] == pytest.approx(5.0)
    assert limits[1] == pytest.approx((0.0, 2.0))
    assert limits[2] == pytest.approx((0.0, 0.05 * 0.4)), "fluid nodes must not stretch the solid's colours"
    labels = [ax.get_ylabel() for ax in figure.axes[3:]]
    assert labels == ["velocity magnitude [mm/s]", "pressure [Pa]", "displacement magnitude [mm]"]
    drawn = [c for c in panels[0].collections if isinstance(c, LineCollection)]
    assert not drawn[1].get_segments(), "one part has no inner line"
    rest, outline = (np.asarray(drawn[k].get_segments()) for k in (0, 2))
    np.testing.assert_allclose(outline - rest, [0.05, 0] * rest[..., [1]], atol=1e-15)
    assert np.linalg.norm(rest[:, 1] - rest[:, 0], axis=1).sum() == pytest.approx(0.4 + 0.6 + 0.4)
    fields.cell_part = np.zeros(len(fields.triangles), int)
    rendered(plots.plot_flow(fields))


def test_the_likelihood_is_normalised_and_marks_every_failed_run():
    random = np.random.default_rng(0)
    failed = random.uniform([100, -0.8], [800, 0.5], (17, 2))
    field = ridge_field(failed=failed, truth=np.array([400.0, 0.3]))
    ax = plots.plot_field(field, kind="likelihood")
    colours = np.asarray(mesh_of(ax).get_array())
    assert 0.0 <= colours.min() < colours.max() == 1.0
    assert [points(ax, label) for label in ("failed run", "ground truth")] == [17, 1]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("E [Pa]", "ν")
    narrow = np.asarray(mesh_of(plots.plot_field(ridge_field(6.0), kind="likelihood")).get_array())
    assert narrow.max(axis=1).min() > 0.9, "a ridge narrower than a cell has no gaps"


def test_a_log_likelihood_is_linear_in_standard_deviations_and_not_transposed():
    field = ridge_field()
    drawn = mesh_of(plots.plot_field(field, kind="sd")).get_array()
    np.testing.assert_array_equal(np.reshape(drawn, (31, 41)), field.values.T)
    norm = mesh_of(plots.plot_field(field)).norm
    shades = norm(field.values.max() - 0.5 * np.arange(4.0) ** 2)
    np.testing.assert_allclose(np.diff(shades), np.diff(shades)[0])
    assert shades[0] == pytest.approx(1.0)
    forward, inverse = root_scale(3.0)
    values = np.array([-1000.0, -1.0, 3.0, 4.0])
    np.testing.assert_allclose(inverse(forward(values)), values)
    places, labels = root_ticks(-1300.0, 3.004)
    assert -1300.0 <= min(places) < max(places) <= 3.004
    assert labels[1].startswith("−")
    assert [float(label.replace("−", "-")) for label in labels[1:]] == sorted(places[1:], reverse=True) == places[1:]


@pytest.mark.parametrize("at", [(0.85, 0.15), (0.15, 0.55), (0.5, 0.5), (0.55, 0.85)])
def test_a_narrow_likelihood_is_shown_enlarged_on_one_scale_away_from_the_peak(at):
    def part(*shares: np.ndarray, peak: float, **more: Any) -> FieldGrid:
        u, v = np.meshgrid(*shares, indexing="ij")
        values = peak - 0.5 * (((u - at[0]) / 0.02) ** 2 + ((v - at[1]) / 0.02) ** 2)
        return FieldGrid(E, NU, 100 + 700 * shares[0], -0.8 + 1.3 * shares[1], values, **more)

    near = [np.linspace(one - 0.05, one + 0.05, 11) for one in at]
    detail = part(*near, peak=0.0, truth=np.array([100 + 700 * at[0], -0.8 + 1.3 * at[1]]))
    whole = part(*[np.linspace(0.0, 1.0, 21)] * 2, peak=-3.0, detail=detail)
    ax = plots.plot_field(whole, kind="likelihood")
    rendered(ax.figure)
    (inset,) = ax.child_axes
    main, enlarged = (np.asarray(mesh_of(one).get_array()) for one in (ax, inset))
    assert (main.max(), enlarged.max()) == pytest.approx((np.exp(-3.0), 1.0)), "peaks, also between points"
    frame = inset.get_window_extent().transformed(ax.transAxes.inverted())
    shown = (frame.x0 > at[0] + 0.05, frame.x1 < at[0] - 0.05, frame.y0 > at[1] + 0.05, frame.y1 < at[1] - 0.05)
    assert any(shown), "clear of the enlarged part"
    assert not plots.plot_field(whole, kind="log_likelihood").child_axes
    assert not plots.plot_field(replace(whole, detail=whole), kind="likelihood").child_axes, "no room"


def test_leave_one_out_reports_the_error_near_the_mode():
    value, near = np.array([-100.0, -50.0, -1.0, 0.0]), np.array([False, False, True, True])
    prediction = value + np.array([3.0, 3.0, 0.5, -0.5])
    ax = plots.plot_leave_one_out(value, prediction, sd=np.ones(4), near_mode=near)
    rendered(ax.figure)
    assert entries(ax) == ["agreement", "other runs, rms error 3", "runs near the mode, rms error 0.5"]


def test_a_check_shows_agreement_failures_and_the_band_in_micrometres():
    ends = np.array([0.0, 1.0])
    seen = np.array([0.0, 0.5, 1.0]), np.array([0.0, 1e-3, 4e-3])
    light = OffsetBand(ends, np.array([-1e-3, -2e-3]), np.zeros(2), np.array([3e-3, 2e-3]), *seen)
    true, surrogate = np.array([-1.0, -np.inf, -3.0, np.nan]), np.array([-1.5, -0.5, -2.0, -2.5])
    left, band, empty = rendered(plots.plot_check(true, surrogate, {"light": light, "heavy": None})).axes
    drawn = {line.get_label(): line.get_xydata() for line in left.get_lines()}
    np.testing.assert_array_equal(drawn["draw of the posterior"], [[-1.5, -1.0], [-2.0, -3.0]])
    np.testing.assert_array_equal(drawn["failed runs: 2"][:, 0], [-0.5, -2.5])
    assert (drawn["failed runs: 2"][:, 1] == left.get_ylim()[0]).all()
    (area,) = band.collections
    heights = area.get_paths()[0].vertices[:, 1]
    np.testing.assert_allclose([heights.min(), heights.max()], [-2.0, 3.0])
    np.testing.assert_allclose(lines(band, "observed"), [[[0, 0], [0.5, 1], [1, 4]]])
    assert [ax.get_title() for ax in (band, empty)] == ["light", "heavy"]
    assert "no band" in empty.texts[0].get_text()


def test_predictions_have_a_row_for_each_condition_and_a_column_for_each_model() -> None:
    s, flat = np.linspace(0.0, 1.0, 6), np.full(6, 0.001)
    one = {name: OffsetBand(s, -flat, 0 * flat, flat, s, np.full(6, float(k))) for k, name in enumerate("ab")}
    bands = {(condition, name): one[name] for name in "ab" for condition in ("slow", "fast")}
    figure = plots.plot_predictions(bands)
    assert [ax.get_title() for ax in figure.axes] == ["a, slow", "b, slow", "a, fast", "b, fast"]
    observed = [float(ax.lines[-1].get_ydata()[0]) for ax in figure.axes]
    assert observed == [0.0, 1e3, 0.0, 1e3], "in micrometres"


def test_a_histogram_does_not_end_at_the_frame() -> None:
    histogram = {"edges": [50.0, 60.0, 70.0], "averaged": [0.05, 0.05], "models": {"a": [0.1, 0.0], "b": [0.0, 0.1]}}
    (ax,) = plots.plot_averaged({"E": {"label": "E", "unit": "Pa", "histogram": histogram}}).axes
    low, high = ax.get_xlim()
    assert low < 50.0 < 70.0 < high
    assert ax.get_xlabel() == "E [Pa]"


def test_ranks_that_leave_the_band_stand_out() -> None:
    even = (np.arange(50) + 0.5) / 50
    right, wrong = uniformity(even), uniformity(even**2)
    figure = rendered(plots.plot_rank_bands({f"E_{k}": wrong if k == 1 else right for k in range(7)}))
    for ax, band, colour in zip(figure.axes[:2], (right, wrong), (BLUE, RED), strict=True):
        (line,) = [one for one in ax.lines if len(one.get_xdata()) == 49]
        assert line.get_color() == colour
        np.testing.assert_allclose(line.get_ydata(), band.found - band.places)


def test_other_assumptions_that_move_an_input_stand_out_and_fixed_ones_have_no_mark() -> None:
    present = {"E": {"mean": 1.0, "low": 0.5, "high": 1.5}, "nu": {"mean": 0.0, "low": -0.1, "high": 0.1}}
    moved = {"mean": 1.4, "low": 0.9, "high": 1.9, "moves": True}
    some = [("noise", [moved, None]), ("prior", [{"mean": 1.1, "low": 0.6, "high": 1.6, "moves": False}, None])]
    left, right = rendered(plots.plot_alternatives(present, some)).axes
    prior, noise = left.containers
    assert [one.lines[0].get_color() for one in (noise, prior)] == [RED, BLUE]
    (segment,) = noise.lines[2][0].get_segments()
    np.testing.assert_allclose(segment[:, 0], [0.9, 1.9])
    np.testing.assert_allclose(noise.lines[0].get_xdata(), [1.4])
    assert not right.containers
    assert [label.get_text() for label in left.get_yticklabels()] == ["noise", "prior"]


def test_bars_are_the_sensitivity_indices_from_the_top_down() -> None:
    first, total = np.array([0.2, -0.01, 0.5]), np.array([0.3, 0.02, 0.7])
    indices = SobolIndices(first, first - 0.05, first + 0.04, total, total - 0.1, total + 0.1, 10)
    ax = plots.plot_sensitivity(indices, ("E", "nu", "V"))
    drawn = [[bar.get_width() for bar in container] for container in ax.containers if hasattr(container, "patches")]
    np.testing.assert_allclose(drawn, [first, total])
    assert [text.get_text() for text in ax.get_yticklabels()] == ["E", "nu", "V"]
    assert ax.yaxis_inverted()


def test_figures_are_as_wide_as_columns_their_text_is_legible_and_a_doubt_stands_within_them() -> None:
    figure = plots.plot_marginals(posterior_of(np.random.default_rng(0).normal(400.0, 30.0, (200, 1)), E))
    plots.mark_doubt(figure, "not converged, all 50 runs that were allowed are made and much else besides")
    rendered(figure)
    assert figure.get_figwidth() == pytest.approx(SINGLE)
    assert pytest.approx((88, 180)) == (25.4 * SINGLE, 25.4 * DOUBLE)
    sizes = [text.get_fontsize() for text in figure.findobj(lambda a: hasattr(a, "get_fontsize")) if text.get_text()]
    assert min(sizes) >= 7.0
    title = figure.get_suptitle()
    assert title.startswith("DO NOT TRUST THIS POSTERIOR: not converged")
    (text,) = [one for one in figure.texts if one.get_text() == title]
    for one in (text, *figure.legends):
        extent = one.get_window_extent()
        assert 0.0 <= extent.x0 < extent.x1 <= figure.bbox.width


def test_offsets_of_runs_are_in_micrometres_about_the_best_run() -> None:
    s = np.linspace(0.0, 1.0, 5)
    ax = plots.plot_run_offsets(Offsets(s, 0.001 * s), {"second best run": Offsets(s, -0.002 * s)})
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    np.testing.assert_allclose(lines["observed"], s)
    np.testing.assert_allclose(lines["second best run"], -2 * s)
    assert set(lines["best run"]) == {0.0}
