"""A small study that takes seconds: a bent beam with two inputs, written as a study folder.

The model lives in an importable module because worker processes must be able to load it.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from strandline.foundations import ForwardModelError
from strandline.interface import Interface
from strandline.models import ModelInput, Simulation
from strandline.testing.models import Cantilever, TwoLoads

NODES = 17


def undeclared_beam(inputs: Mapping[str, float], workdir: Path) -> Simulation:
    """Return the centre line of a cantilever that is bent by a force and tilted at its clamp, mm.

    ``y(x) = F x² (3L - x) / (6 E I) + tilt·x`` on 17 nodes; `Cantilever` computes the first term. It is linear in 1/E
    and in the tilt, so a sum of squares at the nodes is a quadratic form of both.

    Raises:
        ForwardModelError: ``large_deflection`` if the tip moves by more than the beam's length.
    """
    shape = Cantilever()
    x = np.linspace(0.0, shape.length, NODES)
    y = shape.deflection(x, inputs["E"], inputs["load"]) + inputs["tilt"] * x
    tip = float(y[-1])
    if abs(tip) > shape.length:
        raise ForwardModelError("large_deflection", f"the tip would move by {tip:.3g} mm", {"tip": tip})
    return Simulation.of(Interface.polyline(np.stack([x, y], axis=1)), {"tip": tip})


class _Beam:
    """`undeclared_beam` with its inputs declared."""

    fingerprint = "test:beam-1"
    inputs = (
        ModelInput("E", "Pa", 0.0, np.inf, low_included=False, meaning="Young's modulus"),
        ModelInput("tilt", "1", -1.0, 1.0, meaning="slope at the clamp"),
        ModelInput("load", "N/m", -np.inf, np.inf, meaning="force at the tip, per depth"),
    )

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        return undeclared_beam(inputs, workdir)


beam = _Beam()
"""The forward model of `BEAM_STUDY`."""

BEAM_STUDY: Mapping[str, Any] = {
    "version": 1,
    "name": "beam",
    "model": {"python": {"function": "strandline.testing.studies:beam"}},
    "fixed": {"load": 1e-5},
    "inputs": {
        "E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"},
        "tilt": {"prior": {"uniform": [0.0, 0.04]}},
    },
    "observation": {"synthetic": {"E": 400, "tilt": 0.02, "load": 1e-5}},
    "discrepancy": {"tracked_points": {}},
    "noise": {"sd": 0.003},
    "design": {"sobol": {"runs": 64}},
    "sampler": {"smc": {"particles": 4000, "rejuvenation_steps": 5, "zeta": 0.6}},
    "executor": {"local": {"workers": 1, "timeout": 60}},
    "seed": 1,
}
"""The content of its study.yaml."""

two_loads = TwoLoads()
"""The forward model of `TWO_LOADS_STUDY`."""

TWO_LOADS_STUDY: Mapping[str, Any] = {
    "name": "two-loads",
    "model": {"python": {"function": "strandline.testing.studies:two_loads"}},
    "fixed": {"load": 1e-5},
    "inputs": {"E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"}},
    "observation": {"synthetic": {"E": 400, "load": 1e-5}},
    "noise": {"sd": 0.01},
    "design": {"sobol": {"runs": 24}},
}
"""Changes to `BEAM_STUDY` for a study of two conditions."""


def write_study(folder: Path, **changes: Any) -> Path:
    """Write `BEAM_STUDY` with some of its keys changed into `folder`, created if needed, and return the folder.

    A value of None removes the key.
    """
    content = {key: value for key, value in {**BEAM_STUDY, **changes}.items() if value is not None}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "study.yaml").write_text(json.dumps(content, indent=2), encoding="utf-8")
    return folder
