"""Outputs in steps: a simulator that prints few digits, or whose interface jumps from cell to cell of its mesh."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.interface import Interface

ALIKE = 0.5
"""Share of the values of a run that other runs must meet too. Of smooth outputs, hardly any; 1 where few steps are."""
ROUNDING = 1e-9
"""Share of their range by which equal values may differ."""
SMOOTH = 0.1
"""Residual of quadratics of the inputs, in steps, below which values are not rounded: rounding leaves 0.29. The inputs
of a Sobol design are fractions, and so are simple functions of them."""


@dataclass(frozen=True)
class OutputSteps:
    """The distance of neighbouring values, mm, of one coordinate of an interface: x, y or z."""

    condition: str
    axis: str
    step: float


def steps_of(runs: Sequence[Mapping[str, Interface]], inputs: Float[np.ndarray, "run dim"]) -> list[OutputSteps]:
    """Return the coordinates that move from run to run but meet the same values again and again.

    Numbers that follow the inputs smoothly do not repeat. Nothing is found if the runs differ in their number of points
    or if the inputs repeat themselves, as those of a grid do.
    """
    if any(len(np.unique(column)) < len(runs) for column in inputs.T):
        return []
    found = []
    for condition in runs[0]:
        shapes = [run[condition].points for run in runs]
        if len({shape.shape for shape in shapes}) > 1:
            continue
        for axis, values in zip("xyz", np.moveaxis(np.stack(shapes), -1, 0), strict=False):
            moving = values[:, np.ptp(values, axis=0) > 0]
            step = _step(moving)
            if step and _residual(moving, inputs) > SMOOTH * step:
                found.append(OutputSteps(condition, axis, step))
    return found


def _step(values: Float[np.ndarray, "run node"]) -> float:
    """Return the typical distance of neighbouring values if runs share most of them, else 0."""
    if not values.size:
        return 0.0
    whole = np.round(values / (ROUNDING * np.ptp(values)))
    met, times = np.unique(np.concatenate([np.unique(row) for row in whole]), return_counts=True)
    if times[times > 1].sum() < ALIKE * times.sum():
        return 0.0
    return float(np.median(np.diff(met))) * ROUNDING * float(np.ptp(values))


def _residual(values: Float[np.ndarray, "run node"], inputs: Float[np.ndarray, "run dim"]) -> float:
    """Return the root mean square of what quadratic functions of the inputs leave of the values, or linear ones."""
    z = (inputs - inputs.mean(axis=0)) / inputs.std(axis=0)
    i, j = np.triu_indices(z.shape[1])
    terms = np.column_stack([np.ones(len(z)), z, z[:, i] * z[:, j]])
    if 2 * terms.shape[1] > len(z):
        terms = terms[:, : 1 + z.shape[1]]
    left = values - terms @ np.linalg.lstsq(terms, values)[0]
    return float(np.sqrt(np.mean(left**2)))
