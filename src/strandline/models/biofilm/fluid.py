"""The fluid: viscosity, density and force per volume, each a number or an input of the model."""

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from strandline.errors import InvalidInput
from strandline.models.protocol import ModelInput

__all__ = ["QUANTITIES", "UNKNOWN", "WATER", "Fluid"]

UNKNOWN = "unknown"

QUANTITIES = (
    ModelInput("viscosity", "Pa s", 0.0, np.inf, False, False, "dynamic viscosity of the fluid"),
    ModelInput("density", "kg/m^3", 0.0, np.inf, True, False, "density of the fluid"),
    ModelInput("force_x", "N/m^3", -np.inf, np.inf, False, False, "force per volume of the fluid along x"),
    ModelInput("force_y", "N/m^3", -np.inf, np.inf, False, False, "force per volume of the fluid along y"),
)
"""What describes the fluid, as inputs of the model."""


@dataclass(frozen=True)
class Fluid:
    """A Newtonian fluid; water by default. A quantity that is ``unknown`` is an input of the model.

    Args:
        viscosity: Dynamic viscosity, Pa s, above 0.
        density: Density, kg/m³, at least 0; 0 is creeping flow.
        force_x: Force per volume along x, N/m³.
        force_y: Force per volume along y, N/m³. The pressure at the outlet, and at an inlet with a given pressure, is
            the hydrostatic one of this force, 0 at the top.

    Raises:
        InvalidInput: A quantity is neither a number in its range nor ``unknown``.
    """

    viscosity: float | str = 1e-3
    density: float | str = 1e3
    force_x: float | str = 0.0
    force_y: float | str = 0.0

    def __post_init__(self) -> None:
        for item in QUANTITIES:
            value = getattr(self, item.name)
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if value != UNKNOWN and not (number and np.isfinite(value) and item.admits(value)):
                raise InvalidInput(
                    f"{item.name} of the fluid",
                    value=value,
                    expected=f"a number in {item.range_text()}, in {item.unit}, or {UNKNOWN}",
                    remedy=f"Correct it. Write `{UNKNOWN}` to make it an input of the model.",
                )

    @property
    def inputs(self) -> tuple[ModelInput, ...]:
        """The quantities that are inputs of the model."""
        return tuple(item for item in QUANTITIES if getattr(self, item.name) == UNKNOWN)

    @property
    def is_forced(self) -> bool:
        """Whether a force acts on the fluid, or may."""
        return not (self.force_x == 0.0 and self.force_y == 0.0)

    def at(self, inputs: Mapping[str, float]) -> "Fluid":
        """Return the fluid with the values of its inputs, by name; a missing one is that of water.

        Raises:
            InvalidInput: A value is out of its range.
        """
        water = {item.name: getattr(WATER, item.name) for item in self.inputs}
        return dataclasses.replace(self, **{name: float(inputs.get(name, value)) for name, value in water.items()})

    def values(self) -> Iterator[float]:
        """Yield viscosity, density and force of a fluid without unknown quantities."""
        for item in QUANTITIES:
            yield float(getattr(self, item.name))


WATER = Fluid()
