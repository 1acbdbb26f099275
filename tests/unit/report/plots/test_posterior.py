"""Figures of the posterior: what the artists hold, not how they look."""

from typing import Any

import numpy as np
import pytest
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from tests.unit.report.plots.drawn import entries, hexagon_mass, lines, rendered

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


@pytest.fixture(scope="module")
def joint() -> Any:
    found, truth = laplace(-PRECISION, TWO.map_estimate), {"E": 400.0, "nu": 0.3}
    return rendered(plot_joint(TWO, ("E", "nu"), laplace=found, truth=truth, percentiles=[0.5, 0.9]))


def test_the_joint_figure_has_labels_with_units_and_every_entry_in_the_legend(joint):
    main = joint.axes[0]
    assert (main.get_xlabel(), main.get_ylabel(), main.get_xlim()) == ("E [Pa]", "nu", (100.0, 800.0))
    kinds = [f"{kind} 50, 90 %" for kind in ("KDE", "Gaussian", "Laplace")]
    assert set(entries(joint)) == {*kinds, "MAP", "mean", "ground truth", "prior"}
    colours = {line.get_label(): line.get_color() for line in main.lines}
    np.testing.assert_allclose(lines(main, "mean")[0][0], TWO.mean)
    np.testing.assert_allclose(lines(main, "MAP")[0][0], TWO.map_estimate)
    assert (colours["mean"], colours["MAP"]) == (ORANGE, GREEN)


def test_ellipses_lie_at_their_mahalanobis_radius(joint):
    radii = np.sqrt(-2 * np.log([0.5, 0.1]))
    around_mean = GaussianApproximation(TWO.mean, TWO.covariance)
    around_mode = GaussianApproximation(TWO.map_estimate, np.linalg.inv(PRECISION))
    for label, gaussian in (("Gaussian", around_mean), ("Laplace", around_mode)):
        for curve, radius in zip(lines(joint.axes[0], label), radii, strict=True):
            np.testing.assert_allclose(gaussian.radius(curve), radius)


def test_two_of_three_inputs_mark_the_fullest_bin_and_take_the_marginal_of_laplace():
    hessian = -np.diag([1 / 3600.0, 20.0, 0.01])
    figure = plot_joint(THREE, ("V", "E"), laplace=laplace(hessian, THREE.map_estimate), percentiles=[0.5])
    main = figure.axes[0]
    assert "MAP (fullest bin)" in entries(figure)
    (curve,) = lines(main, "Laplace")
    assert np.ptp(curve[:, 1]) == pytest.approx(2 * 60 * np.sqrt(2 * np.log(2)), rel=1e-3)
    assert main.get_xlabel() == "V [mm²\u00a0s⁻¹]"


def test_an_indefinite_laplace_is_noted_and_not_drawn_and_a_given_mode_is():
    saddle = laplace(np.diag([-1.0, 1.0]), TWO.map_estimate)
    figure = plot_joint(TWO, ("nu", "E"), laplace=saddle, mode=np.array([0.1, 300.0]))
    main = figure.axes[0]
    assert not lines(main, "Laplace")
    assert any("indefinite" in text for text in entries(figure))
    np.testing.assert_allclose(lines(main, "MAP")[0], [[0.1, 300.0]])
    np.testing.assert_allclose(lines(main, "mean")[0][0], TWO.mean[::-1])


def test_hexagons_sum_the_weights_of_all_particles_and_thinned_percentile_lines_stay_in_place():
    posterior, boxes = ridge_posterior(2, 2000), []
    for number in (2000, 500):
        ax = plot_hexagons(posterior, ("E", "nu"), percentiles=[0.5], particles=number)
        assert hexagon_mass(ax) == pytest.approx(1.0, abs=0.01)
        vertices = ax.collections[-1].get_paths()[0].vertices
        boxes.append([vertices[:, 0].min(), vertices[:, 0].max()])
    np.testing.assert_allclose(boxes[0], boxes[1], atol=40.0)
    (hexagons,) = [c for c in plot_hexagons(TWO, ("E", "nu")).collections if isinstance(c, PolyCollection)]
    weighted = np.ma.filled(hexagons.get_array(), 0.0) @ np.asarray(hexagons.get_offsets())
    assert (np.abs(weighted - TWO.mean) < [5.0, 0.02]).all()
    assert abs(TWO.draws[:, 0].mean() - weighted[0]) > 15, "hexagons that count particles must be caught"


