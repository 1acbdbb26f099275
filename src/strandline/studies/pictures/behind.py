"""The picture behind the interfaces, on the live page and in the report."""

import base64
import io
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from strandline.studies.study import Study

__all__ = ["picture_behind", "picture_png", "pictures_in_page"]

DARKEST = 0.5, 99.5
"""Percentiles of the grey values that are shown black and white."""
MOST_PIXELS, MOST_IN_PAGE = 1600, 1000
"""Longest side of a picture on the live page and in a report, pixels."""
QUALITY = 80
"""Quality of the JPEG in a report."""


def picture_behind(study: Study, condition: str, source: str) -> dict[str, Any] | None:
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
        "source": source,
    }


def picture_png(study: Study, condition: str) -> bytes | None:
    """Return a condition's picture in grey, made smaller if it is large; None if it has none."""
    found = study.pictures.get(condition)
    return None if found is None else _saved(_small(found.picture.values, MOST_PIXELS), "PNG")


def pictures_in_page(study: Study) -> dict[str, dict[str, Any]]:
    """Return the pictures by condition as `picture_behind` does, each with a small JPEG as its address."""
    out = {}
    for condition, found in study.pictures.items():
        jpeg = _saved(_small(found.picture.values, MOST_IN_PAGE), "JPEG", quality=QUALITY)
        source = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode('ascii')}"
        behind = picture_behind(study, condition, source)
        if behind is not None:
            out[condition] = behind
    return out


def _small(values: Float[np.ndarray, "row column"], most: int) -> Image.Image:
    """Return the picture in grey; of a large one, each pixel is the mean of those that it stands for."""
    some = values[:: -(-values.shape[0] // most), :: -(-values.shape[1] // most)]
    black, white = np.nanpercentile(some, DARKEST)
    share = np.nan_to_num((values - black) / max(white - black, 1e-12))
    image = Image.fromarray(np.round(255 * np.clip(share, 0.0, 1.0)).astype(np.uint8))
    image.thumbnail((most, most), Image.Resampling.BOX)
    return image


def _saved(image: Image.Image, kind: str, **options: Any) -> bytes:
    out = io.BytesIO()
    image.save(out, kind, **options)
    return out.getvalue()
