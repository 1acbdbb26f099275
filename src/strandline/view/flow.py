"""Velocity, pressure and displacement of the built-in model, on a grid that the page can draw."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.tri import LinearTriInterpolator, Triangulation

from strandline.models.protocol import ForwardModel

__all__ = ["flow_on_grid"]

COLUMNS = 240
"""Columns of the grid."""
DIGITS = 4


def flow_on_grid(model: ForwardModel, inputs: Mapping[str, float], condition: str) -> dict[str, Any]:
    """Make a run of the built-in model, and return its fields on a regular grid; None outside the cell.

    Args:
        model: The model.
        inputs: All inputs by name.
        condition: Name of a condition; empty if there is only one.

    Raises:
        ForwardModelError: The run fails.
        InvalidInput: The model has no fields.
    """
    plain: Any = model
    fields = plain.fields(inputs, condition) if condition else plain.fields(inputs)
    (left, low), (right, high) = fields.points.min(axis=0), fields.points.max(axis=0)
    rows = max(2, round(COLUMNS * (high - low) / (right - left)))
    x, y = np.linspace(left, right, COLUMNS), np.linspace(low, high, rows)
    grid = np.meshgrid(x, y)
    fluid, solid = fields.cell_part == 0, fields.cell_part > 0
    values = {
        "speed": (np.linalg.norm(fields.velocity, axis=1), fluid, "mm/s"),
        "pressure": (fields.pressure, fluid, "Pa"),
        "displacement": (np.linalg.norm(fields.displacement, axis=1), solid, "mm"),
    }
    return {
        "x": np.round(x, 5).tolist(),
        "y": np.round(y, 5).tolist(),
        "fields": {
            name: {"unit": unit, "values": _on_grid(fields.points, fields.triangles[cells], one, grid)}
            for name, (one, cells, unit) in values.items()
            if cells.any()
        },
    }


def _on_grid(
    points: Float[np.ndarray, "point 2"], triangles: Any, values: Float[np.ndarray, " point"], grid: Sequence[Any]
) -> list[list[float | None]]:
    """Return nodal values interpolated at the grid's points, row by row."""
    found = LinearTriInterpolator(Triangulation(points[:, 0], points[:, 1], triangles), values)(*grid)
    return [
        [None if hidden else float(f"{value:.{DIGITS}g}") for value, hidden in zip(row, masked, strict=True)]
        for row, masked in zip(found.data.tolist(), np.ma.getmaskarray(found).tolist(), strict=True)
    ]
