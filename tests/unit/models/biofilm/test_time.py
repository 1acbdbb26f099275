"""Runs through time: orders of convergence, uniform and shear flow on a moving mesh, the choice of steps."""

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any

import ngsolve as ng
import numpy as np
import pytest
from netgen.geom2d import SplineGeometry

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.biofilm import rates
from strandline.models.biofilm.cell import _boundaries
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import MESHES, mesh_flow_cell
from strandline.models.biofilm.inertia import FluidInertia
from strandline.models.biofilm.materials import deformation_gradient
from strandline.models.biofilm.moving import MovingSystem
from strandline.models.biofilm.newton import NewtonSettings
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.rates import Moment
from strandline.models.biofilm.system import BoundaryNames
from strandline.models.biofilm.transient import StepSettings, TimeCost, march

TIGHT = NewtonSettings(tolerance=1e-11, maximum_jacobians=8)
SECOND_ORDER = 1.9


def rectangle(length: float, height: float, region: str, size: float) -> Any:
    geometry = SplineGeometry()
    geometry.AddRectangle((0, 0), (length, height), bcs=("bottom", "right", "top", "left"))
    geometry.SetMaterial(1, region)
    return ng.Mesh(geometry.GenerateMesh(maxh=size))


@pytest.fixture(scope="module")
def coupled() -> MovingSystem:
    return coupled_system()


def coupled_system() -> MovingSystem:
    mesh = mesh_flow_cell(Outline(nodes=8).interface(), MESHES["rough"])
    system = MovingSystem(mesh, _boundaries(Channel()), solid_density=1.5, viscosity=0.01, density=1.0)
    system.set_material([40.0], [0.3])
    return system


def moving_at_random(system: MovingSystem, size: float) -> np.ndarray:
    """Set rates from two random moments; return random unknowns."""
    rng = np.random.default_rng(5)
    draws = rng.uniform(-size, size, (4, system.space.ndof))
    system.rates.set(0.3, [Moment(0.1, *draws[:2]), Moment(0.0, *draws[2:])])
    return rng.uniform(-size, size, len(system.free))


def run(system: MovingSystem, start: Moment, end: float, steps: int, prescribe: Callable[[float], None]) -> Moment:
    """Return the last moment of a run with equal steps."""
    settings = StepSettings(end / steps, corrector=TIGHT)
    weights = np.ones(len(system.free))
    *_, last = march(system, start, end, prescribe=prescribe, weights=weights, settings=settings)
    return last


def first_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plant backward Euler in every step."""
    original = rates.differences
    monkeypatch.setattr(rates, "differences", lambda times: (*original(times[:2]), *([0.0] * (len(times) - 2))))


# --- the equations


def test_jacobian_agrees_with_central_differences(coupled):
    """The error is a hundredth with a tenth of the step."""
    x, errors = moving_at_random(coupled, 1e-3), []
    direction = np.random.default_rng(2).uniform(-1e-3, 1e-3, len(x))
    jacobian = coupled.factorise(x)
    for h in (1e-2, 1e-3):
        difference = (coupled.residual(x + h * direction) - coupled.residual(x - h * direction)) / (2 * h)
        errors.append(float(np.abs(jacobian.solve(difference) - direction).max() / np.abs(direction).max()))
    assert errors[1] < 1e-3
    np.testing.assert_allclose(np.log10(errors[0] / errors[1]), 2.0, atol=0.1)


def test_fluid_inertia_agrees_with_its_form(coupled):
    """The elements against the same terms in NGSolve's language, in the rows of the velocity."""
    x = moving_at_random(coupled, 1e-2)
    coupled.set_unknowns(x)
    (v, _, d, *_), (w, *_) = coupled.space.TnT()
    rate = ng.GridFunction(coupled.space)
    rate.vec.FV().NumPy()[:] = coupled.rates.first(coupled.values)
    a, _, u, *_ = rate.components
    F = deformation_gradient(d)
    form = ng.BilinearForm(coupled.space)
    force = ng.Det(F) * a - ng.Grad(v) * (ng.Cof(F).trans * u)
    form += coupled.density * ng.InnerProduct(force, w) * ng.dx("fluid", bonus_intorder=4)
    expected = coupled.state.vec.CreateVector()
    form.Apply(coupled.state.vec, expected)
    part = next(part for part in coupled._parts if isinstance(part, FluidInertia))
    velocity = coupled.space.Range(0)
    rows = slice(velocity.start, velocity.stop)
    found = part.residual(coupled.state)[rows]
    np.testing.assert_allclose(found, expected.FV().NumPy()[rows], atol=1e-12 * np.abs(found).max())


