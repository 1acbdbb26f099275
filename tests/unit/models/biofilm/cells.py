"""Flow cells of the tests, and how they are compared."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from strandline.foundations import ForwardModelError
from strandline.models.biofilm.cells.cell import FlowCell
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.mesh.geometry import MESHES, Partition
from strandline.models.biofilm.mesh.outline import Channel, Outline
from strandline.models.biofilm.model import Biofilm
from strandline.studies.keys.parse import made

SOLID = {"E": 400.0, "nu": 0.3}
INPUTS = SOLID | {"V_in": 100.0}
LAYER = Outline(((0.0, 0.3), (0.8, 0.35), (1.5, 0.6), (2.2, 0.35), (3.0, 0.3)))
"""A layer that covers the floor of a channel 3 mm long."""
PAIR = tuple((x + dx, y) for x in (0.8, 2.9) for dx, y in ((0.0, 0.0), (0.1, 0.3), (0.2, 0.3), (0.3, 0.0)))
"""Two bodies of four points each, in a channel 4 mm long."""
OWN = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.materials.isotropic import IsotropicLaw
from strandline.models.protocol import ModelInput

number = 3

def wrong(y, bottom, top):
    return np.ones(3)

def profile(y, bottom, top):
    return y - bottom

def plain(d, solid_pressure, young, poisson):
    return LAWS["neo_hookean"](d, solid_pressure, young, poisson)

def other(d, solid_pressure, young, poisson):
    return plain(d, solid_pressure, 2 * young, poisson)

class Bent(IsotropicLaw):
    def coefficients(self, invariant, log_volume, pressure, shear):
        return BENT(invariant, log_volume, pressure, shear)

class WithoutCoefficients(IsotropicLaw):
    pass

@dataclass(frozen=True)
class Bad:
    parameters: ClassVar = (ModelInput("k2", "1", 0.0, 1.0),)

    def __call__(self, d, solid_pressure, young, poisson, /, k2):
        return 0
"""
"""A third party's laws and profiles, some of them wrong."""


def coarse_cell(law="saint_venant_kirchhoff", mesh="coarse", outline=None) -> FlowCell:
    interface, options = (outline or Outline()).interface(), {"channel": Channel(), "partition": Partition()}
    return FlowCell(interface, MESHES[mesh], law=LAWS[law], **options)


def rough_cell(law="saint_venant_kirchhoff") -> FlowCell:
    return coarse_cell(law, mesh="rough", outline=Outline(nodes=8))


def coarse(**options) -> Biofilm:
    """Return the model on the coarse mesh with the options of a study file."""
    return made(Biofilm, {"mesh": "coarse", **options}, "model.biofilm")


def rough(**options) -> Biofilm:
    """Return the model on a mesh of few elements, with an outline of few nodes."""
    return coarse(**{"mesh": "rough", "outline": {"nodes": 8}, **options})


def moved(model: Biofilm, inputs) -> np.ndarray:
    return np.asarray(model(inputs).interface.points - model.undeformed().points)


def largest(points: np.ndarray) -> float:
    return float(np.linalg.norm(points, axis=1).max())


def failure(run, *arguments, **options) -> ForwardModelError:
    with pytest.raises(ForwardModelError) as caught:
        run(*arguments, **options)
    return caught.value


def sensitivity_error(model: Biofilm, inputs) -> float:
    """Return the error of the derivative in a direction that all inputs have a part in, as a share of the derivative.

    Against central differences with three steps, extrapolated to sixth order. Signs alternate, so that errors of two
    inputs do not cancel.
    """
    slopes = replace(model, sensitivities=True)(inputs).sensitivities[""]
    assert set(slopes) == set(inputs)
    scales = {name: _scale(name, value) * (-1) ** k for k, (name, value) in enumerate(inputs.items())}
    exact = sum(scales[name] * slopes[name] for name in inputs)

    def difference(h: float) -> np.ndarray:
        ends = [{name: value + s * h * scales[name] for name, value in inputs.items()} for s in (1, -1)]
        first, last = (model(end).interface.points for end in ends)
        return np.asarray((first - last) / (2 * h))

    d = [difference(h) for h in (4e-2, 2e-2, 1e-2)]
    once = [(4 * fine - rough) / 3 for rough, fine in pairwise(d)]
    return float(np.abs((16 * once[1] - once[0]) / 15 - exact).max() / np.abs(exact).max())


def _scale(name: str, value: float) -> float:
    """Return a change of an input that changes the interface little, but visibly."""
    kind = name.rstrip("0123456789")
    if kind == "nu":
        return 0.05
    return abs(value) if kind in ("E", "V_in", "p_drop", "viscosity", "density") else 8 * abs(value)
