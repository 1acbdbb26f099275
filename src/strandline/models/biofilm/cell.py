"""A flow cell with its specimen, discretised: solve it, read the interface, differentiate it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float, Int

from strandline.errors import ForwardModelError
from strandline.interface import Interface
from strandline.models.biofilm import newton
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.distortion import jacobian_bound
from strandline.models.biofilm.flow_fields import FlowFields, flow_fields
from strandline.models.biofilm.geometry import MeshSize, mesh_flow_cell, subdivide
from strandline.models.biofilm.materials import Law, further_parameters
from strandline.models.biofilm.steady import steady_state
from strandline.models.biofilm.strain import Strain, StrainProbe
from strandline.models.biofilm.subdivision import Partition
from strandline.models.biofilm.system import BoundaryNames, CoupledSystem, typical

__all__ = ["STRESS_SCALE", "VELOCITY_SCALE", "VISCOSITY", "FlowCell", "FlowFields", "Solution"]

VELOCITY_SCALE = 100.0
"""U in mm/s; with lengths in mm and ρ = 1e3 kg/m³ the stress scale ρU² is 10 Pa and the scaled viscosity 0.01."""
STRESS_SCALE = 10.0
VISCOSITY = 0.01
_SCALES = {"Pa": STRESS_SCALE, "1": 1.0}
NORM_WEIGHTS = (1.0, 0.1, 10.0, 0.1)
"""Newton corrections of v, p, d, pₛ are weighted so that all count alike."""
BALANCE = 1e-6
"""Largest residual of a solution, as a share of the largest reaction."""

Vector = Float[np.ndarray, " unknown"]
Points = Float[np.ndarray, "point 2"]


@dataclass(frozen=True, eq=False)
class Solution:
    """A steady state.

    Args:
        unknowns: Unknowns of the coupled system (unknown,), scaled.
        displacement: Displacements of the interface's nodes (point, 2), mm.
        min_J_fluid: Lower bound of det F of the mesh motion.
        min_J_solid: Lower bound of det F of the solid.
        jacobians: Number of Jacobians assembled and factorised, including those on the load path.
    """

    unknowns: Vector
    displacement: Points
    min_J_fluid: float
    min_J_solid: float
    jacobians: int

    def diagnostics(self) -> dict[str, float]:
        """Return the figures that go into a run's record."""
        return {
            "max_displacement": float(np.linalg.norm(self.displacement, axis=1).max()),
            "min_J_fluid": self.min_J_fluid,
            "min_J_solid": self.min_J_solid,
            "newton_jacobians": float(self.jacobians),
        }


