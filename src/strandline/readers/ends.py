"""Whether a list of points closes."""

import numpy as np
from jaxtyping import Float

from strandline.readers.contents import refused

Chain = Float[np.ndarray, "point 2"]
CLOSING = 1e-3
"""Distance of a last point from the first, in median distances of neighbours, up to which an outline is closed."""
CLOSE, GAP = 1.5, 0.1
"""Distance of ends that nearly meet, at most, in median distances of neighbours and as a share of the length."""
STRAIGHT = 0.5
"""Cosine of the angles to its neighbours, at least, of a segment that would go on as a ring does."""
REMEDY = "Say `closed: true`, as for outlines of OpenCV, or `closed: false`."


def repeats_first(chain: Chain) -> bool:
    """Return whether a chain repeats its first point at its end, but for rounding."""
    if len(chain) <= 3:
        return False
    lengths = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    return bool(np.linalg.norm(chain[0] - chain[-1]) <= CLOSING * np.median(lengths))


def require_clear_ends(chain: Chain, name: str, remedy: str = REMEDY) -> None:
    """Refuse an outline that may be closed: its ends are as near as neighbours, or one more segment makes it a ring."""
    if len(chain) < 3:
        return
    steps = np.diff(chain, axis=0, append=chain[:1])
    *lengths, gap = map(float, np.linalg.norm(steps, axis=1))
    usual = float(np.median(lengths))
    straight = [steps[-1] @ steps[k] >= STRAIGHT * gap * size for k, size in ((0, lengths[0]), (-2, lengths[-1]))]
    if (all(straight) and gap <= CLOSE * max(lengths)) or gap <= min(GAP * sum(lengths), CLOSE * usual):
        value, expected = f"{gap:.3g} mm apart, neighbours {usual:.3g} mm", "an outline that is clearly open or closed"
        raise refused(f"{name} ends near its first point and does not repeat it", value, expected, remedy)
