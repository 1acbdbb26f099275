"""A measure evaluated on very many simulated interfaces with the same cells at once, as a sampler needs it."""

import numpy as np
from jaxtyping import Float

from strandline.discrepancy.protocol import ComparesMany, Discrepancy
from strandline.interface import Interface

__all__ = ["squared_discrepancies"]


def squared_discrepancies(
    measure: Discrepancy, points: Float[np.ndarray, "run point xyz"], template: Interface, observed: Interface
) -> Float[np.ndarray, " run"]:
    """Return d² of each interface with these points and the cells of `template`.

    The orientation is that of the template.

    Raises:
        InvalidInterface: as the measure does.
    """
    found = measure.many(points, template, observed) if isinstance(measure, ComparesMany) and len(points) else None
    if found is not None:
        return np.asarray(found)
    return np.array([measure(Interface(row, template.cells), observed) for row in points], float)
