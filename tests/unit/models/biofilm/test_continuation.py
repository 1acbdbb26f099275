"""Newton's method, load paths and limit points: closed forms, bounds on J, the flow cell."""

from dataclasses import dataclass
from types import SimpleNamespace

import ngsolve as ng
import numpy as np
import pytest
from scipy.optimize import root
from tests.unit.models.biofilm.cells import coarse_cell, failure, largest

from strandline.foundations import ForwardModelError
from strandline.models.biofilm import newton
from strandline.models.biofilm.cells import cell as cell_module
from strandline.models.biofilm.cells.cell import Setting
from strandline.models.biofilm.cells.fields import Strain, jacobian_bound
from strandline.models.biofilm.cells.steady import ARRIVAL, Path, Steady, steady_state

LIMIT = 3.0**-1.5
"""Largest w(1 - w)(2 - w)/2, at w = 1 - 3^-1/2: the force that a Saint-Venant–Kirchhoff bar with ν = 0, E = 1 bears."""
SPRING = 2.0
SOFT = {"young": [144.0], "poisson": [0.42]}


def dense(matrix):
    return SimpleNamespace(matrix=matrix, solve=lambda right: np.linalg.solve(matrix, right))


@dataclass
class Bar:
    """A bar compressed by w behind a linear spring that is pressed to u - w; the load acts on the spring's end u."""

    inverted_beyond: float = np.inf
    factorised: int = 0
    weights = np.ones(2)

    def residual(self, x, load):
        w, u = x
        return np.array([w * (1 - w) * (2 - w) / 2 - SPRING * (u - w), SPRING * (u - w) - load])

    def factorise(self, x, load):
        self.factorised += 1
        slope = 1 - 3 * x[0] + 1.5 * x[0] ** 2
        return dense(np.array([[slope + SPRING, -SPRING], [-SPRING, SPRING]]))

    def by_load(self):
        return np.array([0.0, -1.0])

    def critical_strain(self, x, tangent):
        return Strain(np.array([1.0, 0.0]), (0.5, 0.25))

    def check(self, x):
        if x[0] > self.inverted_beyond:
            raise ForwardModelError("inverted_elements", "pressed too far", {"min_J_solid": -1.0})
        return {"min_J_solid": float(1 - x[0])}


def follow(bar, load, *, first_share=0.7, budget=0):
    linear = np.array([load, load + load / SPRING])
    return Path(bar, load, budget).follow(linear, first_share * load)


def compression(load: float) -> float:
    """Return w on the first branch at a load below the limit."""
    return float(np.roots([1.0, -3.0, 2.0, -2.0 * load]).real.min())


def test_limit_load_of_the_bar():
    """The last one folds within the first step, which begins with the slope at its predictor, not at its point."""
    for share, tolerance in ((1.001, 1e-3), (1.5, 1e-3), (2.0, 1e-3), (5.0, 2e-2)):
        bar = Bar()
        found = failure(follow, bar, share * LIMIT)
        evidence, w = found.evidence, found.evidence["critical_strain"]
        assert found.kind == "limit_point"
        np.testing.assert_allclose(evidence["limit_load"], LIMIT, rtol=tolerance)
        assert evidence["load_slope"] < 0
        assert w > 1 - 3**-0.5
        np.testing.assert_allclose(evidence["load_slope"], 0.5 * (2 - 6 * w + 3 * w**2), atol=2e-3)
        assert 0.9 * LIMIT < evidence["load_reached"] <= evidence["limit_load"]
        assert evidence["jacobians"] == bar.factorised
        assert (evidence["critical_x"], evidence["critical_y"]) == (0.5, 0.25)


@pytest.mark.parametrize("first_share", [0.3, 0.7, 0.8])
def test_every_load_below_the_limit_is_reached_on_the_first_branch(first_share):
    """Just below the limit a step leads over load and fold at once; there is a state all the same."""
    for share in (0.5, 0.9, 0.99, 0.992, 0.996, 0.998, 0.9999):
        bar = Bar()
        traced = follow(bar, share * LIMIT, first_share=first_share)
        w = compression(share * LIMIT)
        np.testing.assert_allclose(traced.x, [w, w + share * LIMIT / SPRING], atol=1e-9)
        assert traced.jacobians == bar.factorised