def test_fluid_follows_the_interface(coupled):
    x = moving_at_random(coupled, 1e-3)
    coupled.set_unknowns(x)
    v = coupled.state.components[0]
    rate = ng.GridFunction(coupled.space)
    rate.vec.FV().NumPy()[:] = coupled.rates.first(coupled.values)
    gap = ng.Integrate(ng.Norm(v - rate.components[2]), coupled.mesh, definedon=coupled.mesh.Boundaries("interface"))
    size = ng.Integrate(ng.Norm(v), coupled.mesh, definedon=coupled.mesh.Boundaries("interface"))
    assert size > 0
    assert gap < 1e-12 * size


def test_cubic_elements_of_a_flow_are_refused():
    mesh = rectangle(1.0, 1.0, "fluid", 0.5)
    names = BoundaryNames(no_slip="top", inlet="left", fixed=".*")
    with pytest.raises(InvalidInput, match="quadratic"):
        MovingSystem(mesh, names, solid_density=1.0, viscosity=1.0, density=1.0, order=3, solids=())


# --- differences in time


def moments(times: list[float], power: int) -> list[Moment]:
    return [Moment(t, np.array([t**power]), np.array([power * t ** (power - 1.0)])) for t in times]


def test_differences_and_extrapolation_are_exact_for_parabolas_with_uneven_steps():
    times = np.array([1.7, 1.3, 0.2])
    weights = rates.differences(times.tolist())
    np.testing.assert_allclose(weights @ (times**2 - 3 * times + 2), 2 * 1.7 - 3, rtol=1e-13)
    np.testing.assert_allclose(rates.extrapolated(2.0, moments([1.7, 1.3, 0.2], 2)), [4.0], rtol=1e-13)
    np.testing.assert_allclose(rates.extrapolated(2.0, moments([1.7], 1)), [2.0], rtol=1e-13)


def test_local_error_is_exact_for_a_cubic():
    """For y' = 3t² from exact values, the estimate from y = t³ is the error of the step."""
    last, time = moments([1.7, 1.3, 0.2], 3), 2.0
    leading, *weights = rates.differences([time, 1.7, 1.3])
    result = (3 * time**2 - sum(w * m.values[0] for w, m in zip(weights, last[:2], strict=True))) / leading
    estimate = rates.share_of_error(time, last) * (result - rates.extrapolated(time, last)[0])
    np.testing.assert_allclose(estimate, result - time**3, rtol=1e-12)


# --- orders of convergence


@cache
def pipe() -> tuple[MovingSystem, Moment]:
    """A channel in which the first mode of the flow decays as exp(-t)."""
    mesh = rectangle(0.2, 1.0, "fluid", 0.1)
    names = BoundaryNames(no_slip="top|bottom", inlet="", fixed=".*", vertical_velocity_zero="left|right")
    system = MovingSystem(mesh, names, solid_density=1.0, viscosity=1 / np.pi**2, density=1.0, solids=())
    system.state.components[0].Set(ng.CF((ng.sin(np.pi * ng.y), 0)))
    projected = Moment(0.0, np.array(system.values), np.zeros(system.space.ndof))
    start = run(system, projected, 1e-7, 1, at_rest(system)).values  # free of divergence on the mesh, too
    return system, Moment(0.0, start, -start)