def test_a_marginal_is_weighted_and_normalised():
    ax = plot_marginal(TWO, "E", bins=20, truth=400.0, overlay=Curve(np.array([100.0, 800.0]), np.array([1.0, 1.0])))
    (bars,) = [patch for patch in ax.patches if isinstance(patch, StepPatch)]
    heights, edges, _ = bars.get_data()
    assert heights @ np.diff(edges) == pytest.approx(1.0, abs=0.01)
    expected = histogram(TWO.draws[:, 0], TWO.weights, bounds=(100.0, 800.0), bins=20).density
    np.testing.assert_allclose(heights, expected)
    planted, _ = np.histogram(TWO.draws[:, 0], bins=edges, density=True)
    assert np.abs(planted - heights).max() > 0.1 * heights.max()
    for label in ("KDE", "prior"):
        x, y = lines(ax, label)[0].T
        assert np.trapezoid(y, x) == pytest.approx(1.0, abs=2e-3)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("E [Pa]", "density [Pa⁻¹]")
    assert entries(ax)[-2:] == ["quadrature", "ground truth"]
    assert plot_marginal(THREE, "V").get_ylabel().replace("\u00a0", " ") == "density [mm⁻² s]"


@pytest.mark.parametrize("dim", [1, 3])
def test_marginals_and_pairs_of_any_number_of_inputs(dim):
    posterior = ridge_posterior(dim, 200)
    figure = rendered(plot_marginals(posterior, truth={"E": 400.0}))
    assert [ax.get_xlabel() for ax in figure.axes] == [p.figure_label() for p in posterior.space]
    pairs = rendered(plot_pairs(posterior, truth={"E": 400.0, "nu": 0.3}))
    drawn = [ax for ax in pairs.axes if ax.axison and any(isinstance(c, PolyCollection) for c in ax.collections)]
    assert len(drawn) == dim * (dim - 1) // 2
    for ax in drawn:
        assert hexagon_mass(ax) == pytest.approx(1.0, abs=0.01)


def test_an_input_without_spread_is_drawn_without_a_density():
    draws = np.stack([np.full(50, 300.0), np.linspace(-0.5, 0.4, 50)], axis=1)
    zeros = np.zeros(50)
    posterior = Posterior(ParameterSpace(INPUTS[:2]), draws, np.full(50, -np.log(50)), zeros, zeros, 0.0)
    assert not lines(plot_marginal(posterior, "E"), "KDE")
    assert hexagon_mass(plot_hexagons(posterior, ("E", "nu"))) == pytest.approx(1.0, abs=0.01)


def test_particles_have_area_and_colour_by_weight():
    figure = Figure(layout="constrained")
    left, right = figure.subfigures(1, 2)
    own = right.add_subplot()
    assert plot_joint(TWO, ("E", "nu"), figure=left) is left
    ax = plot_particles(TWO, ("E", "nu"), largest=30.0, ax=own)
    assert ax is own
    rendered(figure)
    (circles,) = [c for c in ax.collections if isinstance(c, PathCollection)]
    sizes, colours = circles.get_sizes(), circles.get_array()
    assert len(sizes) == TWO.number
    np.testing.assert_allclose(sizes / 30.0, colours / TWO.weights.max())
    assert sizes.max() == pytest.approx(30.0)
    np.testing.assert_allclose(colours.sum(), 1.0)
    np.testing.assert_allclose(circles.get_offsets()[-1], TWO.draws[np.argmax(TWO.weights)])
    with pytest.raises(InvalidInput, match="rho"):
        plot_particles(TWO, ("E", "rho"))
