"""A measure on very many simulated interfaces of the same cells at once: what a sampler asks for."""

import numpy as np
from jaxtyping import Float

from strandline.discrepancy.protocol import ComparesMany, Discrepancy
from strandline.interface import Interface

__all__ = ["squared_discrepancies"]


def squared_discrepancies(
    measure: Discrepancy, points: Float[np.ndarray, "run point xyz"], template: Interface, observed: Interface
) -> Float[np.ndarray, " run"]:
    """Return d² of each of the interfaces with these points and the cells of `template`.

    Orientation is that of the template.

    Raises:
        InvalidInterface: as the measure does.
    """
    found = measure.many(points, template, observed) if isinstance(measure, ComparesMany) and len(points) else None
    if found is not None:
        return np.asarray(found)
    return np.array([measure(Interface(row, template.cells), observed) for row in points], float)