def at_rest(system: MovingSystem) -> Callable[[float], None]:
    """Return what prescribes zeros."""

    def prescribe(time: float) -> None:
        system.values[:] = 0.0

    return prescribe


def decay_error(steps: int) -> float:
    system, start = pipe()
    run(system, start, 1.0, steps, at_rest(system))
    return abs(float(system.state.components[0](system.mesh(0.1, 0.5))[0]) / np.exp(-1.0) - 1.0)


def test_decaying_flow_is_of_second_order_and_a_scheme_of_first_order_is_noticed(monkeypatch):
    errors = [decay_error(steps) for steps in (10, 20)]
    assert errors[-1] < 2e-3
    assert np.log2(errors[0] / errors[1]) > SECOND_ORDER
    first_order(monkeypatch)
    errors = [decay_error(steps) for steps in (10, 20)]
    assert np.log2(errors[0] / errors[1]) < 1.2


@cache
def bar() -> tuple[MovingSystem, Moment]:
    """A bar of length 1 whose first longitudinal mode has the period 4."""
    mesh = rectangle(1.0, 0.1, "solid", 0.1)
    names = BoundaryNames(no_slip="", inlet="", fixed="left")
    system = MovingSystem(mesh, names, solid_density=1.0, viscosity=1.0, density=1.0)
    system.set_material([1.0], [0.0])
    system.state.components[2].Set(ng.CF((AMPLITUDE * ng.sin(np.pi / 2 * ng.x), 0)))
    start = np.array(system.values)
    return system, Moment(0.0, start, np.zeros_like(start))


AMPLITUDE = 1e-5


def bar_error(steps: int) -> float:
    """Return the error after three quarters of a period, as a share of the amplitude."""
    system, start = bar()
    run(system, start, 3.0, steps, lambda time: None)
    return abs(float(system.state.components[2](system.mesh(1.0, 0.05))[0])) / AMPLITUDE


def test_oscillating_bar_is_of_second_order():
    errors = [bar_error(steps) for steps in (40, 80)]
    assert errors[-1] < 6e-3
    assert np.log2(errors[0] / errors[1]) > SECOND_ORDER


