"""Runs through time: orders of convergence, uniform and shear flow on a moving mesh, the choice of steps."""

import ngsolve as ng
import numpy as np
import pytest
from netgen.geom2d import SplineGeometry

from strandline.models.biofilm.cells.cell import _boundaries
from strandline.models.biofilm.cells.transient import March, StepSettings
from strandline.models.biofilm.equations import moving
from strandline.models.biofilm.equations.moving import FluidInertia, Moment, MovingSystem
from strandline.models.biofilm.equations.system import BoundaryNames
from strandline.models.biofilm.materials import deformation_gradient
from strandline.models.biofilm.mesh.geometry import MESHES, mesh_flow_cell
from strandline.models.biofilm.mesh.outline import Channel, Outline
from strandline.models.biofilm.newton import NewtonSettings

TIGHT = NewtonSettings(tolerance=1e-11, maximum_jacobians=8)
AMPLITUDE = 1e-5


def rectangle(length, height, region, size):
    geometry = SplineGeometry()
    geometry.AddRectangle((0, 0), (length, height), bcs=("bottom", "right", "top", "left"))
    geometry.SetMaterial(1, region)
    return ng.Mesh(geometry.GenerateMesh(maxh=size))


@pytest.fixture(scope="module")
def coupled():
    mesh = mesh_flow_cell(Outline(nodes=8).interface(), MESHES["rough"])
    system = MovingSystem(mesh, _boundaries(Channel()), solid_density=1.5, viscosity=0.01, density=1.0)
    system.set_material([40.0], [0.3])
    return system


def moving_at_random(system, size):
    """Set rates from two random moments; return random unknowns."""
    rng = np.random.default_rng(5)
    draws = rng.uniform(-size, size, (4, system.space.ndof))
    system.rates.set(0.3, [Moment(0.1, *draws[:2]), Moment(0.0, *draws[2:])])
    return rng.uniform(-size, size, len(system.free))


def marched(system, start, end, settings, prescribe=lambda time: None, **more):
    weights = np.ones(len(system.free))
    march = March(system, start, end, prescribe, weights, settings, **more)
    return list(march), march


def run(system, start, end, steps, *prescribe):
    """Return the last moment of a run with equal steps."""
    return marched(system, start, end, StepSettings(end / steps, corrector=TIGHT), *prescribe)[0][-1]


def part(system, k):
    """Return where velocity (0), pressure (1) or displacement (2) is among the values."""
    return slice(system.space.Range(k).start, system.space.Range(k).stop)


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


@pytest.fixture(scope="module")
def pipe():
    """A channel in which the first mode of the flow decays as exp(-t)."""
    mesh = rectangle(0.2, 1.0, "fluid", 0.1)
    names = BoundaryNames(no_slip="top|bottom", inlet="", fixed=".*", vertical_velocity_zero="left|right")
    system = MovingSystem(mesh, names, solid_density=1.0, viscosity=1 / np.pi**2, density=1.0, solids=())
    system.state.components[0].Set(ng.CF((ng.sin(np.pi * ng.y), 0)))
    projected = Moment(0.0, np.array(system.values), np.zeros(system.space.ndof))
    start = run(system, projected, 1e-7, 1, zeros(system)).values  # free of divergence on the mesh, too
    return system, Moment(0.0, start, -start)


def zeros(system):
    """Return what prescribes zeros."""
    return lambda time: system.values.__setitem__(slice(None), 0.0)


def decay_errors(system, start):
    for steps in (10, 20):
        run(system, start, 1.0, steps, zeros(system))
        yield abs(float(system.state.components[0](system.mesh(0.1, 0.5))[0]) / np.exp(-1.0) - 1.0)


def test_decaying_flow_is_of_second_order_and_backward_euler_is_noticed(pipe, monkeypatch):
    coarse, fine = decay_errors(*pipe)
    assert fine < 2e-3
    assert np.log2(coarse / fine) > 1.9
    original = moving.differences
    monkeypatch.setattr(moving, "differences", lambda times: (*original(times[:2]), *([0.0] * (len(times) - 2))))
    coarse, fine = decay_errors(*pipe)
    assert np.log2(coarse / fine) < 1.2


@pytest.fixture(scope="module")
def bar():
    """A bar of length 1 whose first longitudinal mode has the period 4."""
    mesh = rectangle(1.0, 0.1, "solid", 0.1)
    names = BoundaryNames(no_slip="", inlet="", fixed="left")
    system = MovingSystem(mesh, names, solid_density=1.0, viscosity=1.0, density=1.0)
    system.set_material([1.0], [0.0])
    system.state.components[2].Set(ng.CF((AMPLITUDE * ng.sin(np.pi / 2 * ng.x), 0)))
    start = np.array(system.values)
    return system, Moment(0.0, start, np.zeros_like(start))


def of_its_amplitude(system):
    """Return how far the end of the bar is from the middle of its motion, as a share of the amplitude."""
    return abs(float(system.state.components[2](system.mesh(1.0, 0.05))[0])) / AMPLITUDE


def test_oscillating_bar_is_of_second_order(bar):
    """After three quarters of a period the end is in the middle."""
    (system, start), errors = bar, []
    for steps in (40, 80):
        run(system, start, 3.0, steps)
        errors.append(of_its_amplitude(system))
    assert errors[-1] < 6e-3
    assert np.log2(errors[0] / errors[1]) > 1.9


