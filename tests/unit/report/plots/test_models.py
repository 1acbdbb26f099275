"""Figures of interfaces, flow, fields and diagnostics: what the artists hold."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection, QuadMesh, TriMesh
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from tests.unit.report.plots.drawn import NU, E, entries, points, rendered

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.report.plots import (
    FieldGrid,
    OffsetBand,
    plot_check,
    plot_conditions,
    plot_convergence,
    plot_field,
    plot_flow,
    plot_interfaces,
    plot_leave_one_out,
    plot_profile,
    plot_tempering,
    three_measures,
)
from strandline.report.plots.style import GREEN, root_scale, root_ticks

LINE = Interface.polyline(np.array([[0.0, 0.0], [0.3, 0.4], [0.9, 0.4], [1.0, 0.0]]))


def ridge_field(**more: Any) -> FieldGrid:
    x, y = np.linspace(100, 800, 41), np.linspace(-0.8, 0.5, 31)
    values = -0.5 * ((x[:, None] - 400 + 150 * (y[None] - 0.3)) / 20.0) ** 2 - 7.0
    return FieldGrid(E, NU, x, y, values, **more)


def mesh_of(ax: Any) -> Any:
    (mesh,) = [c for c in ax.collections if isinstance(c, QuadMesh)]
    return mesh


def test_interfaces_in_millimetres_at_equal_scales():
    ax = plot_interfaces(LINE, reference=LINE, simulated={"E = 200 Pa": LINE, "E = 800 Pa": LINE})
    rendered(ax.figure)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [mm]", "y [mm]")
    assert ax.get_aspect() == 1.0
    drawn = {line.get_label(): line for line in ax.lines}
    assert list(drawn) == ["undeformed", "observed", "E = 200 Pa", "E = 800 Pa"]
    assert drawn["observed"].get_color() == GREEN
    np.testing.assert_array_equal(drawn["observed"].get_xydata(), LINE.points)
    assert len({(line.get_color(), line.get_linestyle()) for line in drawn.values()}) == 4
    loop = plot_interfaces(Interface.polyline(LINE.points, closed=True)).lines[0].get_xydata()
    np.testing.assert_array_equal(loop[0], loop[-1])
    with pytest.raises(InvalidInput, match="plane"):
        plot_interfaces(Interface(np.eye(3), np.array([[0, 1, 2]])))


def test_a_flat_interface_is_stretched_and_the_axis_says_so():
    x = np.linspace(0.0, 1.0, 20)
    for height, stretch in ((0.02, 15), (0.1, 3), (0.4, 1)):
        ax = plot_interfaces(Interface.polyline(np.column_stack([x, height * x * (2 - x)])))
        assert ax.get_aspect() == stretch
        assert ax.get_ylabel() == ("y [mm]" if stretch == 1 else f"y [mm], {stretch} × stretched")
        box = ax.get_tightbbox()
        assert box.height > 0.2 * box.width


def test_conditions_have_a_panel_each_and_one_legend():
    seen = {"slow": LINE, "fast": Interface.polyline(LINE.points * [1.0, 2.0])}
    simulated = {name: {"E = 200 Pa": line, "E = 800 Pa": line} for name, line in seen.items()}
    figure = rendered(plot_conditions(seen, reference=LINE, simulated=simulated))
    assert [ax.get_title() for ax in figure.axes] == ["slow", "fast"]
    assert [ax.get_legend() is not None for ax in figure.axes] == [False, True]
    for ax, line in zip(figure.axes, seen.values(), strict=True):
        drawn = {artist.get_label(): artist.get_xydata() for artist in ax.lines}
        assert list(drawn) == ["undeformed", "observed", "E = 200 Pa", "E = 800 Pa"]
        np.testing.assert_array_equal(drawn["observed"], line.points)
        np.testing.assert_array_equal(drawn["E = 800 Pa"], line.points)
        assert ax.get_aspect() == 1.0


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


def test_flow_draws_magnitudes_on_the_deformed_mesh_and_outlines_the_interface():
    figure = rendered(plot_flow(channel(), title="E = 1"))
    panels = figure.axes[:3]
    assert panels[0].get_title() == "E = 1"
    limits = [next(c for c in ax.collections if isinstance(c, TriMesh)).get_clim() for ax in panels]
    assert limits[0][1] == pytest.approx(5.0)
    assert limits[1] == pytest.approx((0.0, 2.0))
    assert limits[2] == pytest.approx((0.0, 0.05 * 0.4)), "fluid nodes must not stretch the solid's colours"
    labels = [ax.get_ylabel() for ax in figure.axes[3:]]
    assert labels == ["velocity magnitude [mm/s]", "pressure [Pa]", "displacement magnitude [mm]"]
    assert all(ax.get_aspect() == 1.0 for ax in panels)
    lines = [c for c in panels[0].collections if isinstance(c, LineCollection)]
    assert not lines[1].get_segments(), "one part has no inner line"
    rest, outline = (np.asarray(lines[k].get_segments()) for k in (0, 2))
    np.testing.assert_allclose(outline - rest, [0.05, 0] * rest[..., [1]], atol=1e-15)
    middle = rest.mean(axis=1)
    on_side = np.isclose(np.abs(middle[:, 0] - 1.0), 0.3) & (middle[:, 1] < 0.4)
    on_top = np.isclose(middle[:, 1], 0.4) & (np.abs(middle[:, 0] - 1.0) < 0.3)
    assert (on_side | on_top).all()
    assert np.linalg.norm(rest[:, 1] - rest[:, 0], axis=1).sum() == pytest.approx(0.4 + 0.6 + 0.4)


def test_flow_divides_the_parts_and_needs_no_solid():
    fields = channel()
    right = fields.points[fields.triangles].mean(axis=1)[:, 0] > 1.0
    fields.cell_part = fields.cell_part + (fields.cell_part > 0) * right
    _, inner, _ = [c for c in plot_flow(fields).axes[0].collections if isinstance(c, LineCollection)]
    assert len(inner.get_segments()) > 2
    fields.cell_part = np.zeros(len(fields.triangles), int)
    rendered(plot_flow(fields))


def test_the_likelihood_is_normalised_and_marks_every_run():
    failed = np.random.default_rng(0).uniform([100, -0.8], [150, 0.5], (17, 2))
    training = np.random.default_rng(1).uniform([150, -0.8], [800, 0.5], (30, 2))
    ax = plot_field(ridge_field(failed=failed, training=training, truth=np.array([400.0, 0.3])), kind="likelihood")
    rendered(ax.figure)
    colours = np.asarray(mesh_of(ax).get_array())
    assert colours.max() == 1.0
    assert colours.min() >= 0.0
    assert [points(ax, label) for label in ("failed run", "training point", "ground truth")] == [17, 30, 1]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("E [Pa]", "ν")


def test_a_log_likelihood_is_linear_in_standard_deviations_and_not_transposed():
    field = ridge_field()
    np.testing.assert_array_equal(
        np.reshape(mesh_of(plot_field(field, kind="sd")).get_array(), (31, 41)), field.values.T
    )
    norm = mesh_of(plot_field(field)).norm
    shades = norm(field.values.max() - 0.5 * np.arange(4.0) ** 2)
    np.testing.assert_allclose(np.diff(shades), np.diff(shades)[0])
    assert shades[0] == pytest.approx(1.0)
    assert mesh_of(plot_field(field, floor=-50.0)).norm.vmin == -50.0
    forward, inverse = root_scale(3.0)
    values = np.array([-1000.0, -1.0, 3.0, 4.0])
    np.testing.assert_allclose(inverse(forward(values)), values)
    places, labels = root_ticks(-1300.0, 3.004)
    assert labels[0] == "3"
    assert all(-1300.0 <= place <= 3.004 for place in places)
    assert [float(label) for label in labels[1:]] == places[1:]
    assert np.all(np.diff(places) < 0)


@pytest.mark.parametrize(("kind", "bars"), [("likelihood", 1), ("log_likelihood", 3), ("sd", 3)])
def test_three_measures_side_by_side_and_constant_ones(kind, bars):
    flat = FieldGrid(E, NU, np.array([100.0, 800.0]), np.array([-0.8, 0.5]), np.zeros((2, 2)))
    ridge = ridge_field(failed=np.array([[110.0, 0.0], [120.0, 0.2]]))
    fields = {"Euclidean": ridge, "closest point": replace(flat, failed=ridge.failed), "RKHS norm": ridge}
    figure = rendered(three_measures(fields, kind=kind))
    panels = figure.axes[:1] + [ax for ax in figure.axes[1:] if ax.get_title()]
    assert [ax.get_title() for ax in panels] == ["(a) Euclidean", "(b) closest point", "(c) RKHS norm"]
    assert len(figure.axes) == 3 + bars
    assert sum(points(ax, "failed run") for ax in panels) == 6
    assert entries(figure) == ["failed run"]


def test_a_narrow_likelihood_is_shown_enlarged_on_one_scale_away_from_the_peak():
    grid, near = np.linspace(0.0, 1.0, 31), (np.linspace(0.8, 0.9, 11), np.linspace(0.1, 0.2, 11))

    def part(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return -0.5 * (((x[:, None] - 0.85) / 0.02) ** 2 + ((y[None] - 0.15) / 0.02) ** 2)

    detail = FieldGrid(E, NU, *near, part(*near), truth=np.array([0.85, 0.15]))
    whole = FieldGrid(E, NU, grid, grid, part(grid, grid) - 3.0, detail=detail)
    ax = plot_field(whole, kind="likelihood")
    rendered(ax.figure)
    (inset,) = ax.child_axes
    main, enlarged = (np.asarray(mesh_of(one).get_array()) for one in (ax, inset))
    assert enlarged.max() == pytest.approx(1.0)
    assert main.max() == pytest.approx(np.exp(whole.values.max()))
    assert "ground truth" in ax.get_legend_handles_labels()[1]
    frame = inset.get_window_extent().transformed(ax.transData.inverted())
    assert not (frame.x0 < 0.85 < frame.x1 and frame.y0 < 0.15 < frame.y1)
    crossing = [one for one in ax.figure.findobj() if type(one).__name__ == "ConnectionPatch" and one.get_visible()]
    assert not crossing
    assert not plot_field(whole, kind="log_likelihood").child_axes


def test_the_profile_of_a_single_input():
    x = np.linspace(100, 800, 21)
    failed = np.array([110.0, 120.0])
    ax = plot_profile(E, x, -(((x - 400) / 100) ** 2), sd=np.full(21, 0.2), failed=failed, truth=400.0)
    rendered(ax.figure)
    assert points(ax, "failed run") == 2
    assert ax.get_xlabel() == "E [Pa]"


def test_tempering_shows_every_step():
    figure = rendered(plot_tempering([0.1, 0.4, 1.0], [90.0, 80.0, 70.0], [0.3, 0.25, 0.2], particles=100))
    gamma, ess, acceptance = figure.axes
    np.testing.assert_array_equal(gamma.lines[0].get_xydata(), [[1, 0.1], [2, 0.4], [3, 1.0]])
    assert ess.lines[1].get_ydata()[0] == 50
    assert acceptance.get_ylim() == (0, 1)
    assert acceptance.get_xlabel() == "tempering step"


@pytest.mark.parametrize("spread_top", [False, True])
def test_leave_one_out_reports_the_error_near_the_mode(spread_top):
    value = np.array([-100.0, -50.0, -1.0, 0.0])
    prediction = value + np.array([3.0, 3.0, 0.5, -0.5])
    near = np.array([False, False, True, True])
    ax = plot_leave_one_out(value, prediction, sd=np.ones(4), near_mode=near, spread_top=spread_top)
    rendered(ax.figure)
    assert entries(ax) == ["agreement", "training point, rms error 3", "near the mode, rms error 0.5"]
    assert ax.get_xlim() == ax.get_ylim()
    if not spread_top:
        bare = plot_leave_one_out(np.zeros(3), np.zeros(3))
        assert bare.get_ylabel() == "leave-one-out prediction of\nlog-likelihood"
        assert len(entries(bare)) == 2
        other = plot_leave_one_out(np.zeros(3), np.zeros(3), left_out="leave-a-tenth-out")
        assert "tenth" in other.get_ylabel()


def test_a_check_shows_agreement_failures_and_the_band_in_micrometres():
    ends = np.array([0.0, 1.0])
    seen = np.array([0.0, 0.5, 1.0]), np.array([0.0, 1e-3, 4e-3])
    light = OffsetBand(ends, np.array([-1e-3, -2e-3]), np.zeros(2), np.array([3e-3, 2e-3]), *seen)
    true, surrogate = np.array([-1.0, -np.inf, -3.0, np.nan]), np.array([-1.5, -0.5, -2.0, -2.5])
    figure = rendered(plot_check(true, surrogate, {"light": light, "heavy": None}))
    left, band, empty = figure.axes
    lines = {line.get_label(): line.get_xydata() for line in left.get_lines()}
    np.testing.assert_array_equal(lines["draw of the posterior"], [[-1.5, -1.0], [-2.0, -3.0]])
    np.testing.assert_array_equal(lines["failed runs: 2"][:, 0], [-0.5, -2.5])
    assert (lines["failed runs: 2"][:, 1] == left.get_ylim()[0]).all()
    np.testing.assert_array_equal(lines["agreement"][:, 0], lines["agreement"][:, 1])
    assert left.get_xlim() == left.get_ylim()
    (area,) = band.collections
    heights = area.get_paths()[0].vertices[:, 1]
    np.testing.assert_allclose([heights.min(), heights.max()], [-2.0, 3.0])
    observed = next(line for line in band.get_lines() if line.get_label() == "observed")
    np.testing.assert_allclose(observed.get_xydata(), [[0, 0], [0.5, 1], [1, 4]])
    assert observed.get_color() == GREEN
    assert [ax.get_title() for ax in (band, empty)] == ["light", "heavy"]
    assert "no band" in empty.texts[0].get_text()


def test_convergence_is_drawn_logarithmically_with_a_line_for_each_case():
    sizes, errors = [100, 200, 500], {"centre": [0.9, 0.5, 0.3], "refined": [0.5, 0.2, 0.1]}
    own = Figure().add_subplot()
    ax = plot_convergence(sizes, errors, quantity="error", ax=own)
    assert ax is own
    assert (ax.get_xscale(), ax.get_yscale(), ax.get_ylabel()) == ("log", "log", "error")
    assert {line.get_label(): line.get_ydata().tolist() for line in ax.get_lines()} == errors
    assert all(line.get_xdata().tolist() == sizes for line in ax.get_lines())
    assert len({(line.get_color(), line.get_linestyle()) for line in ax.get_lines()}) == 2
    assert [label.get_text() for label in ax.get_xticklabels()] == ["100", "200", "500"]
    assert entries(ax) == ["centre", "refined"]
