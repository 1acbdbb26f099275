"""Flow cells of the tests, and how they are compared."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.errors import ForwardModelError
from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition

INPUTS = {"E": 400.0, "nu": 0.3, "V_in": 100.0}
SOLID = {"E": 400.0, "nu": 0.3}


def coarse_cell(law: str = "saint_venant_kirchhoff", **options: Any) -> FlowCell:
    """Return the study's flow cell on the coarse mesh."""
    usual = {"channel": Channel(), "partition": Partition(), "law": LAWS[law]}
    mesh = MESHES[options.pop("mesh", "coarse")]
    return FlowCell(options.pop("outline", Outline()).interface(), mesh, **(usual | options))


def rough_cell(law: str = "saint_venant_kirchhoff", **options: Any) -> FlowCell:
    """Return a flow cell of few elements."""
    return coarse_cell(law, mesh="rough", outline=Outline(nodes=8), **options)


def coarse(**options: Any) -> Biofilm:
    """Return the model on the coarse mesh with the options of a study file."""
    return Biofilm.from_options(**{"mesh": "coarse", **options})


def rough(**options: Any) -> Biofilm:
    """Return the model on a mesh of few elements, with an outline of few nodes."""
    return coarse(**{"mesh": "rough", "outline": {"nodes": 8}, **options})


def moved(model: Biofilm, inputs: Mapping[str, float]) -> np.ndarray:
    """Return the displacements of the interface."""
    return np.asarray(model(inputs).interface.points - model.undeformed().points)


def largest(points: np.ndarray) -> float:
    return float(np.linalg.norm(points, axis=1).max())


def mirrored(points: np.ndarray) -> np.ndarray:
    return points[::-1] * [-1, 1]


def failure(run: Callable[..., object], *arguments: object, **options: object) -> ForwardModelError:
    with pytest.raises(ForwardModelError) as caught:
        run(*arguments, **options)
    return caught.value


def importable(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, source: str) -> str:
    """Write a third party's module and return its name."""
    (folder / f"{name}.py").write_text(source, "utf-8")
    monkeypatch.syspath_prepend(folder)
    return name


def sensitivity_error(model: Biofilm, inputs: Mapping[str, float]) -> float:
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
