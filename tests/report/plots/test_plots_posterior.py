"""Figures of the posterior: what the artists hold, not how they look."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch

from strandline.errors import InvalidInput
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import GaussianApproximation, Posterior, histogram, laplace
from strandline.priors import LogNormal, ScaledBeta, Uniform
from strandline.report.plots import (
    Curve,
    plot_hexagons,
    plot_joint,
    plot_marginal,
    plot_marginals,
    plot_pairs,
    plot_particles,
)
from strandline.report.plots.style import GREEN, ORANGE

INPUTS = (
    Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0)),
    Parameter("nu", Uniform(-0.8, 0.5)),
    Parameter("V", ScaledBeta(2.6, 1.4, 0.0, 110.0), "mm²/s"),
)


def ridge_posterior(dim: int, number: int = 400) -> Posterior:
    space = ParameterSpace(INPUTS[:dim])
    draws = space.prior_quantiles(np.random.default_rng(0).uniform(size=(number, dim)))
    centre = 400.0 - (150.0 * (draws[:, 1] - 0.3) if dim > 1 else 0.0)
    log_likelihood = -0.5 * ((draws[:, 0] - centre) / 60.0) ** 2
    log_weights = log_likelihood - np.logaddexp.reduce(log_likelihood)
    return Posterior(space, draws, log_weights, log_likelihood, space.log_prior(draws), -1.0)


TWO, THREE = ridge_posterior(2), ridge_posterior(3)
PRECISION = np.array([[1 / 60.0**2, 0.02], [0.02, 20.0]])


def render(figure) -> None:
    """Draw for real, so that a layout that collapses is a warning and thereby an error."""
    root = figure if isinstance(figure, Figure) else figure.get_figure(root=True)
    FigureCanvasAgg(root).draw()


def lines(ax, label: str) -> list[np.ndarray]:
    return [line.get_xydata() for line in ax.lines if line.get_label() == label]


def legend_texts(figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def hexagon_mass(ax) -> float:
    (hexagons,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
    return float(np.nansum(hexagons.get_array()))


def test_joint_has_labels_with_units_and_every_entry_in_the_legend():
    found = laplace(-PRECISION, TWO.map_estimate)
    figure = plot_joint(TWO, ("E", "nu"), laplace=found, truth={"E": 400.0, "nu": 0.3})
    render(figure)
    main = figure.axes[0]
    assert (main.get_xlabel(), main.get_ylabel()) == ("E [Pa]", "nu")
    assert set(legend_texts(figure)) == {
        "KDE 10, 50, 90 %",
        "Gaussian 10, 50, 90 %",
        "Laplace 10, 50, 90 %",
        "MAP",
        "mean",
        "ground truth",
        "prior",
    }
    assert main.get_xlim() == (100.0, 800.0)


def test_hexagons_sum_the_weights():
    ax = plot_hexagons(TWO, ("E", "nu"))
    assert hexagon_mass(ax) == pytest.approx(1.0, abs=0.01)
    (hexagons,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
    places, mass = np.asarray(hexagons.get_offsets()), np.ma.filled(hexagons.get_array(), 0.0)
    weighted = mass @ places
    assert (np.abs(weighted - TWO.mean) < [5.0, 0.02]).all()
    planted = TWO.draws.mean(axis=0)
    assert abs(planted[0] - weighted[0]) > 15, "hexagons that count particles must be caught"


def test_ellipses_lie_at_their_mahalanobis_radius():
    figure = plot_joint(TWO, ("E", "nu"), laplace=laplace(-PRECISION, TWO.map_estimate), percentiles=[0.5, 0.9])
    gaussian = GaussianApproximation(TWO.mean, TWO.covariance)
    radii = np.sqrt(-2 * np.log([0.5, 0.1]))
    curves = lines(figure.axes[0], "Gaussian")
    assert len(curves) == 2
    for curve, radius in zip(curves, radii, strict=True):
        np.testing.assert_allclose(gaussian.radius(curve), radius)
    around_mode = GaussianApproximation(TWO.map_estimate, np.linalg.inv(PRECISION))
    for curve, radius in zip(lines(figure.axes[0], "Laplace"), radii, strict=True):
        np.testing.assert_allclose(around_mode.radius(curve), radius)


def test_indefinite_laplace_is_noted_and_not_drawn():
    figure = plot_joint(TWO, ("E", "nu"), laplace=laplace(np.diag([-1.0, 1.0]), TWO.map_estimate))
    assert not lines(figure.axes[0], "Laplace")
    assert any("indefinite" in text for text in legend_texts(figure))


def test_points_are_the_estimates_in_their_colours():
    main = plot_joint(TWO, ("nu", "E")).axes[0]
    points = {line.get_label(): (line.get_xydata()[0], line.get_color()) for line in main.lines}
    np.testing.assert_allclose(points["mean"][0], TWO.mean[::-1])
    np.testing.assert_allclose(points["MAP"][0], TWO.map_estimate[::-1])
    assert (points["mean"][1], points["MAP"][1]) == (ORANGE, GREEN)


def test_two_of_three_inputs_mark_the_fullest_bin_and_take_the_marginal_of_laplace():
    hessian = -np.diag([1 / 3600.0, 20.0, 0.01])
    figure = plot_joint(THREE, ("V", "E"), laplace=laplace(hessian, THREE.map_estimate), percentiles=[0.5])
    render(figure)
    main = figure.axes[0]
    assert "MAP (fullest bin)" in legend_texts(figure)
    (curve,) = lines(main, "Laplace")
    assert np.ptp(curve[:, 1]) == pytest.approx(2 * 60 * np.sqrt(2 * np.log(2)), rel=1e-3)
    assert main.get_xlabel() == "V [mm²\u00a0s⁻¹]"


def test_given_mode_is_drawn():
    main = plot_joint(THREE, ("E", "nu"), mode=np.array([300.0, 0.1])).axes[0]
    np.testing.assert_allclose(lines(main, "MAP")[0], [[300.0, 0.1]])


def test_marginal_is_weighted_and_normalised():
    ax = plot_marginal(TWO, "E", bins=20, truth=400.0, overlay=Curve(np.array([100.0, 800.0]), np.array([1.0, 1.0])))
    render(ax.figure)
    (bars,) = [patch for patch in ax.patches if isinstance(patch, StepPatch)]
    heights, edges, _ = bars.get_data()
    assert heights @ np.diff(edges) == pytest.approx(1.0, abs=0.01)
    expected = histogram(TWO.draws[:, 0], TWO.weights, bounds=(100.0, 800.0), bins=20).density
    np.testing.assert_allclose(heights, expected)
    planted, _ = np.histogram(TWO.draws[:, 0], bins=edges, density=True)
    assert np.abs(planted - heights).max() > 0.1 * heights.max()
    estimate, prior = lines(ax, "KDE")[0], lines(ax, "prior")[0]
    assert np.trapezoid(estimate[:, 1], estimate[:, 0]) == pytest.approx(1.0, abs=2e-3)
    assert np.trapezoid(prior[:, 1], prior[:, 0]) == pytest.approx(1.0, abs=2e-3)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("E [Pa]", "density [Pa⁻¹]")
    assert [t.get_text() for t in ax.get_legend().get_texts()][-2:] == ["quadrature", "ground truth"]


def test_density_label_of_a_compound_unit():
    assert plot_marginal(THREE, "V").get_ylabel().replace("\u00a0", " ") == "density [mm⁻² s]"


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_marginals_and_pairs_of_any_number_of_inputs(dim):
    posterior = ridge_posterior(dim, 200)
    figure = plot_marginals(posterior, truth={"E": 400.0})
    render(figure)
    assert [ax.get_xlabel() for ax in figure.axes] == [p.figure_label() for p in posterior.space]
    pairs = plot_pairs(posterior, truth={"E": 400.0, "nu": 0.3})
    render(pairs)
    hexagons = [ax for ax in pairs.axes if any(isinstance(c, PolyCollection) for c in ax.collections)]
    drawn = [ax for ax in hexagons if ax.axison]
    assert len(drawn) == dim * (dim - 1) // 2
    for ax in drawn:
        assert hexagon_mass(ax) == pytest.approx(1.0, abs=0.01)


def test_more_marginals_than_a_row_holds():
    space = ParameterSpace(tuple(Parameter(f"x{k}", Uniform(0.0, 1.0)) for k in range(4)))
    draws, zeros = np.random.default_rng(0).uniform(size=(100, 4)), np.zeros(100)
    figure = plot_marginals(Posterior(space, draws, np.full(100, -np.log(100)), zeros, zeros, 0.0))
    render(figure)
    assert len(figure.axes) == 4


def test_input_without_spread_is_drawn_without_a_density():
    draws = np.stack([np.full(50, 300.0), np.linspace(-0.5, 0.4, 50)], axis=1)
    zeros = np.zeros(50)
    posterior = Posterior(ParameterSpace(INPUTS[:2]), draws, np.full(50, -np.log(50)), zeros, zeros, 0.0)
    ax = plot_marginal(posterior, "E")
    assert not lines(ax, "KDE")
    assert hexagon_mass(plot_hexagons(posterior, ("E", "nu"))) == pytest.approx(1.0, abs=0.01)


def test_particles_have_area_and_colour_by_weight():
    ax = plot_particles(TWO, ("E", "nu"), largest=30.0)
    render(ax.figure)
    (circles,) = [c for c in ax.collections if isinstance(c, PathCollection)]
    sizes, colours = circles.get_sizes(), circles.get_array()
    assert len(sizes) == TWO.number
    np.testing.assert_allclose(sizes / 30.0, colours / TWO.weights.max())
    assert sizes.max() == pytest.approx(30.0)
    np.testing.assert_allclose(colours.sum(), 1.0)
    np.testing.assert_allclose(circles.get_offsets()[-1], TWO.draws[np.argmax(TWO.weights)])


def test_unknown_input_is_refused():
    with pytest.raises(InvalidInput, match="rho"):
        plot_particles(TWO, ("E", "rho"))


def test_drawing_in_given_axes_and_sub_figures():
    figure = Figure(layout="constrained")
    left, right = figure.subfigures(1, 2)
    ax = right.add_subplot()
    assert plot_particles(TWO, ("E", "nu"), ax=ax) is ax
    assert plot_joint(TWO, ("E", "nu"), figure=left) is left
    render(figure)


def test_percentile_lines_of_thinned_particles_stay_in_place_and_hexagons_keep_all():
    posterior = ridge_posterior(2, 4000)
    boxes = []
    for number in (4000, 1000):
        ax = plot_hexagons(posterior, ("E", "nu"), percentiles=[0.5], particles=number)
        assert hexagon_mass(ax) == pytest.approx(1.0, abs=0.01)
        path = ax.collections[-1].get_paths()[0]
        boxes.append([path.vertices[:, 0].min(), path.vertices[:, 0].max()])
    np.testing.assert_allclose(boxes[0], boxes[1], atol=40.0)
