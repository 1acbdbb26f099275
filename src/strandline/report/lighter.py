"""Pictures of a page with fewer pixels, so that the page stays small enough to be sent."""

import base64
import io
from collections.abc import Iterable

from PIL import Image

__all__ = ["fitted"]


def fitted(pictures: Iterable[str], room: int) -> list[str]:
    """Return pictures that fit into so many characters: the largest ones have half their resolution, or all have.

    Args:
        pictures: PNG files as base64.
        room: Characters for all of them.
    """
    out = list(pictures)
    total = sum(map(len, out))
    for i in sorted(range(len(out)), key=lambda i: -len(out[i])):
        if total <= room:
            break
        smaller = _halved(out[i])
        total -= len(out[i]) - len(smaller)
        out[i] = smaller
    return out


def _halved(data: str) -> str:
    """Return a picture with half of its pixels in each direction, unless that needs more bytes."""
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
        picture.reduce(2).save(buffer, format="png", optimize=True)
    return min(base64.b64encode(buffer.getvalue()).decode("ascii"), data, key=len)
