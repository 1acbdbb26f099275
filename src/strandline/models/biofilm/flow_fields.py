"""The solved state for pictures: velocity, pressure, displacement, stress at corners and midpoints of the mesh."""

from dataclasses import dataclass
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Bool, Float, Int

from strandline.models.biofilm.distortion import on_elements, quadratic_nodes
from strandline.models.biofilm.stress import stress_at_nodes
from strandline.models.biofilm.system import CoupledSystem

__all__ = ["FlowFields", "flow_fields"]

Points = Float[np.ndarray, "point 2"]


@dataclass(frozen=True, eq=False)
class FlowFields:
    """The solved state for pictures: corners and edge midpoints of the mesh, four flat triangles per element.

    Args:
        points: Deformed node positions, mm.
        triangles: Node numbers.
        cell_part: Number of the solid's part, from 1, for each triangle (cell,); 0 in the fluid.
        velocity: Fluid velocity, mm/s; zero in the solid.
        pressure: Fluid pressure, Pa, zero in the solid.
        displacement: Node displacements, mm; in the fluid, those of the mesh.
        stress: Cauchy stress of the solid per triangle, (σxx, σyy, σxy, σzz), Pa, zero in the fluid.
    """

    points: Points
    triangles: Int[np.ndarray, "cell 3"]
    cell_part: Int[np.ndarray, " cell"]
    velocity: Points
    pressure: Float[np.ndarray, " point"]
    displacement: Points
    stress: Float[np.ndarray, "cell 4"]


def flow_fields(
    system: CoupledSystem, part: Int[np.ndarray, " element"], *, velocity: float, stress: float
) -> FlowFields:
    """Return velocity, pressure, displacement and stress of the current state.

    Args:
        system: Coupled system at the state of interest.
        part: Number of the solid's part, from 1, for each element (element,); 0 in the fluid.
        velocity: Scale of velocities, mm/s.
        stress: Scale of stresses, Pa.
    """
    mesh = system.mesh
    v, pressure, displacement, *_ = system.state.components
    nodes, count = quadratic_nodes(mesh)
    fluid, everywhere = part == 0, np.ones(mesh.ne, bool)

    def nodal(function: Any, cells: Bool[np.ndarray, " element"]) -> Float[np.ndarray, "point component"]:
        values = on_elements(mesh, function)[cells]
        result = np.zeros((count, values.shape[2]))
        result[nodes[cells].ravel()] = values.reshape(-1, values.shape[2])
        return result

    d = nodal(displacement, everywhere)
    rest = nodal(ng.CF((ng.x, ng.y)), everywhere)
    split = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    return FlowFields(
        points=rest + d,
        triangles=nodes[:, split].reshape(-1, 3),
        cell_part=np.repeat(part, 4),
        velocity=nodal(v, fluid) * velocity,
        pressure=nodal(pressure, fluid)[:, 0] * stress,
        displacement=d,
        stress=stress_at_nodes(system, part)[:, split].mean(axis=2).reshape(-1, 4) * stress,
    )
