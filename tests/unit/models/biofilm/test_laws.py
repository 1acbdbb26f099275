"""Material laws and the elements that they are in: energies, derivatives, NGSolve's forms."""

import ngsolve as ng
import numpy as np
import pytest
from scipy import sparse
from tests.unit.models.biofilm.cells import coarse, moved, rough, rough_cell, sensitivity_error
from verification.validation.energies import ENERGIES, FURTHER, volume_piola
from verification.validation.fluid_forms import add_fluid
from verification.validation.generality import law_inputs

from strandline.models.biofilm.cells.cell import Setting, _boundaries
from strandline.models.biofilm.cells.fields import flow_fields
from strandline.models.biofilm.equations import fluid_elements, solid_elements
from strandline.models.biofilm.equations.forms import solid_form
from strandline.models.biofilm.equations.system import CoupledSystem, SymbolicPart
from strandline.models.biofilm.materials import LAWS, further_parameters
from strandline.models.biofilm.materials.isotropic import flaw
from strandline.models.biofilm.mesh.geometry import MESHES, Partition, mesh_flow_cell
from strandline.models.biofilm.mesh.outline import Channel, Outline

NEO_HOOKEAN = {"material": "neo_hookean"}
OPEN = {"channel": {"inlet": "right", "outlet": "traction_free"}}
EARLIER = (
    ({}, 400.0, [[0.045971970618460034, 0.014044939224772457], [0.030339027110091177, -0.006895709740690925]]),
    ({}, 270.0, [[0.06928335391643548, 0.018338161773347295], [0.044889174008244215, -0.011514735697337297]]),
    (NEO_HOOKEAN, 400.0, [[0.04674938375738169, 0.016808254025071634], [0.03172664578316531, -0.006363314447001334]]),
    (OPEN, 400.0, [[-0.030506441510156468, -0.005288268547500585], [-0.03985506553083962, 0.006367603196248184]]),
)
"""Options, E, and displacements of two nodes by revision 2 of the model before it had other laws, fluids or inflows."""
E, NU = 400.0, 0.3
LAME, SHEAR = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))


@pytest.mark.parametrize(("options", "E", "expected"), EARLIER)
def test_results_are_those_of_earlier_versions(options, E, expected):
    """In mm, but for the quadrature of the fluid, which has changed since."""
    found = moved(coarse(**options), {"E": E, "nu": 0.3, "V_in": 100.0})[[20, 45]]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize(("law", "nu"), [("saint_venant_kirchhoff", 0.3), ("yeoh", 0.49), ("fung", -0.4)])
def test_sensitivities_by_each_parameter_of_a_law(law, nu):
    model, inputs = rough(material=law), law_inputs(law) | {"nu": nu}
    assert [item.name for item in model.inputs] == list(inputs)
    assert sensitivity_error(model, inputs) < 1e-6


def piola(law, F):
    """Return the derivative of the energy by F, by complex steps, and of that of the volume; and its pressure."""
    P, J = np.empty((3, 3)), np.linalg.det(F)
    pressure = LAME * (0.5 * np.trace(F.T @ F - np.eye(3)) if law == "saint_venant_kirchhoff" else np.log(J))
    for i, j in np.ndindex(3, 3):
        moved = F.astype(complex)
        moved[i, j] += 1e-30j
        C, log = moved.T @ moved, np.log(np.linalg.det(moved))
        first, second = np.trace(C), 0.5 * (np.trace(C) ** 2 - np.trace(C @ C))
        P[i, j] = ENERGIES[law](SHEAR, first, second, log, np.exp, *FURTHER[law]).imag / 1e-30
    return P + volume_piola(law, F, pressure), pressure


@pytest.mark.parametrize("law", LAWS)
def test_a_law_is_right_at_rest_and_its_cauchy_stress_is_that_of_its_energy(law):
    assert flaw(LAWS[law]) is None
    F = np.array([[1.1, 0.25, 0.0], [-0.05, 0.85, 0.0], [0.0, 0.0, 1.0]])
    P, pressure = piola(law, F)
    expected = P @ F.T / np.linalg.det(F)
    cell = rough_cell(law)
    cell.system.set_material([E / 10], [NU], *([value] for value in FURTHER[law]))
    cell.system.state.components[2].Set(ng.CF((0.1 * ng.x + 0.25 * ng.y, -0.05 * ng.x - 0.15 * ng.y)))
    cell.system.state.components[3].Set(ng.CF(pressure / 10), definedon=cell.mesh.Materials("solid"))
    fields = flow_fields(cell.system, cell.part)
    solid = fields.stress[fields.cell_part > 0]
    components = [expected[0, 0], expected[1, 1], expected[0, 1], expected[2, 2]]
    np.testing.assert_allclose(solid, np.tile(components, (len(solid), 1)), rtol=1e-9, atol=1e-9 * E)
    assert not fields.stress[fields.cell_part == 0].any()
    assert abs(expected[0, 1] - P[0, 1]) > 0.01 * E  # another stress would show


@pytest.fixture(scope="module")
def system():
    """A system far from rest, in another fluid than water."""
    cell = rough_cell("neo_hookean")
    cell.solve(Setting([200.0], [0.3], 100.0))
    cell.system.viscosity.Set(0.037)
    cell.system.density.Set(1.7)
    return cell.system


def errors(part, reference, system, rows=np.s_[:]):
    """Return the errors of residual and Jacobian as shares of the largest entries."""
    for of in (lambda one: one.residual(system.state), lambda one: matrix(one, system)):
        found, expected = of(part)[rows], of(reference)[rows]
        yield abs(found - expected).max() / abs(expected).max()


def matrix(part, system):
    entries = part.jacobian(system.state)
    return sparse.coo_matrix((entries, part.places()), shape=(system.space.ndof,) * 2).tocsr()


def test_the_fluid_is_that_of_the_forms_and_a_wrong_term_would_be_noticed(system, monkeypatch):
    """In the balances of momentum and mass: to rounding where the deformation is affine, for both quadratures."""
    form, fluid, rows = ng.BilinearForm(system.space), system._parts[-1], np.flatnonzero(~system.is_motion)
    add_fluid(form, system)
    reference, bent = SymbolicPart(form), np.array(system.values)
    system.values[:] = np.random.default_rng(1).uniform(-1.0, 1.0, len(bent))
    system.state.components[2].Set(ng.CF((0.3 * ng.x - 0.4 * ng.y, 0.5 * ng.x + 0.2 * ng.y)))
    assert max(errors(fluid, reference, system, rows)) < 1e-12
    system.values[:] = bent
    assert next(errors(fluid, reference, system, rows)) < 2e-6
    right = fluid_elements._Fields
    for name in ("metric", "pulled", "viscous"):

        def wrong(*given, name=name):
            fields = right(*given)
            getattr(fields, name)[0][1][:] *= 1.01
            return fields

        monkeypatch.setattr(fluid_elements, "_Fields", wrong)
        assert list(errors(fluid, reference, system, rows))[1] > 1e-6


def layer(name):
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
    reference = SymbolicPart(solid_form(system))
    assert max(errors(solid, reference, system)) < 1e-13
    if name in TERMS:
        right = vars(solid_elements._AtPoints)[TERMS[name]].func
        monkeypatch.setattr(solid_elements._AtPoints, TERMS[name], property(lambda at: scaled(right(at), 1.01)))
        assert max(errors(solid, reference, system)) > 1e-6


def scaled(tensor, factor):
    """Return nested lists of arrays times a factor."""
    return [scaled(part, factor) for part in tensor] if isinstance(tensor, list) else factor * tensor
