"""Elements of fluid and solid against NGSolve's forms and against finite differences; coefficients of laws as jets."""

import ngsolve as ng
import numpy as np
import pytest
import scipy.sparse as sparse

from strandline.models.biofilm import fluid_elements, solid_elements
from strandline.models.biofilm.assembly import SymbolicPart, product
from strandline.models.biofilm.cell import FlowCell, _boundaries
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.materials import LAWS, further_parameters
from strandline.models.biofilm.materials.isotropic import Jet, exp, log
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition
from strandline.models.biofilm.system import CoupledSystem, _add_fluid, _solid_form


@pytest.fixture(scope="module")
def system() -> CoupledSystem:
    """A system far from rest, in another fluid than water."""
    law = LAWS["neo_hookean"]
    cell = FlowCell(Outline().interface(), MESHES["coarse"], channel=Channel(), partition=Partition(), law=law)
    cell.solve([200.0], [0.3], 100.0)
    cell.system.viscosity.Set(0.037)
    cell.system.density.Set(1.7)
    return cell.system


def by_ngsolve(system: CoupledSystem) -> SymbolicPart:
    form = ng.BilinearForm(system.space)
    _add_fluid(form, system)
    return SymbolicPart(form)


def matrix(part, system: CoupledSystem) -> sparse.csr_matrix:
    entries = part.jacobian(system.state)
    return sparse.coo_matrix((entries, part.places()), shape=(system.space.ndof,) * 2).tocsr()


def of_momentum_and_mass(system: CoupledSystem) -> np.ndarray:
    """Return the rows that the fluid's balances are taken from."""
    return np.flatnonzero(~system.is_motion)


def test_residual_and_jacobian_are_those_of_the_forms(system):
    """To rounding where the deformation is affine: there both quadrature rules are exact."""
    fluid, reference, kept = system._parts[-1], by_ngsolve(system), np.array(system.values)
    rows = of_momentum_and_mass(system)
    system.values[:] = np.random.default_rng(1).uniform(-1.0, 1.0, len(kept))
    system.state.components[2].Set(ng.CF((0.3 * ng.x - 0.4 * ng.y, 0.5 * ng.x + 0.2 * ng.y)))
    found, expected = fluid.residual(system.state)[rows], reference.residual(system.state)[rows]
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
    found, expected = matrix(fluid, system)[rows], matrix(reference, system)[rows]
    assert abs(found - expected).max() < 1e-12 * abs(expected).max()
    system.values[:] = kept


def test_quadrature_matters_little_in_a_bent_layer(system):
    fluid, reference = system._parts[-1], by_ngsolve(system)
    rows = of_momentum_and_mass(system)
    found, expected = fluid.residual(system.state)[rows], reference.residual(system.state)[rows]
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("name", ["metric", "pulled", "viscous"])
def test_a_wrong_term_would_be_noticed(name, system, monkeypatch):
    fluid, reference = system._parts[-1], by_ngsolve(system)
    rows = of_momentum_and_mass(system)
    right = fluid_elements._Fields.of

    def wrong(*given):
        fields = right(*given)
        getattr(fields, name)[0][1][:] *= 1.01
        return fields

    monkeypatch.setattr(fluid_elements._Fields, "of", wrong)
    found, expected = matrix(fluid, system)[rows], matrix(reference, system)[rows]
    assert abs(found - expected).max() > 1e-6 * abs(expected).max()


def test_jacobian_is_the_derivative_of_the_residual(system):
    fluid, kept = system._parts[-1], np.array(system.values)
    direction = np.random.default_rng(0).standard_normal(len(kept)) * 1e-6
    derivative = product(fluid.places(), fluid.jacobian(system.state), direction)
    found = []
    for sign in (1.0, -1.0):
        system.values[:] = kept + sign * direction
        found.append(fluid.residual(system.state))
    system.values[:] = kept
    np.testing.assert_allclose((found[0] - found[1]) / 2, derivative, atol=1e-7 * np.abs(derivative).max())


def test_the_traction_loads_the_solid_only(system):
    """Rows of displacements get the traction at the interface, and with it exactly what the velocity's rows get."""
    residual = system._parts[-1].residual(system.state)
    v, d = (system.space.Range(k) for k in (0, 2))
    on_interface = sorted({v.nr for e in system.mesh.Elements(ng.BND) if e.mat == "interface" for v in e.vertices})
    np.testing.assert_allclose(residual[d.start + np.array(on_interface)], residual[v.start + np.array(on_interface)])
    assert np.abs(residual[v.start + np.array(on_interface)]).max() > 1e-3


