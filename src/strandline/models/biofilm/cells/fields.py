"""The solved state for pictures and ParaView: velocity, pressure, displacement, stress."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Bool, Float, Int

from strandline.foundations import of_extra
from strandline.models import refused
from strandline.models.biofilm.equations.flow import STRESS_SCALE, VELOCITY_SCALE
from strandline.models.biofilm.equations.strain import on_elements, quadratic_nodes
from strandline.models.biofilm.equations.system import CoupledSystem
from strandline.models.biofilm.materials import deformation_gradient

Points = Float[np.ndarray, "point 2"]


@dataclass(frozen=True, eq=False)
class FlowFields:
    """The solved state for pictures: corners and edge midpoints of the mesh, four flat triangles per element.

    `points` are deformed, mm. `cell_part` is the number of the solid's part, from 1, and 0 in the fluid. Velocity,
    mm/s, and pressure, Pa, are zero in the solid; the displacement, mm, is that of the mesh in the fluid. The Cauchy
    stress of the solid, (σxx, σyy, σxy, σzz), Pa, is zero in the fluid.
    """

    points: Points
    triangles: Int[np.ndarray, "cell 3"]
    cell_part: Int[np.ndarray, " cell"]
    velocity: Points
    pressure: Float[np.ndarray, " point"]
    displacement: Points
    stress: Float[np.ndarray, "cell 4"]


def flow_fields(system: CoupledSystem, part: Int[np.ndarray, " element"]) -> FlowFields:
    """Return the fields of the current state; `part` is 0 in the fluid's elements, from 1 in the solid's (element,)."""
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
        velocity=nodal(v, fluid) * VELOCITY_SCALE,
        pressure=nodal(pressure, fluid)[:, 0] * STRESS_SCALE,
        displacement=d,
        stress=_stress_at_nodes(system, part)[:, split].mean(axis=2).reshape(-1, 4) * STRESS_SCALE,
    )


def _stress_at_nodes(system: CoupledSystem, part: Int[np.ndarray, " element"]) -> Float[np.ndarray, "element 6 4"]:
    """Return the scaled Cauchy stress (σxx, σyy, σxy, σzz) at the six P2 nodes of each element; 0 in the fluid.

    σ = J⁻¹ F S Fᵀ (Holzapfel, Nonlinear Solid Mechanics, 2000, Eq. 3.66), F being 1 out of the plane.
    """
    displacement = system.state.components[2]
    F = deformation_gradient(displacement)
    J = ng.Det(F)
    result = np.zeros((len(part), 6, 4))
    for k in range(len(system.solids)):
        solid_pressure = system.state.components[3 + k]
        mixed = system.law(displacement, solid_pressure, *system.of_region(k))
        stress = F * mixed.second_piola * F.trans / J
        across = solid_pressure if mixed.out_of_plane is None else mixed.out_of_plane
        components = ng.CF((stress[0, 0], stress[1, 1], stress[0, 1], across / J))
        result[part == k + 1] = on_elements(system.mesh, components)[part == k + 1]
    return result


IN_SPACE = ((0, 0), (0, 1))
"""Padding of plane vectors (point, 2) by a third component 0."""
COLLECTION = """<?xml version="1.0"?>
<VTKFile type="Collection" version="0.1">
  <Collection>
    <DataSet timestep="0" part="0" file="undeformed.vtu"/>
    <DataSet timestep="1" part="0" file="deformed.vtu"/>
  </Collection>
</VTKFile>
"""


def write_vtu(fields: FlowFields, folder: Path) -> Path:
    """Write undeformed.vtu, deformed.vtu and flow.pvd into `folder`, made if needed; return the path of the last.

    Both meshes carry velocity [mm/s], pressure [Pa] and displacement [mm] at the nodes. Per cell they carry the `part`,
    0 in the fluid, 1, 2, … in the solid in the order of the partition's markers, and the solid's Cauchy stress [Pa], 0
    in the fluid, with the components in ParaView's order xx, yy, zz, xy, yz, xz. In the fluid the displacement is that
    of the mesh; in the solid velocity and pressure are 0. In the PVD, time 0 is the undeformed and time 1 the deformed
    state.
    """
    meshio = of_extra("meshio", "vtu", "files for ParaView")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, points in (("undeformed", fields.points - fields.displacement), ("deformed", fields.points)):
            mesh = meshio.Mesh(
                np.pad(points, IN_SPACE),
                [("triangle", fields.triangles)],
                point_data={
                    "velocity [mm/s]": np.pad(fields.velocity, IN_SPACE),
                    "pressure [Pa]": fields.pressure,
                    "displacement [mm]": np.pad(fields.displacement, IN_SPACE),
                },
                cell_data={
                    "part": [fields.cell_part.astype(np.int8)],
                    "Cauchy stress [Pa]": [np.pad(fields.stress[:, [0, 1, 3, 2]], ((0, 0), (0, 2)))],
                },
            )
            mesh.write(folder / f"{name}.vtu")
        (folder / "flow.pvd").write_text(COLLECTION, encoding="utf-8")
    except OSError as error:
        what, expected = "folder for the files for ParaView", "a folder that can be written to"
        raise refused(what, str(error), expected, "Choose another folder.") from None
    return folder / "flow.pvd"
