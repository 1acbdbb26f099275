"""What is read from a solved state: how far elements are deformed; fields for pictures and ParaView.

A bound of J, and where the solid gives way, as a linear functional of d. Strains are means over elements: the gradient
of a quadratic displacement on a straight triangle is linear, so its mean is the value at the centroid. Then velocity,
pressure, displacement and stress.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Bool, Float, Int

from strandline.foundations import of_extra, unfit
from strandline.models.biofilm.equations.flow import STRESS_SCALE, VELOCITY_SCALE
from strandline.models.biofilm.equations.system import CoupledSystem, Vector
from strandline.models.biofilm.materials import deformation_gradient

NODES_P2 = ((1.0, 0.0), (0.0, 1.0), (0.0, 0.0), (0.5, 0.5), (0.0, 0.5), (0.5, 0.0))
"""Reference coordinates of the three corners and of the midpoints of edges (0,1), (1,2), (2,0)."""
Gradients = Float[np.ndarray, "cell 2 2"]
Directions = Float[np.ndarray, "cell 2"]


def on_elements(mesh: Any, function: Any) -> Float[np.ndarray, "cell 6 component"]:
    """Return a coefficient function at the six P2 nodes of each element, seen from inside it."""
    rule = ng.IntegrationRule(points=list(NODES_P2), weights=[0.0] * len(NODES_P2))
    values = np.asarray(function(mesh.MapToAllElements(rule, ng.VOL)))
    return values.reshape(mesh.ne, len(NODES_P2), -1)


def jacobian_bound(mesh: Any, displacement: Any, is_solid: Bool[np.ndarray, " cell"]) -> tuple[float, float]:
    """Return lower bounds of J over the fluid and over the solid; above zero, no element is inverted anywhere.

    With a quadratic displacement on a straight triangle J is a quadratic polynomial. Its smallest Bernstein coefficient
    (value at a corner; 2 J(midpoint) - mean of the two corners on an edge) bounds it from below.
    """
    J = on_elements(mesh, ng.Det(deformation_gradient(displacement)))[:, :, 0]
    corner, middle = J[:, :3], J[:, 3:]
    edge = 2.0 * middle - 0.5 * (corner + np.roll(corner, -1, axis=1))
    bound = np.minimum(corner.min(axis=1), edge.min(axis=1))
    return float(bound[~is_solid].min()), float(bound[is_solid].min())


def quadratic_nodes(mesh: Any) -> tuple[Int[np.ndarray, "cell 6"], int]:
    """Return the numbers of each element's six P2 nodes, shared with its neighbours, and how many nodes there are."""
    corners = np.array([[v.nr for v in element.vertices] for element in mesh.Elements(ng.VOL)])
    edges = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    return np.concatenate([corners, mesh.nv + number.reshape(-1, 3)], axis=1), mesh.nv + len(unique)


@dataclass(frozen=True, eq=False)
class Strain:
    """A strain u·(∇d)v, functional @ unknowns, of one element with the centroid `place`, mm; above 0 if compressed."""

    functional: Vector
    place: tuple[float, float]


class StrainProbe:
    """Strains of the solid's elements."""

    def __init__(self, system: CoupledSystem) -> None:
        self._system = system
        mesh = system.mesh
        self._cells = np.array([e.nr for e in mesh.Elements(ng.VOL) if e.mat in system.solids])
        self._area = np.asarray(ng.Integrate(ng.CF(1.0), mesh, element_wise=True))[self._cells]
        self._centre = on_elements(mesh, ng.CF((ng.x, ng.y))).mean(axis=1)[self._cells]
        constants = ng.L2(mesh, order=0)
        self._weights = [ng.GridFunction(constants) for _ in range(4)]
        self._form = ng.LinearForm(system.space)
        virtual = ng.Grad(system.space.TestFunction()[2])
        weighted = ng.InnerProduct(ng.CF(tuple(self._weights), dims=(2, 2)), virtual)
        self._form += weighted * ng.dx("|".join(system.solids))

    def largest_compression(self, x: Vector) -> float:
        """Return the largest compressive principal value of the linear strain ½ (∇d + ∇dᵀ) at the unknowns `x`."""
        gradient = self._gradients(x)
        return float(-np.linalg.eigvalsh(0.5 * (gradient + gradient.transpose(0, 2, 1)))[:, 0].min())

    def critical(self, x: Vector, tangent: Vector) -> Strain:
        """Return the strain that grows fastest along a tangent: of the smallest principal stretch of some element."""
        thin, across, _ = self._smallest_stretches(x)
        rate = np.einsum("ei,eij,ej->e", thin, self._gradients(tangent), across)
        return self._strain(int(rate.argmin()), thin, across)

    def largest(self, x: Vector) -> Strain:
        """Return the strain of the smallest principal stretch of all elements."""
        thin, across, stretch = self._smallest_stretches(x)
        return self._strain(int(stretch.argmin()), thin, across)

    def _smallest_stretches(self, x: Vector) -> tuple[Directions, Directions, Float[np.ndarray, " cell"]]:
        """Return the left and right singular vectors of each element's smallest principal stretch, and the stretch."""
        left, stretches, right = np.linalg.svd(np.eye(2) + self._gradients(x))
        return left[:, :, 1], right[:, 1, :], stretches[:, 1]

    def _strain(self, cell: int, thin: Directions, across: Directions) -> Strain:
        place = (float(self._centre[cell, 0]), float(self._centre[cell, 1]))
        direction = -np.outer(thin[cell], across[cell])
        for weight, value in zip(self._weights, direction.ravel(), strict=True):
            weight.vec.FV().NumPy()[:] = 0.0
            weight.vec.FV().NumPy()[self._cells[cell]] = value / self._area[cell]
        self._form.Assemble()  # direction : mean ∇d of the element
        coefficients: Any = self._form.vec.FV().NumPy()
        return Strain(np.array(coefficients[self._system.free]), place)

    def _gradients(self, x: Vector) -> Gradients:
        """Return the mean ∇d of each solid element."""
        self._system.set_unknowns(x)
        gradient = on_elements(self._system.mesh, ng.Grad(self._system.state.components[2])).mean(axis=1)
        return np.asarray(gradient[self._cells].reshape(-1, 2, 2))


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
    of the mesh; in the solid velocity and pressure are 0. In the PVD, time 0 is undeformed, time 1 deformed.
    """
    meshio = of_extra("meshio", "vtu", "files for ParaView")
    nodal = {
        "velocity [mm/s]": np.pad(fields.velocity, IN_SPACE),
        "pressure [Pa]": fields.pressure,
        "displacement [mm]": np.pad(fields.displacement, IN_SPACE),
    }
    stress = np.pad(fields.stress[:, [0, 1, 3, 2]], ((0, 0), (0, 2)))
    by_cell = {"part": [fields.cell_part.astype(np.int8)], "Cauchy stress [Pa]": [stress]}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, points in (("undeformed", fields.points - fields.displacement), ("deformed", fields.points)):
            mesh = meshio.Mesh(np.pad(points, IN_SPACE), [("triangle", fields.triangles)], nodal, by_cell)
            mesh.write(folder / f"{name}.vtu")
        (folder / "flow.pvd").write_text(COLLECTION, encoding="utf-8")
    except OSError as error:
        what, expected = "folder for the files for ParaView", "a folder that can be written to"
        raise unfit(what, str(error), expected, "Choose another folder.") from None
    return folder / "flow.pvd"
