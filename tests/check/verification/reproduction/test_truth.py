"""Tables of interfaces and posteriors by quadrature from them, against a model with a closed form and a fold."""

from functools import cache

import numpy as np
import pytest
from scipy.special import logsumexp
from tests.check.verification.reproduction.folding import Folding
from verification.reproduction.field_table import FieldTable, LoadCoordinates, tabulate, withheld
from verification.reproduction.grid_posterior import compare, posterior_on_grid, posteriors_on_grid, product_grid
from verification.reproduction.truth import log_likelihood_field, true_fields, true_posteriors

from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.parameters import LogNormal, Parameter, ParameterSpace, ScaledBeta, Uniform
from strandline.runs import InProcess, Ledger

MODEL = Folding(softness=0.97)
"""Its fold is 3 % away from the one that the coordinates are told."""
BOX = LoadCoordinates(fold=Folding.FOLD, reach=0.9, inertia=None)


@pytest.fixture(scope="module")
def ledger(tmp_path_factory):
    with Ledger.open(tmp_path_factory.mktemp("table") / "ledger.sqlite", model=MODEL) as ledger:
        yield ledger


@pytest.fixture(scope="module")
def make_table(ledger):
    settings = {"ledger": ledger, "executor": InProcess(), "coordinates": BOX}
    return lambda intervals: tabulate(MODEL, MODEL.undeformed(), intervals=intervals, **settings)


@pytest.fixture(scope="module")
def table(make_table):
    return make_table((12, 6, 2))


def somewhere(box, number=40):
    return box.from_box(np.random.default_rng(0).uniform(-1, 1, (number, 3)))


def exact(x):
    bulge = np.array([MODEL.bulge(*row) for row in x.tolist()])
    abscissa = np.linspace(0, 1, MODEL.nodes)
    return np.stack(np.broadcast_arrays(abscissa, bulge[:, None] * np.sin(np.pi * abscissa)), axis=-1)


def test_coordinates_go_there_and_back_and_the_box_ends_before_the_folds_of_the_biofilm():
    """The cubic fit must not come nearer than 10 % to the folds at V = 100."""
    box = LoadCoordinates()
    z = np.random.default_rng(1).uniform(-1, 1, (50, 3))
    np.testing.assert_allclose(box.to_box(box.from_box(z)), z, atol=1e-12)
    for nu, young in box.fold:
        assert 1.1 * young < float(box.softest(np.array([nu]), box.fold_rate)[0]) < 1.17 * young
    for limit in ((120.0, -0.3, 94.02), (120.0, 0.5, 64.17)):  # E, ν and rate of folds, found by following the load
        assert 0.92 < float(box.load(np.array(limit))) < 1.2


def test_interfaces_between_the_nodes_are_the_closed_form_and_the_error_falls_geometrically(table, make_table):
    x = somewhere(table.coordinates)
    assert np.abs(table.at(x) - exact(x)).max() < 2e-8
    errors = [np.abs(make_table((n, 6, 2)).at(x) - exact(x)).max() for n in (2, 4, 6)]
    assert errors[0] > 10 * errors[1] > 100 * errors[2] > 0


def test_withheld_runs_see_a_table_with_swapped_axes(make_table, ledger):
    table = make_table((6, 6, 2))
    x = somewhere(table.coordinates, 10)
    good = withheld(table, MODEL, x, ledger=ledger, executor=InProcess())
    swapped = table.values.swapaxes(0, 1)[: len(table.axes[0])]
    wrong = FieldTable(table.coordinates, table.reference, table.axes, swapped, table.runs)
    bad = withheld(wrong, MODEL, x, ledger=ledger, executor=InProcess())
    assert good.max() < 1e-4 < 0.01 < bad.max()


TRUTH = (400.0, 0.3, 100.0)
VARIANCE = 1e-5
YOUNG, POISSON = Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", Uniform(-0.8, 0.5))
KNOWN = ParameterSpace((YOUNG, POISSON))
INFORMED = ParameterSpace((Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0)), POISSON))
UNCERTAIN = ParameterSpace((YOUNG, POISSON, Parameter("V_in", ScaledBeta(2.6, 1.4, 0.0, 110.0), "mm^2/s")))
NODES = (49, 25, 13)


def heights(simulated, observed):
    """A measure with a closed form: the squared differences of the heights of the nodes."""
    return float(np.sum((simulated.points[:, 1] - observed.points[:, 1]) ** 2))


def likelihood_at(*inputs):
    observed = Interface.polyline(exact(np.array([inputs]))[0])
    return InterfaceLikelihood((Observation(observed, VARIANCE),), heights)


LIKELIHOOD = likelihood_at(*TRUTH)


@pytest.fixture(scope="module")
def known(table):
    return true_fields(table, LIKELIHOOD, nodes=NODES, rate=100.0)