class FlowCell:
    """Mesh, spaces and forms of one geometry and material law; everything scaled inside, physical outside."""

    def __init__(self, outline: Interface, size: MeshSize, *, channel: Channel, partition: Partition, law: Law) -> None:
        _, self.parts = subdivide(outline, channel, partition)
        self._material_scales = (STRESS_SCALE, 1.0, *(_SCALES[item.unit] for item in further_parameters(law)))
        self.outline, self.channel = outline, channel
        self.mesh = mesh_flow_cell(outline, size, channel, partition)
        number = {"fluid": 0} | {name: k for k, name in enumerate(self.parts, 1)}
        self.part = np.array([number[element.mat] for element in self.mesh.Elements(ng.VOL)])
        self.is_solid = self.part > 0
        self.system = CoupledSystem(
            self.mesh, _boundaries(channel), viscosity=VISCOSITY, density=1.0, law=law, solids=tuple(self.parts)
        )
        self.vertices = _vertices_at(self.mesh, outline)
        self.weights = np.empty(len(self.system.free))
        for component in range(3 + len(self.parts)):
            self.weights[self.system.block(component)] = NORM_WEIGHTS[min(component, 3)]
        self._prescribe_inflow()
        self.inflow = np.array(self.system.values)
        self._strains = StrainProbe(self.system)
        self.rigid_flow = self._flow_past_rigid_body()

    def solve(
        self,
        young: Sequence[float],
        poisson: Sequence[float],
        rate: float,
        *further: Sequence[float],
        budget: int = 0,
    ) -> Solution:
        """Return the steady state at Young's moduli [Pa] and Poisson's ratios of the parts, and inflow [mm²/s].

        Args:
            young: Young's modulus of each part, Pa.
            poisson: Poisson's ratio of each part.
            rate: Inflow rate V_in, mm²/s.
            further: Values of each further parameter of the law, one for each part.
            budget: Number of Jacobians after which the search is given up; 0: no limit.

        Raises:
            ForwardModelError: ``limit_point``, ``continuation_stalled``, ``newton_maxit``, ``newton_stalled``,
                ``inverted_elements``, ``unbalanced``, ``nonfinite_residual`` or ``linear_solve``; loads in the evidence
                are inflow rates in mm²/s.
        """
        values = zip(self._material_scales, (young, poisson, *further), strict=True)
        self.system.set_material(*([value / scale for value in given] for scale, given in values))
        load = rate / VELOCITY_SCALE
        try:
            found = steady_state(self, load, budget=budget)
            bounds = self.check(found.x)
            self._check_balance(found.x, load)
        except ForwardModelError as error:
            raise _in_physical_units(error) from error
        moved = self._interface_values(np.array(self.system.values))
        return Solution(found.x, moved, bounds["min_J_fluid"], bounds["min_J_solid"], found.jacobians)

    def undeformed(self, load: float) -> Vector:
        """Return the flow past a rigid body, scaled: the first guess."""
        return np.asarray(load * self.rigid_flow)

    def residual(self, x: Vector, load: float) -> Vector:
        """Return the residual at an inflow of `load`."""
        self.system.values[:] = load * self.inflow
        return self.system.residual(x)

    def factorise(self, x: Vector, load: float) -> newton.LinearSolver:
        """Return the factorised Jacobian at an inflow of `load`."""
        self.system.values[:] = load * self.inflow
        return self.system.factorise(x)

    def by_load(self) -> Vector:
        """Return the derivative of the residual with respect to the load, at the last factorised state."""
        return self.system.by_prescribed(self.inflow)

    def largest_compression(self, x: Vector) -> float:
        """Return the largest compressive principal strain of the solid, to first order in the displacement."""
        return self._strains.largest_compression(x)

    def largest_strain(self, x: Vector) -> Strain:
        """Return the strain of the most compressed element."""
        return self._strains.largest(x)

    def critical_strain(self, x: Vector, tangent: Vector) -> Strain:
        """Return the strain of the element that gives way fastest along the tangent."""
        return self._strains.critical(x, tangent)

    def check(self, x: Vector) -> Mapping[str, float]:
        """Return lower bounds of J in fluid and solid.

        Raises:
            ForwardModelError: ``inverted_elements``.
        """
        self.system.set_unknowns(x)
        fluid_bound, solid_bound = self.distortion()
        bounds = {"min_J_fluid": fluid_bound, "min_J_solid": solid_bound}
        if min(fluid_bound, solid_bound) <= 0:
            message = f"elements are inverted: J is bounded by {fluid_bound:.3g} (fluid), {solid_bound:.3g} (solid)"
            raise ForwardModelError("inverted_elements", message, bounds)
        return bounds

    def sensitivities(self, solution: Solution) -> list[Points]:
        """Return d(interface)/dE of each part [mm/Pa], d/dν of each part [mm], …, d/dV_in [mm per mm²/s].

        The derivatives by the law's further parameters follow those by ν.

        One back-substitution each with a fresh Jacobian at the solution that `solve` has just returned.
        """
        system = self.system
        jacobian = system.factorise(solution.unknowns)
        by_inflow = system.by_prescribed(self.inflow / VELOCITY_SCALE)
        derivatives = [
            1.0 / scale * jacobian.solve(-system.by_parameter(parameter))
            for scale, parameters in zip(self._material_scales, system.material, strict=True)
            for parameter in parameters
        ]
        derivatives.append(jacobian.solve(-by_inflow))
        return [self._interface_values(self._with_unknowns(d)) for d in derivatives]

    def _check_balance(self, x: Vector, load: float) -> None:
        """Refuse a state whose recomputed residual is not small compared with the reactions at the boundaries."""
        self.residual(x, load)
        rows = np.abs(self.system.full_residual())
        left, reaction = rows[self.system.free].max(), rows.max()
        if left > BALANCE * reaction:
            raise ForwardModelError(
                "unbalanced",
                f"forces do not balance: residual {left:.2g} against reactions of {reaction:.2g}",
                {"residual": float(left), "reaction": float(reaction)},
            )

    def distortion(self) -> tuple[float, float]:
        """Return lower bounds of J over fluid and solid at the current state."""
        return jacobian_bound(self.mesh, self.system.state.components[2], self.is_solid)

    def fields(self) -> FlowFields:
        """Return velocity, pressure, displacement and stress of the current state."""
        return flow_fields(self.system, self.part, velocity=VELOCITY_SCALE, stress=STRESS_SCALE)

    def _prescribe_inflow(self) -> None:
        """Write the parabola of volume rate 1 over the free height of the inlet into the velocity."""
        at_left = self.channel.inlet == "left"
        bottom = float(self.outline.points[0 if at_left else -1][1])  # 0 if the outline ends on the floor
        free = self.channel.height - bottom
        s = (ng.y - bottom) / free
        profile = (1.0 if at_left else -1.0) * 6 * s * (1 - s) / free
        inlet = self.mesh.Boundaries("inlet")
        self.system.state.components[0].Set(ng.CF((profile, 0)), definedon=inlet)

    def _flow_past_rigid_body(self) -> Vector:
        """Return velocity and pressure at V_in = 100 mm²/s past a body so stiff that it does not move."""
        parts = len(self.parts)
        further = (typical(item) for item in further_parameters(self.system.law))
        self.system.set_material([1e8 / STRESS_SCALE] * parts, [0.3] * parts, *([value] * parts for value in further))
        self.system.values[:] = self.inflow
        start = np.array(self.system.values[self.system.free])
        settings = newton.NewtonSettings(tolerance=1e-6, maximum_jacobians=30)
        x = newton.solve(self.system, start, weights=self.weights, settings=settings).x
        x[~(self.system.block(0) | self.system.block(1))] = 0.0
        return x

    def _with_unknowns(self, x: Vector) -> Float[np.ndarray, " dof"]:
        values = np.zeros(len(self.system.values))
        values[self.system.free] = x
        return values

    def _interface_values(self, values: Float[np.ndarray, " dof"]) -> Points:
        """Return the displacement part of `values` at the outline's nodes."""
        part = self.system.space.Range(2)
        d = values[part.start : part.stop]
        half = len(d) // 2
        return np.stack([d[self.vertices], d[half + self.vertices]], axis=1)