def test_budget_that_is_too_small_is_used_up_and_no_more():
    """A state that the path has passed is found beyond it."""
    whole = failure(follow, Bar(), 2 * LIMIT).evidence["jacobians"]
    for budget in range(2, int(whole)):
        bar = Bar()
        found = failure(follow, bar, 2 * LIMIT, budget=budget)
        assert found.kind == "continuation_stalled"
        assert found.evidence["jacobians"] == bar.factorised == budget
        assert 0 < found.evidence["load_reached"] < LIMIT
        assert 0 < found.evidence["min_J_solid"] < 1
    bar = Bar()
    traced = follow(bar, 0.9 * LIMIT, budget=2)
    assert 2 < bar.factorised <= 2 + ARRIVAL.maximum_jacobians
    np.testing.assert_allclose(traced.x[0], compression(0.9 * LIMIT), atol=1e-9)


def test_newton_is_damped_where_plain_newton_diverges_and_says_why_it_stops():
    """r(x) = arctan(10 x): plain Newton diverges from x = 1; and 1 + x² has no root."""

    def scalar(residual, slope):
        return SimpleNamespace(residual=residual, factorise=lambda x: dense(np.diag(slope(x))))

    steep = scalar(lambda x: np.arctan(10 * x), lambda x: 10 / (1 + (10 * x) ** 2))
    settings, one = {"weights": np.ones(1), "settings": newton.NewtonSettings()}, np.ones(1)
    np.testing.assert_allclose(newton.solve(steep, one, **settings).x, 0.0, atol=1e-9)
    rootless = scalar(lambda x: 1.0 + x**2, lambda x: 2 * x + 1e-6)
    assert failure(newton.solve, rootless, 2 * one, **settings).kind in {"newton_stalled", "newton_maxit"}
    settings["settings"] = newton.NewtonSettings(maximum_jacobians=1)
    assert failure(newton.solve, steep, one, **settings).kind == "newton_maxit"


def test_jacobian_bound_is_a_bound_and_finds_an_inversion_between_the_corners():
    mesh = ng.Mesh(ng.unit_square.GenerateMesh(maxh=0.5))
    space = ng.VectorH1(mesh, order=2)
    field, solid, rng = ng.GridFunction(space), np.arange(mesh.ne) == 0, np.random.default_rng(0)
    points = rng.dirichlet([1, 1, 1], 500)[:, :2]
    rule = ng.IntegrationRule(points=[tuple(p) for p in points], weights=[0.0] * len(points))
    for scale in (0.02, 0.1, 0.3):
        field.vec.FV().NumPy()[:] = rng.normal(0, scale, space.ndof)
        J = ng.Det(ng.Id(2) + ng.Grad(field))
        sampled = np.asarray(J(mesh.MapToAllElements(rule, ng.VOL))).reshape(mesh.ne, -1)
        fluid_bound, solid_bound = jacobian_bound(mesh, field, solid)
        assert fluid_bound <= sampled[1:].min() + 1e-12
        assert solid_bound <= sampled[:1].min() + 1e-12
    field.Set(ng.CF((0.1 * ng.x, 0)))
    np.testing.assert_allclose(jacobian_bound(mesh, field, solid), (1.1, 1.1))


@pytest.fixture(scope="module")
def cell():
    return coarse_cell()


def displaced(cell, *displacement):
    """Return the unknowns of a state with a given displacement of the solid; zero is left where it is prescribed."""
    cell.system.values[:] = 0.0
    solid = cell.mesh.Materials("|".join(cell.system.solids))
    cell.system.state.components[2].Set(ng.CF(displacement), definedon=solid)
    x = np.array(cell.system.values[cell.system.free])
    cell.system.values[:] = 0.0
    return x


