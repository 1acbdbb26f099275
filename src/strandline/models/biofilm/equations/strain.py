"""How far elements are deformed: a bound of J, and where the solid gives way, as a linear functional of d.

Strains are means over elements: the gradient of a quadratic displacement on a straight triangle is linear, so its mean
is the value at the centroid.
"""

from dataclasses import dataclass
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Bool, Float, Int

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
    """A strain u·(∇d)v of one element, positive where it is compressed: functional @ unknowns.

    `place` is the centroid of the element, mm.
    """

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
