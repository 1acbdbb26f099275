"""Newton's method, the Jacobian, the bound on J: each against a closed form or finite differences."""

import ngsolve as ng
import numpy as np
import pytest
from tests.unit.models.biofilm.cells import failure, jacobian_errors

from strandline.models.biofilm import newton
from strandline.models.biofilm.cell import _boundaries
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.distortion import jacobian_bound, quadratic_nodes
from strandline.models.biofilm.geometry import MESHES, mesh_flow_cell
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.system import CoupledSystem


@pytest.fixture(scope="module")
def system() -> CoupledSystem:
    mesh = mesh_flow_cell(Outline(nodes=12).interface(), MESHES["coarse"])
    system = CoupledSystem(mesh, _boundaries(Channel()), viscosity=0.01, density=1.0)
    inflow = ng.CF((6 * ng.y * (1 - ng.y), 0))
    system.state.components[0].Set(inflow, definedon=mesh.Boundaries("inlet"))
    system.set_material([40.0], [0.3])
    return system


def test_jacobian_agrees_with_central_differences_to_second_order(system):
    x, direction = np.random.default_rng(3).uniform(-1e-3, 1e-3, (2, len(system.free)))
    errors = jacobian_errors(system, x, direction)
    assert errors[1] < 1e-3
    np.testing.assert_allclose(np.log10(errors[0] / errors[1]), 2.0, atol=0.1)


def test_nonfinite_residual_is_a_typed_failure(system):
    assert failure(system.residual, np.full(len(system.free), np.nan)).kind == "nonfinite_residual"


def test_jacobian_bound_is_a_bound_and_finds_an_inversion_between_the_corners():
    mesh = ng.Mesh(ng.unit_square.GenerateMesh(maxh=0.5))
    space = ng.VectorH1(mesh, order=2)
    field = ng.GridFunction(space)
    solid = np.zeros(mesh.ne, bool)
    solid[0] = True
    rng = np.random.default_rng(0)
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


def test_quadratic_nodes_are_shared_between_neighbours():
    mesh = ng.Mesh(ng.unit_square.GenerateMesh(maxh=0.5))
    nodes, count = quadratic_nodes(mesh)
    assert count == mesh.nv + mesh.nedge == len(np.unique(nodes))


class Steep:
    """r(x) = arctan(10 x): plain Newton diverges from x = 1."""

    def residual(self, x):
        return np.arctan(10 * x)

    def factorise(self, x):
        slope = 10 / (1 + (10 * x) ** 2)
        return type("LU", (), {"solve": staticmethod(lambda right: right / slope)})()


class NoRoot:
    def residual(self, x):
        return 1.0 + x**2

    def factorise(self, x):
        return type("LU", (), {"solve": staticmethod(lambda right: right / (2 * x + 1e-6))})()


def test_newton_is_damped_where_plain_newton_diverges_and_says_why_it_stops():
    settings, weights = newton.NewtonSettings(), np.ones(1)
    solution = newton.solve(Steep(), np.array([1.0]), weights=weights, settings=settings)
    np.testing.assert_allclose(solution.x, 0.0, atol=1e-9)
    stalled = failure(newton.solve, NoRoot(), np.array([2.0]), weights=weights, settings=settings)
    assert stalled.kind in {"newton_stalled", "newton_maxit"}
    short = newton.NewtonSettings(maximum_jacobians=1)
    assert failure(newton.solve, Steep(), np.array([1.0]), weights=weights, settings=short).kind == "newton_maxit"
