"""The picture behind the interfaces of the page."""

import io
from typing import Any
from urllib.parse import urlencode

import numpy as np
from jaxtyping import Float
from matplotlib import image

from strandline.studies.study import Study

__all__ = ["picture_behind", "picture_png"]

DARKEST = 0.5, 99.5
"""Percentiles of the grey values that are shown black and white."""
MOST_PIXELS = 1600
"""Longest side of a picture on the page, pixels."""


def picture_behind(study: Study, condition: str) -> dict[str, Any] | None:
    """Return size, place and address of a condition's picture; None if it has none.

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
        "source": f"api/picture?{urlencode({'condition': condition})}",
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
