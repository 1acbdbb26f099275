"""Newton's method, the Jacobian, the bound on J, conservation: each against a closed form or finite differences."""

import ngsolve as ng
import numpy as np
import pytest

from strandline.errors import ForwardModelError
from strandline.models.biofilm import newton
from strandline.models.biofilm.cell import FlowCell, _boundaries
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.distortion import jacobian_bound, quadratic_nodes
from strandline.models.biofilm.geometry import MESHES, mesh_flow_cell
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition
from strandline.models.biofilm.system import CoupledSystem


@pytest.fixture(scope="module")
def system() -> CoupledSystem:
    mesh = mesh_flow_cell(Outline(nodes=34).interface(), MESHES["coarse"])
    system = CoupledSystem(mesh, _boundaries(Channel()), viscosity=0.01, density=1.0)
    inflow = ng.CF((6 * ng.y * (1 - ng.y), 0))
    system.state.components[0].Set(inflow, definedon=mesh.Boundaries("inlet"))
    system.set_material([40.0], [0.3])
    return system


def coarse_cell(
    law: str = "saint_venant_kirchhoff", channel: Channel = Channel(), partition: Partition = Partition()
) -> FlowCell:
    reference = Outline().interface()
    return FlowCell(reference, MESHES["coarse"], channel=channel, partition=partition, law=LAWS[law])


def test_mesh_has_each_interface_vertex_once(system):
    on_interface = {v.nr for e in system.mesh.Elements(ng.BND) if e.mat == "interface" for v in e.vertices}
    points = np.array([system.mesh.vertices[nr].point for nr in on_interface])
    distance = np.linalg.norm(points[:, None] - points[None], axis=2) + np.eye(len(points))
    assert distance.min() > 1e-3


def test_mesh_is_the_same_to_the_bit():
    meshes = [mesh_flow_cell(Outline().interface(), MESHES["default"]) for _ in range(2)]
    first, second = (np.array([v.point for v in mesh.vertices]) for mesh in meshes)
    np.testing.assert_array_equal(first, second)


def test_jacobian_agrees_with_central_differences_to_second_order(system):
    rng = np.random.default_rng(3)
    x, direction = rng.uniform(-1e-3, 1e-3, (2, len(system.free)))
    factorisation = system.factorise(x)

    def error(h: float) -> float:
        difference = (system.residual(x + h * direction) - system.residual(x - h * direction)) / (2 * h)
        return float(np.abs(factorisation.solve(difference) - direction).max() / np.abs(direction).max())

    errors = [error(h) for h in (1e-2, 1e-3)]
    assert errors[1] < 1e-3
    np.testing.assert_allclose(np.log10(errors[0] / errors[1]), 2.0, atol=0.1)


def test_forces_balance_over_the_whole_body():
    """The reaction at the base equals the fluid's force on the interface: row selection conserves momentum."""
    cell = coarse_cell()
    cell.solve([400.0], [0.3], 100.0)
    system = cell.system
    residual = system.full_residual()
    velocity, displacement = system.space.Range(0), system.space.Range(2)
    interface = sorted({v.nr for e in system.mesh.Elements(ng.BND) if e.mat == "interface" for v in e.vertices})
    base = sorted({v.nr for e in system.mesh.Elements(ng.BND) if e.mat == "base" for v in e.vertices})
    on_fluid = residual[velocity.start + np.array(interface)].sum()
    on_base = residual[displacement.start + np.array(base)].sum()
    assert abs(on_fluid) > 0.1
    assert abs(on_base) > 0.1
    np.testing.assert_allclose(on_base, on_fluid, rtol=1e-8)


def test_mass_is_conserved():
    cell = coarse_cell()
    cell.solve([400.0], [0.3], 80.0)
    velocity = cell.system.state.components[0]
    out = ng.Integrate(velocity[0], cell.mesh, definedon=cell.mesh.Boundaries("outlet"))
    np.testing.assert_allclose(out, 0.8, rtol=1e-9)


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


class _Scalar:
    """r(x) = arctan(10 x): plain Newton diverges from x = 1."""

    def __init__(self) -> None:
        self.jacobians = 0

    def residual(self, x):
        return np.arctan(10 * x)

    def factorise(self, x):
        self.jacobians += 1
        slope = 10 / (1 + (10 * x) ** 2)
        return type("LU", (), {"solve": staticmethod(lambda right: right / slope)})()


def test_newton_is_damped_where_plain_newton_diverges():
    solution = newton.solve(_Scalar(), np.array([1.0]), weights=np.ones(1), settings=newton.NewtonSettings())
    np.testing.assert_allclose(solution.x, 0.0, atol=1e-9)


def test_newton_without_a_root_stalls_and_says_so():
    class NoRoot(_Scalar):
        def residual(self, x):
            return 1.0 + x**2

        def factorise(self, x):
            return type("LU", (), {"solve": staticmethod(lambda right: right / (2 * x + 1e-6))})()

    with pytest.raises(ForwardModelError) as caught:
        newton.solve(NoRoot(), np.array([2.0]), weights=np.ones(1), settings=newton.NewtonSettings())
    assert caught.value.kind in {"newton_stalled", "newton_maxit"}


def test_newton_reports_an_exhausted_budget():
    with pytest.raises(ForwardModelError, match="newton_maxit"):
        newton.solve(
            _Scalar(), np.array([1.0]), weights=np.ones(1), settings=newton.NewtonSettings(maximum_jacobians=1)
        )


def test_nonfinite_residual_is_a_typed_failure(system):
    with pytest.raises(ForwardModelError, match="nonfinite_residual"):
        system.residual(np.full(len(system.free), np.nan))
