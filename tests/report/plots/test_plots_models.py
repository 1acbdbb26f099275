"""Figures of interfaces, flow, fields and diagnostics: what the artists hold."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, QuadMesh, TriMesh
from matplotlib.tri import Triangulation

import strandline.report.plots
from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.parameters import Parameter
from strandline.priors import Uniform
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

E, NU = Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", Uniform(-0.8, 0.5))
LINE = Interface.polyline(np.array([[0.0, 0.0], [0.3, 0.4], [0.9, 0.4], [1.0, 0.0]]))


def render(figure) -> None:
    FigureCanvasAgg(figure).draw()


def ridge_field(**more) -> FieldGrid:
    x, y = np.linspace(100, 800, 41), np.linspace(-0.8, 0.5, 31)
    values = -0.5 * ((x[:, None] - 400 + 150 * (y[None] - 0.3)) / 20.0) ** 2 - 7.0
    return FieldGrid(E, NU, x, y, values, **more)


def coloured(ax) -> np.ndarray:
    (mesh,) = [c for c in ax.collections if isinstance(c, QuadMesh)]
    return np.asarray(mesh.get_array())


def number_of_points(ax, label: str) -> int:
    return sum(len(line.get_xydata()) for line in ax.lines if line.get_label() == label)


def test_interfaces_in_millimetres_at_equal_scales():
    ax = plot_interfaces(LINE, reference=LINE, simulated={"E = 200 Pa": LINE, "E = 800 Pa": LINE})
    render(ax.figure)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [mm]", "y [mm]")
    assert ax.get_aspect() == 1.0
    drawn = {line.get_label(): line for line in ax.lines}
    assert list(drawn) == ["undeformed", "observed", "E = 200 Pa", "E = 800 Pa"]
    assert drawn["observed"].get_color() == GREEN
    np.testing.assert_array_equal(drawn["observed"].get_xydata(), LINE.points)
    styles = [(line.get_color(), line.get_linestyle()) for line in drawn.values()]
    assert len(set(styles)) == 4


def test_conditions_have_a_panel_each_and_one_legend():
    seen = {"slow": LINE, "fast": Interface.polyline(LINE.points * [1.0, 2.0])}
    simulated = {name: {"E = 200 Pa": line, "E = 800 Pa": line} for name, line in seen.items()}
    figure = plot_conditions(seen, reference=LINE, simulated=simulated)
    render(figure)
    assert [ax.get_title() for ax in figure.axes] == ["slow", "fast"]
    assert [ax.get_legend() is not None for ax in figure.axes] == [False, True]
    for ax, line in zip(figure.axes, seen.values(), strict=True):
        drawn = {artist.get_label(): artist.get_xydata() for artist in ax.lines}
        assert list(drawn) == ["undeformed", "observed", "E = 200 Pa", "E = 800 Pa"]
        np.testing.assert_array_equal(drawn["observed"], line.points)
        np.testing.assert_array_equal(drawn["E = 800 Pa"], line.points)
        assert ax.get_aspect() == 1.0


def test_closed_interface_returns_to_its_start():
    loop = Interface.polyline(LINE.points, closed=True)
    drawn = plot_interfaces(loop).lines[0].get_xydata()
    np.testing.assert_array_equal(drawn[0], drawn[-1])


def test_surfaces_in_space_are_refused():
    surface = Interface(np.eye(3), np.array([[0, 1, 2]]))
    with pytest.raises(InvalidInput, match="plane"):
        plot_interfaces(surface)


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


def test_flow_draws_magnitudes_on_the_deformed_mesh():
    fields = channel()
    figure = plot_flow(fields)
    render(figure)
    panels = figure.axes[:3]
    meshes = [next(c for c in ax.collections if isinstance(c, TriMesh)) for ax in panels]
    assert meshes[0].get_clim()[1] == pytest.approx(5.0)
    assert meshes[1].get_clim() == pytest.approx((0.0, 2.0))
    assert meshes[2].get_clim() == pytest.approx((0.0, 0.05 * 0.4)), "fluid nodes must not stretch the solid's colours"
    labels = [ax.get_ylabel() for ax in figure.axes[3:]]
    assert labels == ["velocity magnitude [mm/s]", "pressure [Pa]", "displacement magnitude [mm]"]
    assert all(ax.get_aspect() == 1.0 for ax in panels)


def test_flow_outlines_the_interface():
    fields = channel()
    rest, inner, outline = [c for c in plot_flow(fields).axes[0].collections if isinstance(c, LineCollection)]
    assert not inner.get_segments()
    moved = np.asarray(outline.get_segments()) - np.asarray(rest.get_segments())
    np.testing.assert_allclose(moved, [0.05, 0] * np.asarray(rest.get_segments())[..., [1]], atol=1e-15)
    undeformed = np.asarray(outline.get_segments()) - [0.05, 0] * np.asarray(outline.get_segments())[..., [1]]
    middle = undeformed.mean(axis=1)
    on_side = np.isclose(np.abs(middle[:, 0] - 1.0), 0.3) & (middle[:, 1] < 0.4)
    on_top = np.isclose(middle[:, 1], 0.4) & (np.abs(middle[:, 0] - 1.0) < 0.3)
    assert (on_side | on_top).all()
    assert np.linalg.norm(undeformed[:, 1] - undeformed[:, 0], axis=1).sum() == pytest.approx(0.4 + 0.6 + 0.4)


def test_flow_divides_the_parts_and_has_a_title():
    fields = channel()
    right = fields.points[fields.triangles].mean(axis=1)[:, 0] > 1.0
    fields.cell_part = fields.cell_part + (fields.cell_part > 0) * right
    ax = plot_flow(fields, title="E = 1").axes[0]
    _, inner, _ = [c for c in ax.collections if isinstance(c, LineCollection)]
    assert len(inner.get_segments()) > 2
    assert ax.get_title() == "E = 1"


def test_flow_without_a_solid_does_not_crash():
    fields = channel()
    fields.cell_part = np.zeros(len(fields.triangles), int)
    render(plot_flow(fields))


def test_likelihood_is_normalised_and_marks_every_failed_run():
    failed = np.random.default_rng(0).uniform([100, -0.8], [150, 0.5], (17, 2))
    training = np.random.default_rng(1).uniform([150, -0.8], [800, 0.5], (30, 2))
    ax = plot_field(ridge_field(failed=failed, training=training, truth=np.array([400.0, 0.3])), kind="likelihood")
    render(ax.figure)
    assert coloured(ax).max() == 1.0
    assert coloured(ax).min() >= 0.0
    assert number_of_points(ax, "failed run") == 17
    assert number_of_points(ax, "training point") == 30
    assert number_of_points(ax, "ground truth") == 1
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("E [Pa]", "nu")


def test_values_are_not_transposed():
    field = ridge_field()
    values = coloured(plot_field(field, kind="sd")).reshape(31, 41)
    np.testing.assert_array_equal(values, field.values.T)


def test_log_likelihood_scale_is_linear_in_standard_deviations():
    field = ridge_field()
    ax = plot_field(field)
    (mesh,) = [c for c in ax.collections if isinstance(c, QuadMesh)]
    z = np.array([0.0, 1.0, 2.0, 3.0])
    shades = mesh.norm(-7.0 + (field.values.max() + 7.0) - 0.5 * z**2)
    np.testing.assert_allclose(np.diff(shades), np.diff(shades)[0])
    assert shades[0] == pytest.approx(1.0)


def test_floor_cuts_the_colours():
    (mesh,) = [c for c in plot_field(ridge_field(), floor=-50.0).collections if isinstance(c, QuadMesh)]
    assert mesh.norm.vmin == -50.0


@pytest.mark.parametrize("kind", ["likelihood", "log_likelihood", "sd"])
def test_constant_fields_do_not_crash(kind):
    field = FieldGrid(E, NU, np.array([100.0, 800.0]), np.array([-0.8, 0.5]), np.zeros((2, 2)))
    render(plot_field(field, kind=kind).figure)


@pytest.mark.parametrize(("kind", "bars"), [("likelihood", 1), ("log_likelihood", 3), ("sd", 3)])
def test_three_measures_side_by_side(kind, bars):
    failed = np.array([[110.0, 0.0], [120.0, 0.2]])
    fields = {name: ridge_field(failed=failed) for name in ("Euclidean", "closest point", "RKHS norm")}
    figure = three_measures(fields, kind=kind)
    render(figure)
    panels = figure.axes[:1] + [ax for ax in figure.axes[1:] if ax.get_title()]
    assert [ax.get_title() for ax in panels] == ["(a) Euclidean", "(b) closest point", "(c) RKHS norm"]
    assert len(figure.axes) == 3 + bars
    assert sum(number_of_points(ax, "failed run") for ax in panels) == 6
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["failed run"]


def test_profile_of_a_single_input():
    x = np.linspace(100, 800, 21)
    ax = plot_profile(
        E, x, -(((x - 400) / 100) ** 2), sd=np.full(21, 0.2), failed=np.array([110.0, 120.0]), truth=400.0
    )
    render(ax.figure)
    assert number_of_points(ax, "failed run") == 2
    assert ax.get_xlabel() == "E [Pa]"


def test_root_scale_is_inverted_and_its_ticks_are_inside():
    forward, inverse = root_scale(3.0)
    values = np.array([-1000.0, -1.0, 3.0, 4.0])
    np.testing.assert_allclose(inverse(forward(values)), values)
    places, labels = root_ticks(-1300.0, 3.004)
    assert labels[0] == "3"
    assert all(-1300.0 <= place <= 3.004 for place in places)
    assert [float(label) for label in labels[1:]] == places[1:]
    assert np.all(np.diff(places) < 0)


def test_tempering_shows_every_step():
    figure = plot_tempering([0.1, 0.4, 1.0], [90.0, 80.0, 70.0], [0.3, 0.25, 0.2], particles=100)
    render(figure)
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
    render(ax.figure)
    texts = [t.get_text() for t in ax.get_legend().get_texts()]
    assert texts == ["agreement", "training point, rms error 3", "near the mode, rms error 0.5"]
    assert ax.get_xlim() == ax.get_ylim()


def test_leave_one_out_without_options():
    ax = plot_leave_one_out(np.zeros(3), np.zeros(3))
    render(ax.figure)
    assert ax.get_ylabel() == "leave-one-out prediction of\nlog-likelihood"
    assert "tenth" in plot_leave_one_out(np.zeros(3), np.zeros(3), left_out="leave-a-tenth-out").get_ylabel()
    assert len(ax.get_legend().get_texts()) == 2


def test_public_names_exist():
    for name in strandline.report.plots.__all__:
        assert getattr(strandline.report.plots, name) is not None


BAND = OffsetBand(
    np.array([0.0, 1.0]),
    np.array([-1e-3, -2e-3]),
    np.zeros(2),
    np.array([3e-3, 2e-3]),
    np.array([0.0, 0.5, 1.0]),
    np.array([0.0, 1e-3, 4e-3]),
)


def test_check_shows_agreement_failures_and_the_band_in_micrometres():
    true, surrogate = np.array([-1.0, -np.inf, -3.0, np.nan]), np.array([-1.5, -0.5, -2.0, -2.5])
    figure = plot_check(true, surrogate, {"light": BAND, "heavy": None})
    left, band, empty = figure.axes
    render(figure)
    lines = {line.get_label(): line.get_xydata() for line in left.get_lines()}
    np.testing.assert_array_equal(lines["draw of the posterior"], [[-1.5, -1.0], [-2.0, -3.0]])
    np.testing.assert_array_equal(lines["failed runs: 2"][:, 0], [-0.5, -2.5])
    assert (lines["failed runs: 2"][:, 1] == left.get_ylim()[0]).all()
    np.testing.assert_array_equal(lines["agreement"][:, 0], lines["agreement"][:, 1])
    assert left.get_xlim() == left.get_ylim()
    (area,) = band.collections
    np.testing.assert_allclose(sorted(area.get_paths()[0].vertices[:, 1])[0], -2.0)
    np.testing.assert_allclose(area.get_paths()[0].vertices[:, 1].max(), 3.0)
    observed = next(line for line in band.get_lines() if line.get_label() == "observed")
    np.testing.assert_allclose(observed.get_xydata(), [[0, 0], [0.5, 1], [1, 4]])
    assert observed.get_color() == GREEN
    assert [ax.get_title() for ax in (band, empty)] == ["light", "heavy"]
    assert "no band" in empty.texts[0].get_text()


def test_convergence_is_drawn_logarithmically_with_a_line_for_each_case():
    sizes, errors = [100, 200, 500], {"centre": [0.9, 0.5, 0.3], "refined": [0.5, 0.2, 0.1]}
    ax = plot_convergence(sizes, errors)
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert {line.get_label(): line.get_ydata().tolist() for line in ax.get_lines()} == errors
    assert all(line.get_xdata().tolist() == sizes for line in ax.get_lines())
    assert len({(line.get_color(), line.get_linestyle()) for line in ax.get_lines()}) == 2
    assert [label.get_text() for label in ax.get_xticklabels()] == ["100", "200", "500"]
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["centre", "refined"]
    render(ax.figure)


def test_convergence_goes_into_given_axes():
    ax = empty_axes()
    assert plot_convergence(np.array([10, 20]), {"a": np.array([1.0, 0.1])}, quantity="error", ax=ax) is ax
    assert ax.get_ylabel() == "error"


def empty_axes():
    return strandline.report.plots.style.new_figure((3.0, 2.0)).add_subplot()
