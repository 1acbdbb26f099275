"""Elements of fluid and solid against NGSolve's forms and against finite differences; coefficients of laws as jets."""

import ngsolve as ng
import numpy as np
import pytest
import scipy.sparse as sparse
from tests.unit.models.biofilm.cells import rough_cell

from strandline.models.biofilm import fluid_elements, solid_elements
from strandline.models.biofilm.assembly import SymbolicPart
from strandline.models.biofilm.cell import _boundaries
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import MESHES, mesh_flow_cell
from strandline.models.biofilm.materials import LAWS, further_parameters
from strandline.models.biofilm.materials.isotropic import Jet, exp, log
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition
from strandline.models.biofilm.system import CoupledSystem, _add_fluid, _solid_form


@pytest.fixture(scope="module")
def system() -> CoupledSystem:
    """A system far from rest, in another fluid than water."""
    cell = rough_cell("neo_hookean")
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


def test_quadrature_matters_little_in_a_bent_layer_and_a_wrong_term_would_be_noticed(system, monkeypatch):
    fluid, reference = system._parts[-1], by_ngsolve(system)
    rows = of_momentum_and_mass(system)
    found, expected = fluid.residual(system.state)[rows], reference.residual(system.state)[rows]
    assert np.abs(found - expected).max() < 2e-6 * np.abs(expected).max()
    expected, right = matrix(reference, system)[rows], fluid_elements._Fields.of
    for name in ("metric", "pulled", "viscous"):

        def wrong(*given, name=name):
            fields = right(*given)
            getattr(fields, name)[0][1][:] *= 1.01
            return fields

        monkeypatch.setattr(fluid_elements._Fields, "of", wrong)
        assert abs(matrix(fluid, system)[rows] - expected).max() > 1e-6 * abs(expected).max()


def layer(name: str) -> CoupledSystem:
    """Return a system of three materials of a law, far from rest, with a body force."""
    law = LAWS[name]
    mesh = mesh_flow_cell(Outline(nodes=8).interface(), MESHES["rough"], partition=Partition.PRESETS["three_parts"])
    solids = ("solid1", "solid2", "solid3")
    known = {"viscosity": 1.0, "density": 1.0, "law": law, "solids": solids, "body_force": (0.3, -0.2)}
    system = CoupledSystem(mesh, _boundaries(Channel()), **known)
    system.set_material([2.0, 5.0, 3.0], [0.3, -0.4, 0.0], *([0.3, 0.4, 0.5] for _ in further_parameters(law)))
    system.state.components[2].Set(ng.CF((0.2 * ng.x * ng.y - 0.1 * ng.y, 0.1 * ng.x**2 + 0.1 * ng.y)))
    system.values[:] += np.random.default_rng(1).uniform(-1e-4, 1e-4, len(system.values))
    return system


TERMS = {"neo_hookean": "_metric", "mooney_rivlin": "_strained", "fung": "_gradients"}


@pytest.mark.parametrize("name", LAWS)
def test_the_solid_is_that_of_the_forms_and_a_wrong_term_would_be_noticed(name, monkeypatch):
    system = layer(name)
    (solid,) = (part for part in system._parts if isinstance(part, solid_elements.SolidElements))
    reference = SymbolicPart(_solid_form(system))
    found, expected = solid.residual(system.state), reference.residual(system.state)
    assert np.abs(found - expected).max() < 1e-13 * np.abs(expected).max()
    found, expected = matrix(solid, system), matrix(reference, system)
    assert abs(found - expected).max() < 1e-13 * abs(expected).max()
    if name in TERMS:
        right = vars(solid_elements._AtPoints)[TERMS[name]].func
        monkeypatch.setattr(solid_elements._AtPoints, TERMS[name], property(lambda at: scaled(right(at), 1.01)))
        assert abs(matrix(solid, system) - expected).max() > 1e-6 * abs(expected).max()


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
