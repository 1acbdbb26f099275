"""The biofilm model: physics, determinism, failures."""

import subprocess
import sys

import numpy as np
import pytest

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import CONTROL_POINTS, NODES, Outline

REFERENCE = Outline().interface()
TRUTH = {"E": 400.0, "nu": 0.3, "V_in": 100.0}


@pytest.fixture(scope="module")
def model() -> Biofilm:
    return Biofilm(mesh="coarse")


def test_outline_has_the_figures_of_the_study():
    reference = REFERENCE
    assert len(reference.points) == NODES == 66
    np.testing.assert_allclose(reference.lengths.sum(), 1.447, atol=5e-4)
    np.testing.assert_allclose((reference.lengths**2).mean(), 0.0005, rtol=0.02)
    assert np.ptp(reference.lengths) < 2e-3 * reference.lengths.mean()  # chords of equal arcs
    np.testing.assert_array_equal(reference.points[[0, -1]], np.array(CONTROL_POINTS)[[0, -1]])
    reference.require_simple()


def test_it_bends_downstream_by_the_displacement_of_the_study():
    result = Biofilm()(TRUTH)
    moved = result.interface.points - REFERENCE.points
    largest = np.linalg.norm(moved, axis=1).max()
    np.testing.assert_allclose(largest, 0.0495, rtol=0.01)
    np.testing.assert_allclose(result.diagnostics["max_displacement"], largest)
    assert moved[:, 0].mean() > 0.01
    np.testing.assert_allclose(moved[[0, -1]], 0.0, atol=1e-15)
    assert 0 < result.diagnostics["min_J_solid"] < 1


@pytest.mark.long
def test_default_mesh_is_converged_against_the_fine_one():
    default, fine = (Biofilm(mesh=name)(TRUTH).interface.points for name in ("default", "fine"))
    error = np.linalg.norm(default - fine, axis=1).max()
    assert error < 5e-5  # 0.05 µm, 0.1 % of the largest displacement
    coarse = Biofilm(mesh="coarse")(TRUTH).interface.points
    assert np.linalg.norm(coarse - fine, axis=1).max() > 3 * error


@pytest.mark.parametrize(("E", "nu"), [(400.0, 0.3), (130.0, -0.54)])
def test_coarse_mesh_is_as_accurate_as_it_is_said_to_be(E, nu):
    inputs = {"E": E, "nu": nu, "V_in": 100.0}
    coarse, default = (Biofilm(mesh=name)(inputs).interface.points for name in ("coarse", "default"))
    assert np.linalg.norm(coarse - default, axis=1).max() < 3e-4  # mm; the default mesh's own error is below 1e-4


def test_same_inputs_same_bits_whatever_ran_before(model):
    first = model(TRUTH).interface.points.tobytes()
    model({"E": 250.0, "nu": -0.5, "V_in": 40.0})
    with pytest.raises(ForwardModelError):
        model({"E": 60.0, "nu": 0.3, "V_in": 100.0})
    assert model(TRUTH).interface.points.tobytes() == first


def test_same_inputs_same_bits_in_another_process(model):
    code = (
        "from strandline.models.biofilm.model import Biofilm;"
        f"print(Biofilm(mesh='coarse')({TRUTH!r}).interface.points.tobytes().hex())"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip().splitlines()[-1] == model(TRUTH).interface.points.tobytes().hex()


def test_no_flow_no_displacement(model):
    still = model({**TRUTH, "V_in": 0.0})
    np.testing.assert_array_equal(still.interface.points, REFERENCE.points)


def test_stiff_limit_is_linear_in_compliance(model):
    """For small deformation the displacement is proportional to 1/E."""
    shapes = [model({**TRUTH, "E": E}).interface.points - REFERENCE.points for E in (1e6, 2e6)]
    np.testing.assert_allclose(shapes[0], 2 * shapes[1], rtol=2e-3, atol=1e-9)


@pytest.mark.parametrize("nu", [0.4999, 0.5, 0.0, -0.9])
def test_all_poisson_ratios_are_solved(model, nu):
    result = model({**TRUTH, "nu": nu})
    assert result.diagnostics["newton_jacobians"] <= 6
    assert result.diagnostics["max_displacement"] > 1e-3


def test_incompressible_limit_is_continuous(model):
    near, limit = (model({**TRUTH, "nu": nu}).interface.points for nu in (0.49999, 0.5))
    np.testing.assert_allclose(near, limit, atol=2e-6)


def test_too_soft_a_sample_is_a_typed_failure_at_bounded_cost(model):
    with pytest.raises(ForwardModelError) as caught:
        model({"E": 100.0, "nu": 0.3, "V_in": 100.0})
    assert caught.value.kind in {"limit_point", "continuation_stalled"}
    assert caught.value.evidence["jacobians"] <= model.failure_budget + 1
    assert 0 < caught.value.evidence["load_reached"] < 100


def test_without_a_budget_the_failure_is_followed_around_its_limit_point():
    with pytest.raises(ForwardModelError, match="limit_point") as caught:
        Biofilm(mesh="coarse", failure_budget=0)({"E": 100.0, "nu": 0.3, "V_in": 100.0})
    assert 50 < caught.value.evidence["limit_load"] < 70
    assert caught.value.evidence["jacobians"] > Biofilm().failure_budget


@pytest.mark.parametrize("budget", [1, 2, -5, True])
def test_budget_that_is_none_is_refused(budget):
    with pytest.raises(InvalidInput, match="failure_budget"):
        Biofilm.from_options(failure_budget=budget)


def test_fields_for_pictures_are_consistent_with_the_interface(model):
    fields = model.fields(TRUTH)
    largest = np.linalg.norm(fields.displacement, axis=1).max()
    assert largest >= model(TRUTH).diagnostics["max_displacement"] - 1e-12
    assert fields.triangles.max() < len(fields.points)
    inlet = np.isclose(fields.points[:, 0], 0.0)
    y = fields.points[inlet, 1]
    np.testing.assert_allclose(fields.velocity[inlet, 0], 600 * y * (1 - y), atol=1e-9)
    corners = fields.points[fields.triangles]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0).all()


def test_fields_are_those_of_the_condition_asked_for():
    two = Biofilm.from_options(mesh="coarse", inflow_rates={"slow": 40, "fast": 80})
    solid = {"E": 400.0, "nu": 0.3}
    peaks = {name: np.abs(two.fields(solid, name).velocity).max() for name in two.conditions}
    assert 1.8 < peaks["fast"] / peaks["slow"] < 2.2
    assert np.abs(two.fields(solid).velocity).max() == pytest.approx(peaks["fast"], rel=1e-9)


def test_unknown_mesh_is_refused():
    with pytest.raises(InvalidInput, match="coarse, default, fine"):
        Biofilm(mesh="corse")


def test_fingerprint_tells_meshes_apart():
    assert Biofilm(mesh="coarse").fingerprint != Biofilm().fingerprint
