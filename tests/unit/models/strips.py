"""A strip whose stiffness varies along it, with derivatives: w'' = load (1 - s)² / E(s), w(0) = w'(0) = 0."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from strandline.interface import Interface
from strandline.models import ModelInput, Simulation

POINTS = 30
S = (np.arange(POINTS) + 0.5) / POINTS
KERNEL = np.maximum(S[:, None] - S, 0.0) * (1 - S) ** 2 / POINTS  # deflection by compliance


@dataclass(frozen=True)
class Strip:
    sensitivities: bool = False
    inputs: ClassVar = (ModelInput("E", "Pa", 0.0, np.inf, low_included=False), ModelInput("load", "1", 0.0, np.inf))
    fingerprint: ClassVar = "test:strip"

    def __call__(self, inputs, workdir=None):
        E, load = inputs["E"], inputs["load"]
        w = load * KERNEL @ (1 / E)
        slopes = {}
        if self.sensitivities:
            by_field = np.zeros((POINTS, 2, POINTS))
            by_field[:, 1] = -load * KERNEL / E**2
            slopes = {"E": by_field, "load": np.stack([0 * w, w / load], axis=1)}
        return Simulation.of(Interface.polyline(np.stack([S, w], axis=1)), {}, slopes)


def undeclared(inputs, workdir):
    return np.stack([S, inputs["load"] * KERNEL @ (1 / inputs["E"])], axis=1)


CALLS: list[float] = []


def pulled(inputs, workdir=None):
    """The strip with an adjoint solver in place of derivatives."""

    def vjp(factors):
        CALLS.append(float(np.abs(factors[""]).sum()))
        E, load, by = inputs["E"], inputs["load"], factors[""][:, 1]
        return {"E": -load * by @ KERNEL / E**2, "load": by @ KERNEL @ (1 / E)}

    return replace(Strip()(inputs), vjp=vjp)


pulled.sensitivities, pulled.inputs, pulled.fingerprint = True, Strip.inputs, "test:pulled"
strip = Strip()
