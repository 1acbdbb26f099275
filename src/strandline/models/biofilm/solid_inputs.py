"""The inputs of the biofilm model that describe its solid: those of the law, for each part."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from strandline.models.biofilm.materials import Law, further_parameters
from strandline.models.protocol import ModelInput

__all__ = ["SolidInputs"]

SMALL_STRAIN = (
    ModelInput("E", "Pa", 0.0, np.inf, low_included=False, high_included=False, meaning="Young's modulus"),
    ModelInput("nu", "1", -1.0, 0.5, low_included=False, meaning="Poisson's ratio"),
)


@dataclass(frozen=True)
class SolidInputs:
    """Inputs of a law: E, nu and its further parameters, or E1, nu1, …, E2, … of several parts.

    Args:
        law: The law.
        parts: Number of parts, at least 1.
    """

    law: Law
    parts: int

    @property
    def all(self) -> tuple[ModelInput, ...]:
        """Inputs, part by part."""
        return tuple(_of_part(item, number) for number in self._numbers for item in self._parameters)

    @property
    def names(self) -> list[str]:
        """Names, parameter by parameter: E1, E2, …, nu1, …, as `FlowCell.sensitivities` orders them."""
        return [item.name + number for item in self._parameters for number in self._numbers]

    def values(self, inputs: Mapping[str, float]) -> list[list[float]]:
        """Return Young's moduli, Poisson's ratios and further parameters, each for every part."""
        return [[float(inputs[item.name + number]) for number in self._numbers] for item in self._parameters]

    @property
    def _parameters(self) -> tuple[ModelInput, ...]:
        return (*SMALL_STRAIN, *further_parameters(self.law))

    @property
    def _numbers(self) -> list[str]:
        """What names of inputs end with: the number of the part; nothing if there is one."""
        return [""] if self.parts == 1 else [str(k) for k in range(1, self.parts + 1)]


def _of_part(item: ModelInput, number: str) -> ModelInput:
    """Return a parameter of the law as an input of part `number`; empty if there is one part."""
    if not number:
        return item
    return dataclasses.replace(item, name=item.name + number, meaning=f"{item.meaning} of part {number}")
