"""The forward model of the study: a biofilm on the floor of a flow cell, bent by the flow over it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import ngsolve as ng
import numpy as np
from jaxtyping import Bool, Float, Int

from strandline.errors import ForwardModelError, InvalidInput
from strandline.interface import Interface
from strandline.models.biofilm import newton
from strandline.models.biofilm.distortion import jacobian_bound, on_elements, quadratic_nodes
from strandline.models.biofilm.geometry import MESHES, mesh_flow_cell
from strandline.models.biofilm.outline import outline
from strandline.models.biofilm.system import BoundaryNames, CoupledSystem
from strandline.models.protocol import ModelInput, Simulation

__all__ = ["Biofilm", "FlowFields"]

VELOCITY_SCALE = 100.0
"""U in mm/s; with lengths in mm and ρ = 1e3 kg/m³ the stress scale ρU² is 10 Pa and the scaled viscosity 0.01."""
STRESS_SCALE = 10.0
VISCOSITY = 0.01
REVISION = 1
"""Raised whenever the results of the model change."""
BOUNDARIES = BoundaryNames(
    no_slip="floor|top",
    inlet="inlet",
    fixed="inlet|outlet|floor|top|base",
    vertical_velocity_zero="outlet",
)
NORM_WEIGHTS = (1.0, 0.1, 10.0, 0.1)
"""Newton corrections of v, p, d, pₛ are weighted so that all count alike."""


@dataclass(frozen=True, eq=False)
class FlowFields:
    """The solved state for pictures: corners and edge midpoints of the mesh, four flat triangles per element.

    Args:
        points: deformed node positions, mm.
        triangles: node numbers.
        cell_is_solid: per triangle.
        velocity: mm/s, zero in the solid.
        pressure: fluid pressure, Pa, zero in the solid.
        displacement: mm; in the fluid that of the mesh.
    """

    points: Float[np.ndarray, "point 2"]
    triangles: Int[np.ndarray, "cell 3"]
    cell_is_solid: Bool[np.ndarray, " cell"]
    velocity: Float[np.ndarray, "point 2"]
    pressure: Float[np.ndarray, " point"]
    displacement: Float[np.ndarray, "point 2"]


@dataclass(frozen=True)
class Biofilm:
    """Quasi-steady fluid–structure interaction in a channel of 2 mm × 1 mm.

    Saint-Venant–Kirchhoff solid in plane strain on the floor; water enters at the left with a parabolic profile of
    volume rate V_in and leaves at the right with no vertical velocity. The output is the deformed interface: 66 nodes,
    mm, from the upstream to the downstream foot. Deterministic to the bit.

    Args:
        mesh: ``coarse``, ``default`` (1194 elements) or ``fine`` (3454).

    Raises (on a run):
        ForwardModelError: ``newton_stalled``, ``newton_maxit``, ``nonfinite_residual``, ``linear_solve``,
            ``inverted_elements``.
    """

    mesh: str = "default"

    inputs: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("E", "Pa", 0.0, np.inf, low_included=False, high_included=False, meaning="Young's modulus"),
        ModelInput("nu", "1", -1.0, 0.5, low_included=False, meaning="Poisson's ratio"),
        ModelInput("V_in", "mm^2/s", 0.0, np.inf, high_included=False, meaning="inflow volume rate per depth"),
    )

    def __post_init__(self) -> None:
        if self.mesh not in MESHES:
            raise InvalidInput(
                "mesh of the biofilm model",
                value=self.mesh,
                expected=f"one of {', '.join(MESHES)}",
                remedy="Choose one of them.",
            )

    @property
    def fingerprint(self) -> str:
        """What identifies the model in a ledger."""
        return f"biofilm:r{REVISION}:mesh={self.mesh}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path | None = None) -> Simulation:
        """Return the deformed interface at E [Pa], nu, V_in [mm²/s]."""
        return _flow_cell(self).run(inputs)

    def undeformed(self) -> Interface:
        """Return the interface without flow, mm."""
        return outline()

    def fields(self, inputs: Mapping[str, float]) -> FlowFields:
        """Return velocity, pressure and displacement of the solved state."""
        cell = _flow_cell(self)
        cell.run(inputs)
        return cell.fields()


class _FlowCell:
    """Mesh, spaces and forms, set up once per process."""

    def __init__(self, model: Biofilm) -> None:
        self.reference = outline()
        self.mesh = mesh_flow_cell(self.reference, MESHES[model.mesh])
        self.is_solid = np.array([element.mat == "solid" for element in self.mesh.Elements(ng.VOL)])
        self.system = CoupledSystem(self.mesh, BOUNDARIES, viscosity=VISCOSITY, density=1.0)
        self.vertices = _vertices_at(self.mesh, self.reference)
        self.weights = np.empty(len(self.system.free))
        for component, weight in enumerate(NORM_WEIGHTS):
            self.weights[self.system.block(component)] = weight
        velocity = self.system.state.components[0]
        velocity.Set(ng.CF((6 * ng.y * (1 - ng.y), 0)), definedon=self.mesh.Boundaries("inlet"))
        self.inflow = np.array(self.system.values)
        self.rigid_flow = self._flow_past_rigid_body()

    def run(self, inputs: Mapping[str, float]) -> Simulation:
        E, nu, rate = (float(inputs[name]) for name in ("E", "nu", "V_in"))
        load = rate / VELOCITY_SCALE
        self._prescribe(E, nu, load)
        solution = newton.solve(
            self.system, load * self.rigid_flow, norm=self.norm, settings=newton.NewtonSettings(maximum_jacobians=12)
        )
        self.system.set_unknowns(solution.x)
        fluid_bound, solid_bound = jacobian_bound(self.mesh, self.system.state.components[2], self.is_solid)
        if min(fluid_bound, solid_bound) <= 0:
            raise ForwardModelError(
                "inverted_elements",
                f"elements are inverted: J is bounded by {fluid_bound:.3g} (fluid), {solid_bound:.3g} (solid)",
                {"min_J_fluid": fluid_bound, "min_J_solid": solid_bound},
            )
        displacement = self._interface_displacement()
        return Simulation.of(
            Interface.polyline(self.reference.points + displacement),
            {
                "max_displacement": float(np.linalg.norm(displacement, axis=1).max()),
                "min_J_fluid": fluid_bound,
                "min_J_solid": solid_bound,
                "newton_jacobians": float(solution.jacobians),
                "newton_simplified_steps": float(solution.simplified_steps),
            },
        )

    def norm(self, correction: Float[np.ndarray, " unknown"]) -> float:
        return float(np.linalg.norm(self.weights * correction) / np.sqrt(len(correction)))

    def fields(self) -> FlowFields:
        velocity, pressure, displacement, _ = self.system.state.components
        nodes, count = quadratic_nodes(self.mesh)
        fluid, everywhere = ~self.is_solid, np.ones(self.mesh.ne, bool)

        def nodal(function: Any, cells: Bool[np.ndarray, " element"]) -> Float[np.ndarray, "point component"]:
            values = on_elements(self.mesh, function)[cells]
            result = np.zeros((count, values.shape[2]))
            result[nodes[cells].ravel()] = values.reshape(-1, values.shape[2])
            return result

        d = nodal(displacement, everywhere)
        rest = nodal(ng.CF((ng.x, ng.y)), everywhere)
        split = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
        return FlowFields(
            points=rest + d,
            triangles=nodes[:, split].reshape(-1, 3),
            cell_is_solid=np.repeat(self.is_solid, 4),
            velocity=nodal(velocity, fluid) * VELOCITY_SCALE,
            pressure=nodal(pressure, fluid)[:, 0] * STRESS_SCALE,
            displacement=d,
        )

    def _prescribe(self, E: float, nu: float, load: float) -> None:
        self.system.young.Set(E / STRESS_SCALE)
        self.system.poisson.Set(nu)
        self.system.values[:] = load * self.inflow

    def _flow_past_rigid_body(self) -> Float[np.ndarray, " unknown"]:
        """Velocity and pressure at V_in = 100 mm²/s past a body so stiff that it does not move."""
        self._prescribe(1e8, 0.3, 1.0)
        start = np.array(self.system.values[self.system.free])
        settings = newton.NewtonSettings(tolerance=1e-6, maximum_jacobians=30)
        x = newton.solve(self.system, start, norm=self.norm, settings=settings).x
        x[self.system.block(2) | self.system.block(3)] = 0.0
        return x

    def _interface_displacement(self) -> Float[np.ndarray, "point 2"]:
        """Vertex values of the displacement at the outline's nodes."""
        d = self.system.state.components[2].vec.FV().NumPy()
        half = len(d) // 2
        return np.stack([d[self.vertices], d[half + self.vertices]], axis=1)


@lru_cache(maxsize=2)
def _flow_cell(model: Biofilm) -> _FlowCell:
    return _FlowCell(model)


def _vertices_at(mesh: Any, interface: Interface) -> Int[np.ndarray, " point"]:
    """Return the mesh vertex at each node of the outline; each must exist exactly once."""
    vertices = np.array([v.point for v in mesh.vertices])
    distance = np.linalg.norm(vertices[None, :, :] - interface.points[:, None, :], axis=2)
    if not (np.sum(distance < 1e-9, axis=1) == 1).all():
        raise ForwardModelError("mesh", "the mesh does not carry each node of the outline exactly once")
    return np.asarray(distance.argmin(axis=1))
