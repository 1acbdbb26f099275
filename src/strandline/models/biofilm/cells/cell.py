"""A flow cell with its specimen, discretised: solve it, read the interface, differentiate it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float, Int

from strandline.foundations import ForwardModelError
from strandline.interface import Interface
from strandline.models.biofilm import newton
from strandline.models.biofilm.cells.fields import StrainProbe, jacobian_bound
from strandline.models.biofilm.cells.steady import steady_state
from strandline.models.biofilm.equations import flow
from strandline.models.biofilm.equations.memory import Branch
from strandline.models.biofilm.equations.system import BoundaryNames, CoupledSystem
from strandline.models.biofilm.linear import Factorisation, Vector
from strandline.models.biofilm.materials import Law, further_parameters, typical_value
from strandline.models.biofilm.mesh.geometry import MeshSize, Partition, mesh_flow_cell, subdivide
from strandline.models.biofilm.mesh.outline import Channel, Pairs

_SCALES = {"Pa": flow.STRESS_SCALE, "1": 1.0}
NORM_WEIGHTS = (1.0, 0.1, 10.0, 0.1)
"""Newton corrections of v, p, d, pₛ are weighted so that all count alike."""
BALANCE = 1e-6
"""Largest residual of a solution, as a share of the largest reaction."""
ROUNDING = 2e-17
"""And what rounding of its stresses may leave in a stiff solid, per scaled E; a layer of 1e10 Pa has a quarter."""

Points = Float[np.ndarray, "point 2"]


@dataclass(frozen=True, eq=False)
class Solution:
    """A steady state: scaled unknowns, displacements of the interface's nodes, mm, and figures for a run's record.

    `bounds` are those of `FlowCell.check`; so many `jacobians` were factorised, on the load path too.
    """

    unknowns: Vector
    displacement: Points
    bounds: Mapping[str, float]
    jacobians: int
    figures: Mapping[str, float] = field(default_factory=dict)

    def diagnostics(self) -> dict[str, float]:
        """Return the figures that go into a run's record; displacements in mm."""
        largest = float(np.linalg.norm(self.displacement, axis=1).max())
        return {"max_displacement": largest, **self.bounds, "newton_jacobians": float(self.jacobians), **self.figures}


@dataclass(frozen=True)
class Setting:
    """What a run of a flow cell is made with.

    Young's modulus, Pa, Poisson's ratio and each `further` parameter of the law have a value for each part; `rate` is
    the inflow rate V_in, mm²/s, or the pressure drop, Pa. No quantity of the fluid is unknown. A solid that creeps has
    `branches`; Young's modulus is that of the relaxed solid. With a `profile`, Young's modulus at each vertex of the
    solid is so many times that of the part, and linear between them.
    """

    young: Sequence[float]
    poisson: Sequence[float]
    rate: float
    further: tuple[Sequence[float], ...] = ()
    fluid: flow.Fluid = flow.WATER
    branches: tuple[Branch, ...] = ()
    profile: Float[np.ndarray, " vertex"] | None = None

    @property
    def stiffness(self) -> float:
        """Shear modulus, the geometric mean over the parts, Pa."""
        moduli = np.array(self.young) / (2.0 * (1.0 + np.array(self.poisson)))
        return float(np.exp(np.log(moduli).mean()))


