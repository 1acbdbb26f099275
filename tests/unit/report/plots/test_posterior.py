"""Figures of the posterior: what the artists hold, not how they look."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.patches import StepPatch
from matplotlib.path import Path as Outline
from tests.unit.report.plots.drawn import NU, E, entries, hexagon_mass, lines, posterior_of, rendered

from strandline.foundations import InvalidInput
from strandline.parameters import LogNormal, Parameter, ParameterSpace, ScaledBeta, Uniform
from strandline.posterior import GaussianApproximation, Histogram, Posterior, histogram, laplace
from strandline.report import plots
from strandline.report.plots.joint import axis_limits
from strandline.report.plots.pairs import DENSITY, PosteriorPlots, _order

INPUTS = (
    Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0)),
    Parameter("nu", Uniform(-0.8, 0.5)),
    Parameter("V", ScaledBeta(2.6, 1.4, 0.0, 110.0), "mm²/s"),
    *(Parameter(name, Uniform(0.0, 10.0)) for name in ("E2", "E3", "nu2", "V_in")),
)


def ridge_posterior(dim: int, number: int = 400, *, weightless: int = 0) -> Posterior:
    """Return a posterior of the first inputs, whose first particles have no weight."""
    space = ParameterSpace(INPUTS[:dim])
    draws = space.prior_quantiles(np.random.default_rng(0).uniform(size=(number, dim)))
    centre = 400.0 - (150.0 * (draws[:, 1] - 0.3) if dim > 1 else 0.0)
    log_likelihood = -0.5 * ((draws[:, 0] - centre) / 60.0) ** 2
    log_weights = np.where(np.arange(number) < weightless, -np.inf, log_likelihood)
    log_weights -= np.logaddexp.reduce(log_weights)
    return Posterior(space, draws, log_weights, log_likelihood, space.log_prior(draws), -1.0)


TWO, THREE, SEVEN = ridge_posterior(2), ridge_posterior(3), ridge_posterior(7, 300, weightless=7)
NAMES = SEVEN.space.names
PRECISION = np.array([[1 / 60.0**2, 0.02], [0.02, 20.0]])


def test_the_joint_figure_has_units_every_entry_in_the_legend_and_ellipses_at_their_mahalanobis_radius():
    found, truth = laplace(-PRECISION, TWO.map_estimate), {"E": 400.0, "nu": 0.3}
    joint = rendered(plots.plot_joint(TWO, ("E", "nu"), laplace=found, truth=truth, percentiles=[0.5, 0.9]))
    main = joint.axes[0]
    assert (main.get_xlabel(), main.get_ylabel(), main.get_xlim()) == ("E [Pa]", "nu", (100.0, 800.0))
    kinds = [f"{kind} 50, 90 %" for kind in ("KDE", "Gaussian", "Laplace")]
    assert set(entries(joint)) == {*kinds, "MAP", "mean", "ground truth", "prior"}
    np.testing.assert_allclose(lines(main, "mean")[0][0], TWO.mean)
    np.testing.assert_allclose(lines(main, "MAP")[0][0], TWO.map_estimate)
    around_mean = GaussianApproximation(TWO.mean, TWO.covariance)
    around_mode = GaussianApproximation(TWO.map_estimate, np.linalg.inv(PRECISION))
    for label, gaussian in (("Gaussian", around_mean), ("Laplace", around_mode)):
        for curve, radius in zip(lines(main, label), np.sqrt(-2 * np.log([0.5, 0.1])), strict=True):
            np.testing.assert_allclose(gaussian.radius(curve), radius)


def test_two_of_three_inputs_mark_the_fullest_bin_and_take_the_marginal_of_laplace():
    found = laplace(-np.diag([1 / 3600.0, 20.0, 0.01]), THREE.map_estimate)
    figure = plots.plot_joint(THREE, ("V", "E"), laplace=found, percentiles=[0.5])
    assert "MAP (fullest bin)" in entries(figure)
    (curve,) = lines(figure.axes[0], "Laplace")
    assert np.ptp(curve[:, 1]) == pytest.approx(2 * 60 * np.sqrt(2 * np.log(2)), rel=1e-3)
    assert figure.axes[0].get_xlabel() == "V [mm²\u00a0s⁻¹]"


def test_an_indefinite_laplace_is_noted_and_not_drawn():
    saddle = laplace(np.diag([-1.0, 1.0]), TWO.map_estimate)
    figure = plots.plot_joint(TWO, ("nu", "E"), laplace=saddle)
    assert not lines(figure.axes[0], "Laplace")
    assert any("indefinite" in text for text in entries(figure))
    np.testing.assert_allclose(lines(figure.axes[0], "MAP")[0][0], TWO.map_estimate[::-1])
    np.testing.assert_allclose(lines(figure.axes[0], "mean")[0][0], TWO.mean[::-1])


def test_hexagons_sum_the_weights_of_all_particles():
    ax = plots.plot_hexagons(TWO, ("E", "nu"))
    assert hexagon_mass(ax) == pytest.approx(1.0, abs=0.01)
    (hexagons,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
    weighted = np.ma.filled(hexagons.get_array(), 0.0) @ np.asarray(hexagons.get_offsets())
    assert (np.abs(weighted - TWO.mean) < [5.0, 0.02]).all()
    assert abs(TWO.draws[:, 0].mean() - weighted[0]) > 15, "hexagons that count particles must be caught"


def test_a_marginal_is_weighted_and_normalised():
    exact = Histogram(np.array([100.0, 800.0]), np.array([1.0]))
    ax = plots.plot_marginal(TWO, "E", bins=20, truth=400.0, exact=exact)
    np.testing.assert_allclose(lines(ax, "quadrature")[0], [[450.0, 1 / 700]])
    (bars,) = [patch for patch in ax.patches if isinstance(patch, StepPatch)]
    heights, _, _ = bars.get_data()
    expected = histogram(TWO.draws[:, 0], TWO.weights, bounds=(100.0, 800.0), bins=20).density
    np.testing.assert_allclose(heights, expected)
    for label in ("KDE", "prior"):
        x, y = lines(ax, label)[0].T
        assert np.trapezoid(y, x) == pytest.approx(1.0, abs=2e-3)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("E [Pa]", "density [Pa⁻¹]")
    assert entries(ax)[-2:] == ["quadrature", "ground truth"]
    assert plots.plot_marginal(THREE, "V").get_ylabel().replace("\u00a0", " ") == "density [mm⁻² s]"


def test_an_input_without_spread_is_drawn_without_a_density():
    posterior = posterior_of(np.stack([np.full(50, 300.0), np.linspace(-0.5, 0.4, 50)], axis=1), *INPUTS[:2])
    assert not lines(plots.plot_marginal(posterior, "E"), "KDE")
    assert hexagon_mass(plots.plot_hexagons(posterior, ("E", "nu"))) == pytest.approx(1.0, abs=0.01)


def test_particles_have_area_and_colour_by_weight():
    ax = plots.plot_particles(TWO, ("E", "nu"), largest=30.0)
    (circles,) = [c for c in ax.collections if isinstance(c, PathCollection)]
    sizes, colours = circles.get_sizes(), circles.get_array()
    np.testing.assert_allclose(sizes / 30.0, colours / TWO.weights.max())
    assert (len(sizes), sizes.max(), colours.sum()) == pytest.approx((TWO.number, 30.0, 1.0))
    np.testing.assert_allclose(circles.get_offsets()[-1], TWO.draws[np.argmax(TWO.weights)])
    with pytest.raises(InvalidInput, match="rho"):
        plots.plot_particles(TWO, ("E", "rho"))


@pytest.mark.parametrize(
    ("ends", "shown"),
    [
        ((390.0, 410.0), (383.0, 417.0)),
        ((150.0, 780.0), (100.0, 800.0)),
        ((780.0, 800.0), (773.0, 800.0)),
        ((300.0, 300.0), (100.0, 800.0)),
    ],
)
def test_the_view_is_of_the_posterior_without_light_stragglers_and_ends_at_the_box(ends, shown):
    draws = np.concatenate([np.linspace(*ends, 500), np.linspace(100.0, 800.0, 50)])
    posterior = posterior_of(draws[:, None], E, weights=np.repeat([1.0, 1e-6], [500, 50]))
    assert axis_limits(posterior, "E") == pytest.approx(shown, abs=1.0)


DRAWS = np.random.default_rng(3).multivariate_normal([400.0, 0.1], [[400.0, 1.2], [1.2, 0.01]], 4000)
CLOUD = posterior_of(DRAWS, E, NU)


def test_regions_of_a_corner_plot_hold_their_probabilities_and_all_is_in_the_legend():
    figure = plots.plot_corner(CLOUD, truth={"E": 400.0})
    outlines = figure.axes[1].collections[-1]
    held = [np.mean(Outline.contains_points(path, DRAWS)) for path in outlines.get_paths()]
    np.testing.assert_allclose(held, (0.95, 0.68), atol=0.04, err_msg="the largest region first")
    assert entries(figure) == ["particles", "KDE", "prior", "ground truth", "68 %", "95 %"]
    assert entries(plots.plot_corner(posterior_of(DRAWS[:, :1], E))) == ["particles", "KDE", "prior"]


def test_a_truth_of_another_input_is_refused():
    for draw in (PosteriorPlots(CLOUD).corner, PosteriorPlots(CLOUD).marginals):
        with pytest.raises(InvalidInput, match="got young; expected one of E, nu"):
            draw(truth={"E": 400.0, "young": 400.0})


def test_a_notebook_shows_figures_and_axes():
    own = PosteriorPlots(CLOUD)
    for drawing in (own.joint(), own.marginal()):
        assert drawing._repr_png_().startswith(b"\x89PNG")


def test_parallel_axes_hold_every_particle_of_weight_from_low_to_high_density():
    ax = plots.plot_parallel(SEVEN, truth={"E2": 5.0})
    rendered(ax.figure)
    (drawn,) = [c for c in ax.collections if isinstance(c, LineCollection)]
    density = np.asarray(drawn.get_array())
    assert len(drawn.get_segments()) == len(density) == 293
    np.testing.assert_allclose(density, np.sort(SEVEN.log_density[7:]))
    heights = np.asarray(drawn.get_segments()[-1])[:, 1]
    np.testing.assert_allclose(heights, [*SEVEN.space.to_unit(SEVEN.draws[SEVEN.map_index]), 1.0])
    np.testing.assert_allclose(lines(ax, "ground truth"), [[[3.0, 0.5]]])
    ticks = {text.get_text(): text.get_position()[1] for text in ax.texts if text.get_position()[0] < 0}
    assert len(ticks) >= 4
    for label, height in ticks.items():
        assert (float(label) - 100.0) / 700.0 == pytest.approx(height)
    flow = Parameter("flow", Uniform(0.0, 10.0), nuisance=True)
    assert _order(posterior_of(SEVEN.draws[:, :3], flow, *INPUTS[:2])) == ("E", "nu", DENSITY, "flow")


def test_a_corner_has_a_panel_for_each_pair_and_marks_the_truth_of_the_inputs_that_have_one():
    panels = rendered(plots.plot_corner(SEVEN, NAMES[:3], truth={"E": 500.0, "nu": 0.2})).axes
    assert [ax.get_ylabel().split()[0] for ax in panels if ax.get_ylabel()] == ["nu", "V"]
    dotted = [sum(line.get_linestyle() == ":" for line in ax.lines) for ax in panels]
    assert dotted == [1, 2, 1, 1, 1, 0], "E; nu over E, nu; V over E, V over nu, V"
    assert [ax.get_xlabel().split()[0] for ax in rendered(plots.plot_marginals(SEVEN)).axes] == list(NAMES)