def test_strains_have_their_closed_forms(cell):
    """Uniform away from the base, where d is kept at zero.

    And d_x = -a y², which vanishes with its gradient on the base: strain (0, -a y; -a y, 0), compression a y.
    """
    elements = [e for e in cell.mesh.Elements(ng.VOL) if e.mat in cell.system.solids]
    heights = np.array([[cell.mesh.vertices[v.nr].point[1] for v in e.vertices] for e in elements])
    G, a = np.array([[-0.2, 0.05], [0.03, -0.1]]), 0.1
    x = displaced(cell, G[0, 0] * ng.x + G[0, 1] * ng.y, G[1, 0] * ng.x + G[1, 1] * ng.y)
    found = cell.strains._gradients(x)[heights.min(axis=1) > 1e-9]
    np.testing.assert_allclose(found, np.broadcast_to(G, found.shape), atol=1e-9)
    x = displaced(cell, -a * ng.y**2, 0.0)
    for way in (x, -x):
        np.testing.assert_allclose(cell.largest_compression(way), a * heights.mean(axis=1).max(), atol=1e-9)


@pytest.fixture(scope="module")
def fold(cell) -> ForwardModelError:
    return failure(cell.solve, Setting(**SOFT, rate=100.0))


def test_soft_specimen_has_a_limit_point_below_the_inflow_wanted(cell, fold):
    evidence, limit = fold.evidence, fold.evidence["limit_load"]
    assert fold.kind == "limit_point"
    assert evidence["load_slope"] < 0
    assert 0 < evidence["load_reached"] <= limit < 100
    assert 0 < evidence["min_J_solid"] < evidence["min_J_fluid"] < 1
    beyond = failure(cell.solve, Setting(**SOFT, rate=1.01 * limit))
    assert beyond.kind == "limit_point"
    np.testing.assert_allclose(beyond.evidence["limit_load"], limit, rtol=5e-3)


def test_close_to_the_fold_the_state_is_that_of_the_first_branch(cell, fold):
    """The interface goes on as it began, further with each increase; the second branch would lead it back."""
    shares = np.array([0.9, 0.95, 0.98, 0.99, 0.995])
    found = [cell.solve(Setting(**SOFT, rate=share * fold.evidence["limit_load"])) for share in shares]
    thinnest = [one.bounds["min_J_solid"] for one in found]
    assert (np.diff([largest(one.displacement) for one in found]) > 0).all()
    assert (np.diff(thinnest) < 0).all()
    assert (np.diff(-np.diff(thinnest) / np.diff(shares)) > 0).all()


def test_a_budget_changes_no_result(cell):
    free, bounded = (cell.solve(Setting([220.0], [0.0], 100.0), budget) for budget in (0, 5))
    np.testing.assert_array_equal(free.unknowns, bounded.unknowns)


def test_what_does_not_balance_or_is_not_finite_is_a_typed_failure(cell, monkeypatch):
    def perturbed(bending, load, *, budget=0):
        found = steady_state(bending, load, budget=budget)
        return Steady(found.x * (1 + 1e-4), found.jacobians)

    assert failure(cell.residual, np.full(len(cell.system.free), np.nan), 1.0).kind == "nonfinite_residual"
    monkeypatch.setattr(cell_module, "steady_state", perturbed)
    found = failure(cell.solve, Setting([400.0], [0.3], 100.0))
    assert found.kind == "unbalanced"
    assert found.evidence["residual"] > 1e-6 * found.evidence["reaction"]


def test_inverted_elements_are_found_in_solid_and_fluid(cell):
    bound = cell.check(np.zeros(len(cell.system.free)))
    assert bound["min_J_fluid"] == bound["min_J_solid"] == pytest.approx(1.0)
    found = failure(cell.check, displaced(cell, 0.0, -2.0 * ng.y))
    assert found.kind == "inverted_elements"
    assert found.evidence["min_J_solid"] < 0
    soft = failure(coarse_cell("neo_hookean").solve, Setting([70.0], [0.3], 100.0))  # stopped by its mesh
    assert soft.kind == "inverted_elements"
    assert soft.evidence["min_J_fluid"] <= 0 < soft.evidence["min_J_solid"]
    assert 85 < soft.evidence["load_reached"] < 100