class FlowCell:
    """Mesh, spaces and forms of one geometry and material law; everything scaled inside, physical outside."""

    def __init__(
        self,
        outline: Interface,
        size: MeshSize,
        *,
        channel: Channel,
        partition: Partition,
        law: Law,
        fluid: flow.Fluid = flow.WATER,
        inflow: str | Pairs = flow.PARABOLA,
        clamped: Pairs = (),
    ) -> None:
        _, self.parts = subdivide(outline, channel, partition)
        self._material_scales = (flow.STRESS_SCALE, 1.0, *(_SCALES[item.unit] for item in further_parameters(law)))
        self.outline, self.channel = outline, channel
        self.mesh = mesh_flow_cell(outline, size, channel, partition, clamped)
        number = {"fluid": 0} | {name: k for k, name in enumerate(self.parts, 1)}
        self.part = np.array([number[element.mat] for element in self.mesh.Elements(ng.VOL)])
        self.is_solid = self.part > 0
        self.fluid, self.flow = fluid.at({}), flow.Flow(channel, inflow, fluid)
        viscosity, density, *_ = self.fluid.values()
        boundaries = _boundaries(channel, pressure_driven=self.flow.pressure is not None, sliding=bool(clamped))
        scaled = {"viscosity": viscosity / flow.VISCOSITY_SCALE, "density": density / flow.DENSITY_SCALE}
        solids, loads = tuple(self.parts), self.flow.loads
        self.system = self.coupled(self.mesh, boundaries, **scaled, law=law, solids=solids, loads=loads)
        self.vertices = _vertices_at(self.mesh, outline)
        self.weights = np.empty(len(self.system.free))
        for component in range(3 + len(self.parts)):
            self.weights[self.system.block(component)] = NORM_WEIGHTS[min(component, 3)]
        if self.flow.pressure is None:
            flow.prescribe(self.system, inflow, channel, bottom=flow.inlet_bottom(outline, channel))
        self.inflow = np.array(self.system.values)
        self.strains = StrainProbe(self.system)
        self.largest_compression = self.strains.largest_compression
        self.largest_strain, self.critical_strain = self.strains.largest, self.strains.critical
        self.rigid_flow = self._flow_past_rigid_body()

    def coupled(self, *arguments: Any, **options: Any) -> CoupledSystem:
        """Return the system of equations, made from the arguments of `CoupledSystem`."""
        return CoupledSystem(*arguments, **options)

    def solve(self, setting: Setting, budget: int = 0) -> Solution:
        """Return the steady state; the search is given up after a budget of Jacobians, if it is not 0.

        Raises ForwardModelError: ``limit_point``, ``continuation_stalled``, ``newton_maxit``, ``newton_stalled``,
        ``inverted_elements``, ``unbalanced``, ``nonfinite_residual`` or ``linear_solve``; loads in the evidence are
        inflow rates in mm²/s.
        """
        load = self.set(setting)
        try:
            found = steady_state(self, load, budget=budget)
            return self.accepted(found.x, load, found.jacobians)
        except ForwardModelError as error:
            raise self.in_physical_units(error) from error

    def accepted(self, x: Vector, load: float, jacobians: int) -> Solution:
        """Return a root of the equations as a solution; fails as ``inverted_elements`` or ``unbalanced``."""
        bounds = self.check(x)
        self._check_balance(x, load)
        return Solution(x, self.displacement, bounds, jacobians)

    def hold(self, setting: Setting) -> None:
        """Set everything as in a run, with its loads, so that its solution can be differentiated."""
        self._apply(self.set(setting))

    def set(self, setting: Setting) -> float:
        """Set the material, the fluid and the loads; return the load at which the rate is reached."""
        values = zip(self._material_scales, (setting.young, setting.poisson, *setting.further), strict=True)
        self.system.set_material(*([value / scale for value in given] for scale, given in values))
        if self.system.solid is not None:
            self.system.set_profile(setting.profile)
        return self.set_loads(setting.rate, setting.fluid)

    @property
    def vertices_of_solid(self) -> tuple[Points, Float[np.ndarray, " vertex"]]:
        """The vertices of the solid, mm, in the order of a profile, and a third of the area of the triangles around."""
        assert self.system.solid is not None
        points = np.array([vertex.point for vertex in self.mesh.vertices])[self.system.solid.vertices]
        return points, self.system.solid.areas

    @property
    def displacement(self) -> Points:
        """Displacements of the interface's nodes (point, 2) at the current state, mm."""
        return self._interface_values(np.array(self.system.values))

    def in_physical_units(self, error: ForwardModelError) -> ForwardModelError:
        """Return a failure with loads as inflow rates or pressure drops, and a message that states at which."""
        evidence, drive = dict(error.evidence), self.flow.drive
        for key in ("load_reached", "limit_load", "load_slope"):
            if key in evidence:
                evidence[key] *= self._load_scale
        message, unit = error.message, drive.unit.replace("^2", "²")
        if error.kind == "limit_point":
            strain, x, y = (evidence[f"critical_{name}"] for name in ("strain", "x", "y"))
            limit = f"{drive.name} = {evidence['limit_load']:.4g} {unit}"
            where = f"at a strain of {strain:.2f} at ({x:.3f}, {y:.3f}) mm"
            message = f"no steady state beyond {limit}: the load path turns back {where}"
        elif "load_reached" in evidence:
            message = f"{message}, at {drive.name} = {evidence['load_reached']:.4g} {unit}"
        return ForwardModelError(error.kind, message, evidence)

    def undeformed(self, load: float) -> Vector:
        """Return the flow past a rigid body, scaled: the first guess."""
        return np.asarray(load * self._drive * self.rigid_flow)

    def residual(self, x: Vector, load: float) -> Vector:
        self._apply(load)
        return self.system.residual(x)

    def factorise(self, x: Vector, load: float, *, own_analysis: bool = False) -> Factorisation:
        """Return the factorised Jacobian at an inflow of `load`; one that is kept has its own analysis."""
        self._apply(load)
        return self.system.factorise(x, own_analysis=own_analysis)

    def by_load(self) -> Vector:
        """Return the derivative of the residual with respect to the load, at the last factorised state."""
        by_inflow = self.system.by_prescribed(self._drive * self.inflow)
        scaled = zip(self.flow.loads, self._loads, strict=True)
        return np.asarray(sum((full * self.system.by_parameter(load.parameter) for load, full in scaled), by_inflow))

    def check(self, x: Vector) -> Mapping[str, float]:
        """Return lower bounds of J in fluid and solid; a run with one of 0 or below fails as ``inverted_elements``."""
        self.system.set_unknowns(x)
        fluid, solid = jacobian_bound(self.mesh, self.system.state.components[2], self.is_solid)
        bounds = {"min_J_fluid": fluid, "min_J_solid": solid}
        if min(fluid, solid) <= 0:
            message = f"elements are inverted: J is bounded by {fluid:.3g} (fluid), {solid:.3g} (solid)"
            raise ForwardModelError("inverted_elements", message, bounds)
        return bounds

    def sensitivities(self, solution: Solution, fluid: Sequence[str] = ()) -> list[Float[np.ndarray, "point 2 *of"]]:
        """Return d(interface)/dE of each part [mm/Pa], d/dν of each part [mm], …, d/dV_in [mm per mm²/s].

        The derivatives by the law's further parameters follow those by ν, those by the quantities of the `fluid` that
        are named, viscosity for example, follow V_in.

        With a profile, d(interface)/dE has a further axis for the solid's vertices.

        One factorisation at the solution that `solve` has just returned, and one back-substitution for each input;
        with a profile, one for each coordinate of the interface.
        """
        system = self.system
        if system.has_profile:
            units = np.eye(2 * len(self.vertices)).reshape(-1, len(self.vertices), 2)
            return [one.reshape(-1, 2, *one.shape[1:]) for one in self.pulled_back(solution, units, fluid)]
        jacobian = system.factorise(solution.unknowns)
        derivatives = [unit * jacobian.solve(-by_input) for unit, by_input in self._by_inputs(fluid)]
        values = np.zeros((len(derivatives), len(system.values)))
        values[:, system.free] = derivatives
        return [self._interface_values(row) for row in values]

    def pulled_back(
        self, solution: Solution, factors: Float[np.ndarray, "factor point 2"], fluid: Sequence[str] = ()
    ) -> list[Float[np.ndarray, "factor *of"]]:
        """Return the sums of some factors times the `sensitivities`, at a solution of the present setting.

        One factorisation, and one back-substitution for each set of factors, however many inputs there are.
        """
        system, rows = self.system, np.zeros((len(factors), len(self.system.values)))
        jacobian = system.factorise(solution.unknowns)
        rows[:, self._interface_rows] = -factors.transpose(0, 2, 1).reshape(len(factors), -1)
        tests = jacobian.solve_transposed(rows[:, system.free])
        found = [unit * (tests @ by_input) for unit, by_input in self._by_inputs(fluid)]
        if system.has_profile:
            found.insert(0, system.by_profile(tests) / (self._material_scales[0] * system.material[0][0].Get()))
        return found

    def _by_inputs(self, fluid: Sequence[str]) -> list[tuple[float, Vector]]:
        """Return d(residual)/d(input) in the order of `sensitivities`, without E if it has a profile, at the last
        factorised state; each is to be multiplied by a number."""
        system, first = self.system, int(self.system.has_profile)
        groups = zip(self._material_scales[first:], system.material[first:], strict=True)
        found = [(1.0 / scale, system.by_parameter(one)) for scale, parameters in groups for one in parameters]
        if self.flow.pressure is None:
            by_drive = system.by_prescribed(self.inflow / self.flow.scale)
        else:
            by_drive = np.asarray(system.by_parameter(self.flow.pressure.parameter) / self.flow.scale)
        return [*found, (1.0, by_drive), *((1.0, self._by_fluid(name)) for name in fluid)]

    def _check_balance(self, x: Vector, load: float) -> None:
        """Refuse a state whose recomputed residual is not small compared with the reactions at the boundaries."""
        self.residual(x, load)
        rows = np.abs(self.system.full_residual())
        left, reaction = rows[self.system.free].max(), rows.max()
        stiffest = max(young.Get() for young in self.system.material[0])
        if left > BALANCE * reaction + ROUNDING * stiffest:
            message = f"forces do not balance: residual {left:.2g} against reactions of {reaction:.2g}"
            raise ForwardModelError("unbalanced", message, {"residual": float(left), "reaction": float(reaction)})

    def set_loads(self, rate: float, fluid: flow.Fluid) -> float:
        """Set the fluid and its loads; return the load at the end of their path, scaled, or 1 for all if a force acts
        too."""
        viscosity, density, *force = fluid.values()
        self.system.viscosity.Set(viscosity / flow.VISCOSITY_SCALE)
        self.system.density.Set(density / flow.DENSITY_SCALE)
        scaled = rate / self.flow.scale
        target = 1.0 if self.flow.forces and any(force) else scaled
        self._drive = 1.0 if target == scaled else scaled
        self._load_scale = self.flow.scale if target == scaled else rate
        self._loads = [*(f / flow.FORCE_SCALE for f in force[: len(self.flow.forces)])]
        self._loads += [self._drive] if self.flow.pressure is not None else []
        return target

    def _apply(self, load: float) -> None:
        """Write the loads at a point of the load path into the system."""
        self.system.values[:] = load * self._drive * self.inflow
        for one, full in zip(self.flow.loads, self._loads, strict=True):
            one.parameter.Set(load * full)

    def _by_fluid(self, name: str) -> Vector:
        """Return the derivative of the residual with respect to a quantity of the fluid, per its unit."""
        scales = {"viscosity": flow.VISCOSITY_SCALE, "density": flow.DENSITY_SCALE}
        parameters = {"viscosity": self.system.viscosity, "density": self.system.density}
        forces = dict(zip(("force_x", "force_y"), self.flow.forces, strict=False))
        parameter = parameters[name] if name in parameters else forces[name].parameter
        return np.asarray(self.system.by_parameter(parameter) / scales.get(name, flow.FORCE_SCALE))

    def _flow_past_rigid_body(self) -> Vector:
        """Return velocity and pressure at V_in = 100 mm²/s past a body so stiff that it does not move."""
        rigid = (1e8 / flow.STRESS_SCALE, 0.3, *map(typical_value, further_parameters(self.system.law)))
        self.system.set_material(*([value] * len(self.parts) for value in rigid))
        reference = 1.0 if self.flow.pressure is None else self.flow.developed_drop(self.fluid)
        self.set_loads(reference * self.flow.scale, replace(self.fluid, force_x=0.0, force_y=0.0))
        self._apply(reference)
        start = np.array(self.system.values[self.system.free])
        settings = newton.NewtonSettings(tolerance=1e-6, maximum_jacobians=30)
        x = newton.solve(self.system, start, weights=self.weights, settings=settings).x
        x[~(self.system.block(0) | self.system.block(1))] = 0.0
        return np.asarray(x / reference)

    def _interface_values(self, values: Float[np.ndarray, " dof"]) -> Points:
        """Return the displacement part of `values` at the outline's nodes."""
        return np.ascontiguousarray(values[self._interface_rows].reshape(2, -1).T)

    @cached_property
    def _interface_rows(self) -> Int[np.ndarray, " coordinate"]:
        """Where the displacements of the outline's nodes are among all coefficients, those along x first."""
        part = self.system.space.Range(2)
        along_x = part.start + self.vertices
        return np.concatenate([along_x, along_x + (part.stop - part.start) // 2])


def _boundaries(channel: Channel, *, pressure_driven: bool = False, sliding: bool = False) -> BoundaryNames:
    straight = {"outlet": channel.outlet == "horizontal", "inlet": pressure_driven, "top": channel.is_frictionless}
    return BoundaryNames(
        no_slip="floor" if channel.is_frictionless else "floor|top",
        inlet="" if pressure_driven else "inlet",
        fixed="inlet|outlet|top|base|side" if sliding else "inlet|outlet|floor|top|base|side",
        sliding="floor|loose" if sliding else "",
        vertical_velocity_zero="|".join(name for name, is_so in straight.items() if is_so),
    )


def _vertices_at(mesh: Any, interface: Interface) -> Int[np.ndarray, " point"]:
    """Return the mesh vertex at each node of the outline; each must exist exactly once."""
    vertices = np.array([v.point for v in mesh.vertices])
    distance = np.linalg.norm(vertices[None, :, :] - interface.points[:, None, :], axis=2)
    if not (np.sum(distance < 1e-9, axis=1) == 1).all():
        raise ForwardModelError("mesh", "the mesh does not contain each node of the outline exactly once")
    return np.asarray(distance.argmin(axis=1))
