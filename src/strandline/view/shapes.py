"""Interfaces as the page draws them: polylines in millimetres, and the picture behind them."""

import io
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import image

from strandline.discrepancy.normal_offset import signed_distances
from strandline.interface import Interface
from strandline.studies.study import Study

__all__ = ["offsets_um", "outline", "picture_behind", "picture_png"]

DECIMALS = 6
"""Of coordinates in mm: a nanometre."""
DARKEST = 0.5, 99.5
"""Percentiles of the grey values that are shown black and white."""
MOST_PIXELS = 1600
"""Longest side of a picture on the page, pixels."""


def outline(interface: Interface) -> list[list[float]]:
    """Return the points of a polyline in order, [[x, …], [y, …]], mm; the first one again at the end if it is closed.

    A surface is shown by its points.
    """
    if interface.dim != 2:
        return [np.round(column, DECIMALS).tolist() for column in interface.points.T]
    order = [*interface.cells[:, 0], interface.cells[-1, 1]]
    return [np.round(column, DECIMALS).tolist() for column in interface.points[order].T]


def offsets_um(observed: Interface, predicted: Interface) -> list[float] | None:
    """Return the signed distances of the observed points from a prediction, µm; None if they cannot be compared."""
    if observed.dim != predicted.dim:
        return None
    return [float(f"{1e3 * one:.4g}") for one in signed_distances(observed.points, predicted)]


def picture_behind(study: Study, condition: str) -> dict[str, Any] | None:
    """Return size and place of a condition's picture; None if it has none.

    A point m in mm lies at the pixel `matrix` m + `origin`.
    """
    found = study.pictures.get(condition)
    if found is None:
        return None
    rows, columns = found.picture.values.shape
    frame = found.frame
    return {
        "width": columns,
        "height": rows,
        "matrix": np.linalg.inv(frame.matrix).tolist(),
        "origin": list(frame.origin),
        "pixel": list(frame.pixel),
        "name": found.name,
    }


def picture_png(study: Study, condition: str) -> bytes | None:
    """Return a condition's picture in grey, made smaller if it is large; None if it has none."""
    found = study.pictures.get(condition)
    return None if found is None else _png(found.picture.values)


def _png(values: Float[np.ndarray, "row column"]) -> bytes:
    step = max(1, -(-max(values.shape) // MOST_PIXELS))
    small = values[::step, ::step]
    black, white = np.percentile(small, DARKEST)
    out = io.BytesIO()
    image.imsave(out, small, cmap="gray", vmin=black, vmax=max(white, black + 1e-12), format="png")
    return out.getvalue()
