"""Posteriors by quadrature from a table, against the closed form integrated on a plain midpoint grid."""

from functools import cache

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm
from verification.reproduction.grid_posterior import (
    GridPosterior,
    compare,
    posterior_on_grid,
    product_grid,
    total_variation,
)
from verification.reproduction.log_likelihood_field import log_likelihood_field
from verification.reproduction.truth import true_fields, true_posterior

from strandline.errors import InvalidInput, NumericsError
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import LogNormal, ScaledBeta, Uniform

TRUTH = (400.0, 0.3, 100.0)
VARIANCE = 1e-5
YOUNG, POISSON = Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", Uniform(-0.8, 0.5))
KNOWN = ParameterSpace((YOUNG, POISSON))
INFORMED = ParameterSpace(
    (Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0)), Parameter("nu", ScaledBeta(3.0, 2.0, -0.8, 0.5)))
)
UNCERTAIN = ParameterSpace((YOUNG, POISSON, Parameter("V_in", ScaledBeta(2.6, 1.4, 0.0, 110.0), "mm^2/s")))
NODES = (49, 25, 13)


def heights(simulated, observed):
    """A measure with a closed form: the squared differences of the heights of the nodes."""
    return float(np.sum((simulated.points[:, 1] - observed.points[:, 1]) ** 2))


def likelihood_at(model, *inputs):
    x = np.linspace(0, 1, model.nodes)
    observed = Interface.polyline(np.stack([x, model.bulge(*inputs) * np.sin(np.pi * x)], axis=1))
    return InterfaceLikelihood((Observation(observed, VARIANCE),), heights)


@pytest.fixture(scope="module")
def likelihood(model):
    return likelihood_at(model, *TRUTH)


@pytest.fixture(scope="module")
def known(table, likelihood):
    return true_fields(table, likelihood, nodes=NODES, rate=100.0)


@pytest.fixture(scope="module")
def uncertain(table, likelihood):
    return log_likelihood_field(table, likelihood, nodes=NODES)


def closed_form(model, e, nu, rate):
    """log L, with the model's own fold in place of the table's end."""
    sines = np.sum(np.sin(np.pi * np.linspace(0, 1, model.nodes)) ** 2)
    value = -0.5 * sines * (model.bulge(e, nu, rate) - model.bulge(*TRUTH)) ** 2 / VARIANCE
    return np.where(np.isnan(value), -np.inf, value)


@cache
def by_hand(model, space, reading, rate=None, numbers=(700, 130, 40)):
    """Mean, sd and log evidence by midpoints; V in equal shares of its prior."""
    e, nu = (
        low + (high - low) * (np.arange(n) + 0.5) / n
        for (low, high), n in zip((YOUNG.interval, POISSON.interval), numbers[:2], strict=True)
    )
    E, NU = np.meshgrid(e, nu, indexing="ij")
    prior = np.exp(space["E"].truncated_prior.log_density(E) + space["nu"].truncated_prior.log_density(NU))
    cell = (e[1] - e[0]) * (nu[1] - nu[0])
    shares = (np.arange(numbers[2]) + 0.5) / numbers[2]
    rates = [rate] if rate is not None else space["V_in"].prior.quantile(shares).tolist()
    density, log_evidences = np.zeros_like(E), []
    for v in rates:
        value = closed_form(model, E, NU, v)
        piece = prior * np.exp(value - value.max())
        log_evidences.append(value.max() + np.log(piece.sum() * cell))
        density += piece / (piece.sum() * cell) if reading == "cut" else piece * np.exp(value.max())
    mass = density / density.sum()
    mean = np.array([np.sum(mass * E), np.sum(mass * NU)])
    sd = np.sqrt([np.sum(mass * (E - mean[0]) ** 2), np.sum(mass * (NU - mean[1]) ** 2)])
    return mean, sd, float(logsumexp(log_evidences) - np.log(len(rates)))


def agree(posterior, reference, tolerance):
    mean, sd, log_evidence = reference
    return bool(
        (np.abs(posterior.mean - mean) < tolerance * sd).all()
        and (np.abs(posterior.sd / sd - 1) < tolerance).all()
        and abs(posterior.log_evidence - log_evidence) < tolerance
    )


@pytest.mark.parametrize("space", [KNOWN, INFORMED])
def test_posterior_at_a_known_rate_is_the_closed_form(space, known, table, likelihood, model):
    result = true_posterior(table, likelihood, space, rate=100.0, fields=known)
    assert agree(result.posterior, by_hand(model, space, "joint", 100.0), 2e-3)
    for half in (result.from_half_field, result.from_half_grid):
        assert np.abs([*half.mean, *half.sd_ratio, half.log_evidence]).max() < 5e-3