def error_on_moving_mesh(uniform, shear):
    """Return how far the flow (uniform + shear y, 0) is from itself after the mesh has moved on purpose.

    Velocity and displacement have the same shape functions, so the flow's coefficients are affine in the mesh's.
    """
    mesh = rectangle(1.0, 1.0, "fluid", 0.25)
    names = BoundaryNames(no_slip="", inlet="left|top|bottom", fixed=".*", vertical_velocity_zero="right")
    system = MovingSystem(mesh, names, solid_density=1.0, viscosity=0.01, density=1.0, solids=())
    v, d = part(system, 0), part(system, 2)
    half = (v.stop - v.start) // 2
    velocity_x, displacement_y = slice(v.start, v.start + half), slice(d.start + half, d.stop)
    system.state.components[0].Set(ng.CF((uniform + shear * ng.y, 0)))
    at_rest = np.array(system.values)
    system.values[:] = 0.0
    push = ng.CF((0, 16 * (ng.x * (1 - ng.x)) ** 2))
    system.state.components[2].Set(push, definedon=mesh.Boundaries("bottom"))
    shape = np.array(system.values)

    def flow_on(displacement):
        values = at_rest + displacement
        values[velocity_x] += shear * displacement[displacement_y]
        return values

    def prescribe(time):
        system.values[:] = flow_on(0.2 * np.sin(2 * time) * shape)

    last = run(system, Moment(0.0, at_rest, np.zeros_like(at_rest)), 1.5, 7, prescribe)
    moved = np.zeros_like(at_rest)
    moved[d] = last.values[d]
    assert np.abs(moved).max() > 0.02
    return float(np.abs(last.values - flow_on(moved))[v].max())


def test_uniform_and_shear_flow_stay_on_a_moving_mesh_to_rounding(monkeypatch):
    """With the mesh's velocity of a scheme of first order, a shear flow does not stay itself."""
    assert error_on_moving_mesh(uniform=1.0, shear=0.0) < 1e-12
    assert error_on_moving_mesh(uniform=0.5, shear=2.0) < 1e-11
    original = moving.Rates.first

    def lagging(self, values):
        found = original(self, values)
        found[len(found) // 2 :] *= 0.9
        return found

    monkeypatch.setattr(moving.Rates, "first", lagging)
    assert error_on_moving_mesh(uniform=1.0, shear=0.0) < 1e-12
    assert error_on_moving_mesh(uniform=0.5, shear=2.0) > 1e-4


def test_the_error_of_the_decaying_flow_follows_the_tolerance(pipe):
    (system, start), found = pipe, {}
    for tolerance in (1e-3, 1e-5):
        settings = StepSettings(1e-3, tolerance=tolerance, corrector=TIGHT)
        moments, cost = marched(system, start, 3.0, settings, zeros(system), stops=(0.5, 9.0))
        times = [moment.time for moment in moments]
        assert 0.5 in times
        assert times[-1] == 3.0
        found[tolerance] = abs(float(system.state.components[0](system.mesh(0.1, 0.5))[0]) - np.exp(-3.0)), cost
        assert found[tolerance][0] < 20 * tolerance
    loose, tight = found.values()
    assert tight[0] < 0.2 * loose[0]
    assert loose[1].steps < 0.5 * tight[1].steps
    assert tight[1].jacobians < 0.8 * tight[1].steps


def test_a_step_that_is_too_long_is_repeated(bar):
    system, start = bar
    _, march = marched(system, start, 1.0, StepSettings(0.5, tolerance=1e-4, corrector=TIGHT))
    assert march.rejected > 0
    assert of_its_amplitude(system) < 0.02


def rate_of(system):
    rate = ng.GridFunction(system.space)
    rate.vec.FV().NumPy()[:] = system.rates.first(system.values)
    return rate


def test_fluid_inertia_agrees_with_its_form_and_the_fluid_follows_the_interface(coupled):
    """The elements against the same terms in NGSolve's language, in the rows of the velocity."""
    coupled.set_unknowns(moving_at_random(coupled, 1e-2))
    (v, _, d, *_), (w, *_) = coupled.space.TnT()
    a, _, u, *_ = rate_of(coupled).components
    F = deformation_gradient(d)
    form = ng.BilinearForm(coupled.space)
    force = ng.Det(F) * a - ng.Grad(v) * (ng.Cof(F).trans * u)
    form += coupled.density * ng.InnerProduct(force, w) * ng.dx("fluid", bonus_intorder=4)
    expected = coupled.state.vec.CreateVector()
    form.Apply(coupled.state.vec, expected)
    inertia = next(one for one in coupled._parts if isinstance(one, FluidInertia))
    rows = part(coupled, 0)
    found = inertia.residual(coupled.state)[rows]
    np.testing.assert_allclose(found, expected.FV().NumPy()[rows], atol=1e-12 * np.abs(found).max())
    velocity, on = coupled.state.components[0], coupled.mesh.Boundaries("interface")
    gap, size = (ng.Integrate(ng.Norm(field), coupled.mesh, definedon=on) for field in (velocity - u, velocity))
    assert size > 0
    assert gap < 1e-12 * size