def squeezed(cell, centre, amount):
    """Return unknowns that squeeze the solid around a place, by ∇d = -amount·I there."""
    x, y = ng.x - centre[0], ng.y - centre[1]
    bump = -amount * ng.exp(-(x * x + y * y) / (2 * 0.08**2))
    return displaced(cell, ng.CF((bump * x, bump * y)))


@dataclass
class Coupled:
    """A chain of cubic springs that is pulled: smooth, unsymmetric, ten unknowns."""

    factorised: int = 0

    def residual(self, x):
        left, right = np.append(0.0, x[:-1]), np.append(x[1:], 0.0)
        return 3 * x - left - 1.5 * right + 0.3 * x**3 + np.sin(left * right) - 1.0

    def factorise(self, x):
        self.factorised += 1
        h = 1e-6
        columns = [(self.residual(x + h * e) - self.residual(x - h * e)) / (2 * h) for e in np.eye(len(x))]
        return dense(np.array(columns).T)


def solved(system, contraction):
    settings = newton.NewtonSettings(tolerance=1e-11, contraction=contraction)
    return newton.solve(system, np.zeros(10), weights=np.ones(10), settings=settings)


def test_inverted_elements_are_passed_on_with_the_load_reached():
    for where in (0.1, 0.35):
        bar = Bar(inverted_beyond=where)
        found = failure(follow, bar, 0.999 * LIMIT, first_share=0.5)
        reached = found.evidence["load_reached"]
        assert found.kind == "inverted_elements"
        assert found.evidence["jacobians"] == bar.factorised
        assert found.evidence["min_J_solid"] == -1.0
        if where < 0.2:
            assert reached == 0.0
        else:
            np.testing.assert_allclose(reached, where * (1 - where) * (2 - where) / 2, rtol=1e-2)
            assert compression(reached) <= where + 1e-3


def test_quasi_newton_steps_reach_the_root_of_scipy_with_fewer_jacobians():
    quasi, plain = Coupled(), Coupled()
    found, pure = solved(quasi, 0.5), solved(plain, 0.0)
    expected = root(quasi.residual, np.zeros(10), tol=1e-13)
    assert expected.success
    for one in (found, pure):
        np.testing.assert_allclose(one.x, expected.x, atol=1e-9)
    assert quasi.factorised == found.jacobians < pure.jacobians == plain.factorised
    search = newton._Search(quasi, np.array([1.0, 0.5]), newton.NewtonSettings())
    np.testing.assert_allclose(search._length(np.array([3.0, 8.0])), np.sqrt(25 / 2))
    refused = ForwardModelError("continuation_stalled", "no more", {"jacobians": 17.0})
    quasi.factorise = lambda x: (_ for _ in ()).throw(refused)
    assert failure(solved, quasi, 0.5).evidence["jacobians"] == 17.0


def test_critical_strain_is_that_of_the_element_that_grows_fastest(cell):
    """Not of the most compressed one, which lies elsewhere; its rate is that of the smallest stretch's fall."""

    def stretches(x):
        F = np.eye(2) + cell.strains._gradients(x)
        return np.sqrt(np.linalg.eigvalsh(F.transpose(0, 2, 1) @ F)[:, 0])

    h, state = 1e-4, squeezed(cell, (0.95, 0.3), 0.3)
    most = cell.largest_strain(state)
    assert np.hypot(*(np.array(most.place) - [0.95, 0.3])) < 0.1
    for centre in ((0.8, 0.2), (1.1, 0.25)):
        tangent = squeezed(cell, centre, 0.2)
        strain = cell.critical_strain(state, tangent)
        assert np.hypot(*(np.array(strain.place) - centre)) < 0.06
        fall = (stretches(state - h * tangent) - stretches(state + h * tangent)) / (2 * h)
        np.testing.assert_allclose(strain.functional @ tangent, fall.max(), rtol=1e-5)
        assert most.place != strain.place