def test_posteriors_at_an_uncertain_rate_are_the_closed_form_and_neither_reading_passes_for_the_other(uncertain, model):
    grid = product_grid(UNCERTAIN, panels=(32, 16, 16))
    for reading, other in (("joint", "cut"), ("cut", "joint")):
        posterior = posterior_on_grid(uncertain, UNCERTAIN, grid, reading=reading)
        assert agree(posterior, by_hand(model, UNCERTAIN, reading), 0.01)
        assert not agree(posterior, by_hand(model, UNCERTAIN, other), 0.05)


def test_evidence_at_each_rate_is_that_of_the_posterior_at_that_rate(uncertain):
    grid = product_grid(UNCERTAIN, panels=(24, 12, 6))
    joint = posterior_on_grid(uncertain, UNCERTAIN, grid)
    k = len(grid.rate) * 3 // 4
    alone = posterior_on_grid(uncertain, KNOWN, product_grid(KNOWN, panels=(24, 12, 6), rate=float(grid.rate[k])))
    assert joint.log_evidence_at_rate[k] == pytest.approx(alone.log_evidence, abs=1e-12)


def test_a_wrong_measure_weight_is_noticed(known, model):
    """Planted: the Jacobian of log E is forgotten."""
    grid = product_grid(KNOWN, rate=100.0)
    object.__setattr__(grid, "young_weight", grid.young_weight / grid.young * grid.young.mean())
    assert not agree(posterior_on_grid(known[0], KNOWN, grid), by_hand(model, KNOWN, "joint", 100.0), 0.01)


def test_field_is_the_likelihood_between_its_nodes_and_beyond_the_table_is_no_state(uncertain, model, table):
    x = table.coordinates.from_box(np.random.default_rng(3).uniform(-1, 1, (200, 3)))
    exact = np.array([closed_form(model, *row) for row in x.tolist()])
    np.testing.assert_allclose(uncertain(x), exact, atol=1e-3 * np.abs(exact).max())
    near = exact > -10
    np.testing.assert_allclose(uncertain(x)[near], exact[near], atol=0.01)
    assert uncertain(np.array([[150.0, 0.5, 110.0], [800.0, 0.0, 50.0]])).tolist()[0] == -np.inf


def test_mass_beyond_the_soft_end_shows_where_the_observation_is_soft(table, model):
    def edge(young):
        field = log_likelihood_field(table, likelihood_at(model, young, 0.3, 100.0), nodes=NODES, rate=100.0)
        grid = product_grid(KNOWN, rate=100.0)
        return posterior_on_grid(field, KNOWN, grid, coordinates=table.coordinates).edge_mass

    assert edge(400.0) < 1e-8
    assert edge(280.0) > 0.05


def test_total_variation_of_shifted_normals_is_the_closed_form():
    """TV of N(0, 1) and N(d, 1) is 2Φ(d/2) - 1."""
    grid = product_grid(KNOWN, rate=100.0)

    def posterior(shift):
        density = norm.pdf(grid.young[:, None], 400 + 40 * shift, 40) * np.full(len(grid.nu), 1 / 1.3)
        return GridPosterior(grid, density, np.zeros(2), np.eye(2), 0.0, np.zeros(1), 0.0)

    for d in (0.0, 0.5, 2.0):
        assert total_variation(posterior(0.0), posterior(d)) == pytest.approx(2 * norm.cdf(d / 2) - 1, abs=1e-3)


def test_what_has_no_answer_is_refused(known):
    a, b = (posterior_on_grid(known[0], KNOWN, product_grid(KNOWN, panels=(n, 16, 1), rate=100.0)) for n in (32, 33))
    with pytest.raises(InvalidInput, match="grids"):
        total_variation(a, b)
    for space, options in ((UNCERTAIN, {"rate": 100.0}), (KNOWN, {})):  # fixed or uncertain, not both
        with pytest.raises(InvalidInput, match="inflow"):
            product_grid(space, **options)
    soft = ParameterSpace((Parameter("E", Uniform(100.0, 120.0)), Parameter("nu", Uniform(0.4, 0.5))))
    with pytest.raises(NumericsError, match="V_in = 100"):
        posterior_on_grid(known[0], soft, product_grid(soft, rate=100.0))


def test_half_table_tells_a_table_that_is_too_rough(make_table, likelihood):
    rough = true_posterior(make_table((4, 6, 2)), likelihood, KNOWN, rate=100.0, nodes=NODES)
    assert rough.from_half_table.total_variation > 0.02
    assert compare(rough.posterior, rough.posterior).total_variation == 0
