"""The interface at any inputs, as the surrogate predicts it, with a band."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.design.active import Knowledge
from strandline.interface import Interface
from strandline.report.outlines import SDS, band, offsets_um, outline, point_normals

__all__ = ["predicted"]


def predicted(
    knowledge: Knowledge, x: Float[np.ndarray, " dim"], observed: Mapping[str, Interface]
) -> dict[str, dict[str, Any]]:
    """Return by condition the predicted polyline, the surrogate's standard deviation along its normals, and offsets.

    Args:
        knowledge: What is known of the interface.
        x: The inputs.
        observed: Observed interfaces by condition.
    """
    surrogate, out = knowledge.surrogate, {}
    interfaces, variances = surrogate.interfaces(x), surrogate.predict(x[None]).variance[0]
    fields = surrogate.modes.basis / surrogate.modes.roots
    parts = surrogate.by_condition(fields)
    for name, interface in interfaces.items():
        along = np.einsum("mpx,px->mp", parts[name], point_normals(interface))
        sd = np.sqrt(variances @ along**2 + surrogate.modes.remainder**2)
        out[name] = {
            "line": outline(interface),
            "band": band(interface, SDS * sd),
            "sd_um": float(f"{1e3 * float(np.sqrt(np.mean(sd**2))):.3g}"),
            "offsets": None if name not in observed else offsets_um(observed[name], interface),
        }
    return out