def swaying(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return displacement and pressure of a soft body when the flow over it has risen."""
    system = coupled_system()
    system.state.components[0].Set(ng.CF((6 * ng.y * (1 - ng.y), 0)), definedon=system.mesh.Boundaries("inlet"))
    inflow = np.array(system.values)

    def prescribe(time: float) -> None:
        system.values[:] = 0.2 * np.sin(np.pi / 4 * time) ** 4 * inflow

    rest = np.zeros(system.space.ndof)
    last = run(system, Moment(0.0, rest, rest), 1.6, steps, prescribe)
    d, p = system.space.Range(2), system.space.Range(1)
    return last.values[d.start : d.stop], last.values[p.start : p.stop]


def test_coupled_run_is_of_second_order():
    """Successive halvings of the step change the state by a quarter each, and little in the end."""
    runs = [swaying(steps) for steps in (12, 24, 48)]
    for k in (0, 1):
        changes = [float(np.linalg.norm(a[k] - b[k])) for a, b in pairwise(runs)]
        assert np.log2(changes[0] / changes[1]) > 1.85
        assert changes[1] < 0.01 * np.linalg.norm(runs[-1][k])


# --- geometric conservation


def error_on_moving_mesh(uniform: float, shear: float) -> float:
    """Return how far the flow (uniform + shear y, 0) is from itself after the mesh has moved on purpose.

    Velocity and displacement have the same shape functions, so the flow's coefficients are affine in the mesh's.
    """
    mesh = rectangle(1.0, 1.0, "fluid", 0.25)
    names = BoundaryNames(no_slip="", inlet="left|top|bottom", fixed=".*", vertical_velocity_zero="right")
    system = MovingSystem(mesh, names, solid_density=1.0, viscosity=0.01, density=1.0, solids=())
    v, _, d, *_ = (system.space.Range(k) for k in range(3))
    half = (v.stop - v.start) // 2
    velocity_x, displacement_y = slice(v.start, v.start + half), slice(d.start + half, d.stop)
    system.state.components[0].Set(ng.CF((uniform + shear * ng.y, 0)))
    at_rest = np.array(system.values)
    system.values[:] = 0.0
    push = ng.CF((0, 16 * (ng.x * (1 - ng.x)) ** 2))
    system.state.components[2].Set(push, definedon=mesh.Boundaries("bottom"))
    shape = np.array(system.values)

    def flow_on(displacement: np.ndarray) -> np.ndarray:
        values = at_rest + displacement
        values[velocity_x] += shear * displacement[displacement_y]
        return values

    def prescribe(time: float) -> None:
        system.values[:] = flow_on(0.2 * np.sin(2 * time) * shape)

    last = run(system, Moment(0.0, at_rest, np.zeros_like(at_rest)), 1.5, 7, prescribe)
    moved = np.zeros_like(at_rest)
    moved[d.start : d.stop] = last.values[d.start : d.stop]
    assert np.abs(moved).max() > 0.02
    return float(np.abs(last.values - flow_on(moved))[v.start : v.stop].max())


def test_uniform_and_shear_flow_stay_on_a_moving_mesh_to_rounding(monkeypatch):
    """With the mesh's velocity of a scheme of first order, a shear flow does not stay itself."""
    assert error_on_moving_mesh(uniform=1.0, shear=0.0) < 1e-12
    assert error_on_moving_mesh(uniform=0.5, shear=2.0) < 1e-11
    original = rates.Rates.first

    def lagging(self: rates.Rates, values: np.ndarray) -> np.ndarray:
        found = original(self, values)
        half = len(found) // 2
        found[half:] *= 0.9
        return found

    monkeypatch.setattr(rates.Rates, "first", lagging)
    assert error_on_moving_mesh(uniform=1.0, shear=0.0) < 1e-12
    assert error_on_moving_mesh(uniform=0.5, shear=2.0) > 1e-4


# --- the choice of steps


def adaptive(tolerance: float) -> tuple[float, TimeCost]:
    """Return the error of the decaying flow at the time 3, as a share of its start, and the cost."""
    system, start = pipe()
    cost = TimeCost()
    settings = StepSettings(1e-3, tolerance=tolerance, corrector=TIGHT)
    options = {"weights": np.ones(len(system.free)), "settings": settings, "stops": (0.5, 9.0), "cost": cost}
    times = [moment.time for moment in march(system, start, 3.0, prescribe=at_rest(system), **options)]
    assert 0.5 in times
    assert times[-1] == 3.0
    assert (np.diff(times)[1:] <= 2.41 * np.diff(times)[:-1]).all()
    return abs(float(system.state.components[0](system.mesh(0.1, 0.5))[0]) - np.exp(-3.0)), cost


def test_error_follows_the_tolerance():
    loose, tight = adaptive(1e-3), adaptive(1e-5)
    assert loose[0] < 20 * 1e-3
    assert tight[0] < 20 * 1e-5
    assert tight[0] < 0.2 * loose[0]
    assert loose[1].steps < 0.5 * tight[1].steps
    assert tight[1].jacobians < 0.8 * tight[1].steps


def test_a_step_that_is_too_long_is_repeated_until_steps_become_too_short():
    system, start = bar()
    cost, weights = TimeCost(), np.ones(len(system.free))
    settings = StepSettings(0.5, tolerance=1e-4, corrector=TIGHT)
    *_, last = march(system, start, 1.0, prescribe=lambda time: None, weights=weights, settings=settings, cost=cost)
    assert cost.rejected > 0
    assert abs(float(system.state.components[2](system.mesh(1.0, 0.05))[0]) / AMPLITUDE) < 0.02
    assert last.time == 1.0
    short = StepSettings(0.5, tolerance=1e-9, smallest=0.2)
    with pytest.raises(ForwardModelError, match="time_step: the steps became too short"):
        list(march(system, start, 1.0, prescribe=lambda time: None, weights=weights, settings=short))