@pytest.fixture(params=LAWS)
def layer(request) -> CoupledSystem:
    """A system of three materials far from rest, with a body force; one for each law."""
    law = LAWS[request.param]
    parts = Partition.PRESETS["three_parts"]
    cell = FlowCell(Outline().interface(), MESHES["coarse"], channel=Channel(), partition=parts, law=law)
    known = {"viscosity": 1.0, "density": 1.0, "law": law, "solids": tuple(cell.parts), "body_force": (0.3, -0.2)}
    system = CoupledSystem(cell.mesh, _boundaries(Channel()), **known)
    system.set_material([2.0, 5.0, 3.0], [0.3, -0.4, 0.0], *([0.3, 0.4, 0.5] for _ in further_parameters(law)))
    system.state.components[2].Set(ng.CF((0.2 * ng.x * ng.y - 0.1 * ng.y, 0.1 * ng.x**2 + 0.1 * ng.y)))
    system.values[:] += np.random.default_rng(1).uniform(-1e-4, 1e-4, len(system.values))
    return system


def solid_of(system: CoupledSystem) -> solid_elements.SolidElements:
    (found,) = (part for part in system._parts if isinstance(part, solid_elements.SolidElements))
    return found


def test_the_solid_is_that_of_the_forms(layer):
    solid, reference = solid_of(layer), SymbolicPart(_solid_form(layer))
    found, expected = solid.residual(layer.state), reference.residual(layer.state)
    assert np.abs(found - expected).max() < 1e-13 * np.abs(expected).max()
    found, expected = matrix(solid, layer), matrix(reference, layer)
    assert abs(found - expected).max() < 1e-13 * abs(expected).max()


def test_the_jacobian_of_the_solid_is_the_derivative_of_its_residual(layer):
    solid, kept = solid_of(layer), np.array(layer.values)
    direction = np.random.default_rng(0).standard_normal(len(kept)) * 1e-6
    derivative = product(solid.places(), solid.jacobian(layer.state), direction)
    found = []
    for sign in (1.0, -1.0):
        layer.values[:] = kept + sign * direction
        found.append(solid.residual(layer.state))
    np.testing.assert_allclose((found[0] - found[1]) / 2, derivative, atol=1e-6 * np.abs(derivative).max())


@pytest.mark.parametrize(
    ("layer", "name"),
    [("neo_hookean", "_metric"), ("mooney_rivlin", "_strained"), ("fung", "_gradients")],
    indirect=["layer"],
)
def test_a_wrong_term_of_the_solid_would_be_noticed(layer, name, monkeypatch):
    right = vars(solid_elements._AtPoints)[name].func
    monkeypatch.setattr(solid_elements._AtPoints, name, property(lambda at: scaled(right(at), 1.01)))
    found, expected = matrix(solid_of(layer), layer), matrix(SymbolicPart(_solid_form(layer)), layer)
    assert abs(found - expected).max() > 1e-6 * abs(expected).max()


def scaled(tensor, factor):
    """Return nested lists of arrays times a factor."""
    return [scaled(part, factor) for part in tensor] if isinstance(tensor, list) else factor * tensor


def test_a_law_of_another_kind_is_left_to_ngsolve(system):
    def plain(*given):
        return LAWS["neo_hookean"](*given)

    found = CoupledSystem(system.mesh, _boundaries(Channel()), viscosity=1.0, density=1.0, law=plain)
    assert [type(part).__name__ for part in found._parts] == ["SymbolicPart", "FluidElements"]


def test_jets_differentiate():
    at = np.array([1.3, 0.7]), np.array([0.2, -0.1]), np.array([2.0, 3.0])

    def function(x, y, z):
        return exp(0.3 * x - y) / (2.0 + x * z) - z / x + (1.0 - y) * 3.0 + log(x) * z**1.5

    found = function(*Jet.variables(*at))
    for k in range(3):
        moved = [[np.array(value) for value in at] for _ in range(2)]
        for sign, values in zip((1e-6, -1e-6), moved, strict=True):
            values[k] += sign
        ends = [function(*(Jet(value) for value in values)).value for values in moved]
        np.testing.assert_allclose(found.slopes[k], (ends[0] - ends[1]) / 2e-6, rtol=1e-8, atol=1e-8)