def _boundaries(channel: Channel) -> BoundaryNames:
    return BoundaryNames(
        no_slip="floor|top",
        inlet="inlet",
        fixed="inlet|outlet|floor|top|base|side",
        vertical_velocity_zero="outlet" if channel.outlet == "horizontal" else "",
    )


def _in_physical_units(error: ForwardModelError) -> ForwardModelError:
    """Return the failure with loads as inflow rates, and with a message that states where and at which inflow rate."""
    evidence = dict(error.evidence)
    for key in ("load_reached", "limit_load", "load_slope"):
        if key in evidence:
            evidence[key] *= VELOCITY_SCALE
    message = error.message
    if error.kind == "limit_point":
        message = (
            f"no steady state beyond V_in = {evidence['limit_load']:.4g} mm²/s: the load path turns back at a strain of"
            f" {evidence['critical_strain']:.2f} at ({evidence['critical_x']:.3f}, {evidence['critical_y']:.3f}) mm"
        )
    elif "load_reached" in evidence:
        message = f"{message}, at V_in = {evidence['load_reached']:.4g} mm²/s"
    return ForwardModelError(error.kind, message, evidence)


def _vertices_at(mesh: Any, interface: Interface) -> Int[np.ndarray, " point"]:
    """Return the mesh vertex at each node of the outline; each must exist exactly once."""
    vertices = np.array([v.point for v in mesh.vertices])
    distance = np.linalg.norm(vertices[None, :, :] - interface.points[:, None, :], axis=2)
    if not (np.sum(distance < 1e-9, axis=1) == 1).all():
        raise ForwardModelError("mesh", "the mesh does not contain each node of the outline exactly once")
    return np.asarray(distance.argmin(axis=1))