@pytest.fixture(scope="module")
def uncertain(table):
    return log_likelihood_field(table, LIKELIHOOD, nodes=NODES)


def closed_form(e, nu, rate):
    """log L, with the model's own fold in place of the table's end."""
    sines = np.sum(np.sin(np.pi * np.linspace(0, 1, MODEL.nodes)) ** 2)
    value = -0.5 * sines * (MODEL.bulge(e, nu, rate) - MODEL.bulge(*TRUTH)) ** 2 / VARIANCE
    return np.where(np.isnan(value), -np.inf, value)


@cache
def by_hand(space, reading, rate=None):
    """Mean, sd and log evidence by midpoints of cells of 1 Pa and 0.01; V in equal shares of its prior."""
    E, NU = np.meshgrid(np.arange(100.5, 800.0), np.arange(-0.795, 0.5, 0.01), indexing="ij")
    prior, cell = np.exp(space["E"].truncated_prior.log_density(E)) / 1.3, 0.01
    shares = (np.arange(40) + 0.5) / 40
    rates = [rate] if rate is not None else space["V_in"].prior.quantile(shares).tolist()
    density, log_evidences = np.zeros_like(E), []
    for v in rates:
        value = closed_form(E, NU, v)
        piece = prior * np.exp(value - value.max())
        log_evidences.append(value.max() + np.log(piece.sum() * cell))
        density += piece / (piece.sum() * cell) if reading == "cut" else piece * np.exp(value.max())
    mass = density / density.sum()
    mean = np.array([np.sum(mass * E), np.sum(mass * NU)])
    sd = np.sqrt([np.sum(mass * (E - mean[0]) ** 2), np.sum(mass * (NU - mean[1]) ** 2)])
    return mean, sd, float(logsumexp(log_evidences) - np.log(len(rates)))


def agree(posterior, reference, tolerance):
    mean, sd, log_evidence = reference
    off = [*((posterior.mean - mean) / sd), *(posterior.sd / sd - 1), posterior.log_evidence - log_evidence]
    return bool((np.abs(off) < tolerance).all())


def test_posterior_at_a_known_rate_is_the_closed_form_and_a_rough_table_is_told(known, make_table):
    for space in (KNOWN, INFORMED):
        result = true_posteriors(known, space, rate=100.0)["joint"]
        assert agree(result.posterior, by_hand(space, "joint", 100.0), 2e-3)
        coarse = posterior_on_grid(known[0], space, product_grid(space, panels=(32, 16, 12), rate=100.0))
        for half in (result.from_half_field, compare(coarse, result.posterior)):
            assert np.abs([*half.mean, *half.sd_ratio, half.log_evidence]).max() < 5e-3
    rough = true_fields(make_table((4, 6, 2)), LIKELIHOOD, rate=100.0, nodes=NODES)
    assert true_posteriors(rough, KNOWN, rate=100.0)["joint"].from_half_table.total_variation > 0.02


def test_a_wrong_measure_weight_is_noticed(known):
    """Planted: the Jacobian of log E is forgotten."""
    grid = product_grid(KNOWN, rate=100.0)
    object.__setattr__(grid, "young_weight", grid.young_weight / grid.young * grid.young.mean())
    assert not agree(posterior_on_grid(known[0], KNOWN, grid), by_hand(KNOWN, "joint", 100.0), 0.01)


def test_posteriors_at_an_uncertain_rate_are_the_closed_form_and_neither_reading_passes_for_the_other(uncertain):
    grid = product_grid(UNCERTAIN, panels=(32, 16, 16))
    found = posteriors_on_grid(uncertain, UNCERTAIN, grid)
    for reading, other in (("joint", "cut"), ("cut", "joint")):
        assert agree(found[reading], by_hand(UNCERTAIN, reading), 0.01)
        assert not agree(found[reading], by_hand(UNCERTAIN, other), 0.05)


def test_field_is_the_likelihood_between_its_nodes_and_mass_beyond_the_soft_end_shows(uncertain, table):
    x = table.coordinates.from_box(np.random.default_rng(3).uniform(-1, 1, (200, 3)))
    expected = np.array([closed_form(*row) for row in x.tolist()])
    np.testing.assert_allclose(uncertain(x), expected, atol=1e-3 * np.abs(expected).max())
    for young, least, most in ((400.0, 0.0, 1e-8), (280.0, 0.05, np.inf)):
        field = log_likelihood_field(table, likelihood_at(young, 0.3, 100.0), nodes=NODES, rate=100.0)
        grid = product_grid(KNOWN, rate=100.0)
        found = posteriors_on_grid(field, KNOWN, grid, coordinates=table.coordinates)["joint"]
        assert least <= found.edge_mass < most
