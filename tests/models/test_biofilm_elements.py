"""The fluid's elements against NGSolve's forms and against finite differences; the matrix that the parts add up to."""

import ngsolve as ng
import numpy as np
import pytest
import scipy.sparse as sparse

from strandline.models.biofilm import fluid_elements
from strandline.models.biofilm.assembly import SymbolicPart, product
from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition
from strandline.models.biofilm.system import CoupledSystem, _add_fluid


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
    return np.flatnonzero(~system._is_motion)


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
