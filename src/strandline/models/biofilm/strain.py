"""Where the solid gives way: the element whose strain grows fastest along the load path, as a linear functional of d.

Strains are means over elements: the gradient of a quadratic displacement on a straight triangle is linear, so its mean
is the value at the centroid.
"""

from dataclasses import dataclass
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float

from strandline.models.biofilm.distortion import on_elements
from strandline.models.biofilm.system import CoupledSystem

__all__ = ["Strain", "StrainProbe"]

Vector = Float[np.ndarray, " unknown"]
Gradients = Float[np.ndarray, "cell 2 2"]
Directions = Float[np.ndarray, "cell 2"]


@dataclass(frozen=True, eq=False)
class Strain:
    """A strain u·(∇d)v of one element, positive where it is compressed.

    Args:
        functional: coefficients of the unknowns; functional @ x is the strain.
        place: centroid of the element, mm.
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
        """Return the strain that grows fastest: that of the smallest principal stretch of some element.

        Args:
            x: unknowns.
            tangent: derivative of the unknowns along the path.
        """
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
        return Strain(self._functional(cell, -np.outer(thin[cell], across[cell])), place)

    def _gradients(self, x: Vector) -> Gradients:
        """Return the mean ∇d of each solid element."""
        self._system.set_unknowns(x)
        gradient = on_elements(self._system.mesh, ng.Grad(self._system.state.components[2])).mean(axis=1)
        return np.asarray(gradient[self._cells].reshape(-1, 2, 2))

    def _functional(self, cell: int, direction: Float[np.ndarray, "2 2"]) -> Vector:
        """Return the coefficients of direction : mean ∇d of a solid element."""
        for weight, value in zip(self._weights, direction.ravel(), strict=True):
            weight.vec.FV().NumPy()[:] = 0.0
            weight.vec.FV().NumPy()[self._cells[cell]] = value / self._area[cell]
        self._form.Assemble()
        coefficients: Any = self._form.vec.FV().NumPy()
        return np.array(coefficients[self._system.free])
