"""A measure on very many simulated interfaces of the same cells at once: what a sampler asks for."""

from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.discrepancy.protocol import Discrepancy
from strandline.interface import Interface

__all__ = ["squared_discrepancies"]


def squared_discrepancies(
    measure: Discrepancy, points: Float[np.ndarray, "run point xyz"], template: Interface, observed: Interface
) -> Float[np.ndarray, " run"]:
    """Return d² of each of the interfaces with these points and the cells of `template`.

    A measure that can do better than one after the other has a method ``many(points, template, observed)``, which
    returns None for interfaces that it has no such way for. Orientation is that of the template.

    Raises:
        InvalidInterface: as the measure does.
    """
    many: Any = getattr(measure, "many", None)
    found = None if many is None or not len(points) else many(points, template, observed)
    if found is not None:
        return np.asarray(found)
    return np.array([measure(Interface(row, template.cells), observed) for row in points], float)
