"""The coupled system when its state changes with time: inertia, and a fluid that moves with the interface."""

from functools import cached_property
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float, Int

from strandline.errors import InvalidInput
from strandline.models.biofilm.assembly import Part, Pattern
from strandline.models.biofilm.inertia import FluidInertia, SolidInertia
from strandline.models.biofilm.rates import Rates
from strandline.models.biofilm.system import BoundaryNames, CoupledSystem, fluid_cells

__all__ = ["MovingSystem"]

Vector = Float[np.ndarray, " unknown"]
Numbers = Int[np.ndarray, " entry"]


class MovingSystem(CoupledSystem):
    """A `CoupledSystem` with inertia. On the interface the fluid's velocity is the rate of the displacement.

    That velocity is eliminated: it is an affine function of the displacement at the new time, so its columns of the
    Jacobian are added to those of the displacement. With `rates` at rest this is the steady system.

    Args:
        mesh: NGSolve mesh as for `CoupledSystem`.
        boundaries: Names of the boundaries where the conditions hold.
        solid_density: Scaled density of the undeformed solid.
        options: Further arguments of `CoupledSystem`.

    Raises:
        InvalidInput: There is a fluid, and its velocity is not quadratic.
    """

    def __init__(self, mesh: Any, boundaries: BoundaryNames, *, solid_density: float, **options: Any) -> None:
        super().__init__(mesh, boundaries, **options)
        self.rates = Rates(self.space.ndof)
        self._parts = (*self._parts, *self._inertia(solid_density))
        self._follows, self._leads = self._moved_by_solid()

    def set_unknowns(self, x: Vector) -> None:
        """Write the unknowns into the state, and the velocity on the interface that follows from them."""
        super().set_unknowns(x)
        values = self.values
        values[self._follows] = self.rates.first(values)[self._leads]

    def _inertia(self, solid_density: float) -> list[Part]:
        parts: list[Part] = []
        if "fluid" in self.mesh.GetMaterials():
            if self._fluid is None:
                raise InvalidInput(
                    "order of a flow that changes with time",
                    value="elements that are not quadratic",
                    expected="order 2",
                    remedy="Choose order 2.",
                )
            known = {"viscosity": self.viscosity, "density": self.density, "rates": self.rates}
            parts.append(FluidInertia(self.space, *fluid_cells(self.mesh), **known))
        if self.solids:
            parts.append(SolidInertia(self.space, self.solids, density=solid_density, rates=self.rates))
        return parts

    def _moved_by_solid(self) -> tuple[Numbers, Numbers]:
        """Return the numbers of the velocity's coefficients on the interface, and of the displacement's there."""
        if "fluid" not in self.mesh.GetMaterials() or not self.solids:
            return np.empty(0, int), np.empty(0, int)
        elements = [ng.ElementId(ng.VOL, int(cell)) for cell in fluid_cells(self.mesh)[0]]
        v, d = (
            np.concatenate([self.space.components[k].GetDofNrs(element) for element in elements])
            + self.space.Range(k).start
            for k in (0, 2)
        )
        shared = ~self.is_motion[d]
        follows, first = np.unique(v[shared], return_index=True)
        return follows, d[shared][first]

    def _assemble(self) -> Float[np.ndarray, " entry"]:
        entries = super()._assemble()
        entries[self._on_interface] *= self.rates.leading
        return entries

    @cached_property
    def _own_places(self) -> tuple[Numbers, Numbers]:
        places = [part.places() for part in self._parts]
        return np.concatenate([rows for rows, _ in places]), np.concatenate([columns for _, columns in places])

    @cached_property
    def _on_interface(self) -> Numbers:
        """Numbers of the entries in columns of the velocity on the interface."""
        return np.flatnonzero(np.isin(self._own_places[1], self._follows))

    @cached_property
    def _places(self) -> tuple[Numbers, Numbers]:
        rows, columns = self._own_places
        target = np.arange(self.space.ndof)
        target[self._follows] = self._leads
        return rows, target[columns]

    @cached_property
    def _pattern(self) -> Pattern:
        kept, self.rates.leading = self.rates.leading, 1.0
        pattern = super()._pattern
        self.rates.leading = kept
        return pattern
