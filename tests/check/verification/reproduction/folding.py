"""A forward model with a closed form and a fold, for tests of tables of interfaces and their posteriors."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError
from strandline.interface import Interface
from strandline.models.protocol import ModelInput, Simulation

__all__ = ["Folding"]


@dataclass(frozen=True)
class Folding:
    """A straight interface that bulges to a half sine, with no state beyond a fold.

    The bulge is ``0.1 mm (1 + 0.3 ν)(1 + 0.002 V)(1 - √(1 - V/(E t)))`` with the load at the fold
    ``t = 100 / ((1 + ν)(180 + 40 ν) softness)``, as structures behave near a limit point.

    Args:
        nodes: Number of nodes of the interface.
        softness: Divisor of the load at the fold; 1 gives the fold that `FOLD` states, another value moves it.
    """

    nodes: int = 21
    softness: float = 1.0

    inputs: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("E", "Pa", 0.0, np.inf, low_included=False),
        ModelInput("nu", "1", -1.0, 0.5, low_included=False),
        ModelInput("V_in", "mm^2/s", 0.0, np.inf),
    )
    FOLD: ClassVar[tuple[tuple[float, float], ...]] = tuple(
        (nu, (1 + nu) * (180 + 40 * nu)) for nu in (-0.8, -0.5, -0.2, 0.1, 0.3, 0.5)
    )
    """(ν, E) of the fold at V = 100."""

    @property
    def fingerprint(self) -> str:
        """Changes with the model."""
        return f"test:folding-1/{self.nodes}/{self.softness!r}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        """Return the interface.

        Raises:
            ForwardModelError: ``limit_point`` beyond the fold.
        """
        bulge = float(self.bulge(inputs["E"], inputs["nu"], inputs["V_in"]))
        if math.isnan(bulge):
            raise ForwardModelError("limit_point", "no state beyond the fold")
        x = np.linspace(0.0, 1.0, self.nodes)
        return Simulation.of(Interface.polyline(np.stack([x, bulge * np.sin(math.pi * x)], axis=1)))

    def undeformed(self) -> Interface:
        """Return the interface without load."""
        x = np.linspace(0.0, 1.0, self.nodes)
        return Interface.polyline(np.stack([x, np.zeros(self.nodes)], axis=1))

    def bulge(
        self, young: float | Float[np.ndarray, "*point"], nu: float | Float[np.ndarray, "*point"], rate: float
    ) -> Float[np.ndarray, "*point"]:
        """Return the height of the bulge, mm; NaN beyond the fold."""
        load = rate / young * (1 + nu) * (180 + 40 * nu) * self.softness / 100
        root = np.sqrt(np.where(load > 1, np.nan, 1 - load))
        return np.asarray(0.1 * (1 + 0.3 * nu) * (1 + 0.002 * rate) * (1 - root))
