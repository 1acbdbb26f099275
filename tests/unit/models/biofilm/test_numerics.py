"""Newton's method and the bound on J, against closed forms."""

import ngsolve as ng
import numpy as np
from tests.unit.models.biofilm.cells import failure

from strandline.models.biofilm import newton
from strandline.models.biofilm.distortion import jacobian_bound, quadratic_nodes


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
