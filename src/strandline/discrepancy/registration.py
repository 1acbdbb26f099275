"""Sums of residuals for which shift, rotation, scale and offset of the observation are estimated first.

Residuals r are linear in these global errors g only as long as a shift t is small: t²/(2R) is the error for radius of
curvature R. So g is estimated for each simulated interface, the interface follows the observation by g, and the
residuals r' of the moved one take the place of r. With r' = e + B (g_true - g), q = r' + B g = e + B g_true is what
the residuals would be if they were linear. This holds for any g near the most probable one, to which a step with some
of the observed points leads; far ones take two. An offset along the normals is linear however large it is: no interface
follows it.
"""

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Bool, Float

__all__ = ["FAR", "ROUGH", "Rows", "Sums", "linear_sums"]

Rows = Mapping[str, Float[np.ndarray, "run point xyz"]]
"""Points of simulated interfaces by condition, one interface a row, mm."""
Sums = tuple[Float[np.ndarray, " run"], Float[np.ndarray, "run error"]]
"""rᵀ D⁻¹ r and Bᵀ D⁻¹ r of each run."""
ROUGH = 64
"""Places along an observed polyline that estimate g, about."""
FAR = 0.01
"""Shift, as a share of the observation's extent, from which a second step is taken: the first one errs by t²/(2R)."""


def linear_sums(
    points: Rows,
    sums: Callable[[Rows, bool], Sums],
    estimate: Callable[[Float[np.ndarray, "run error"]], Float[np.ndarray, "run error"]],
    followed: Callable[[Rows, Float[np.ndarray, "run error"]], Rows],
    gram: Float[np.ndarray, "error error"],
    far: Callable[[Float[np.ndarray, "run error"]], Bool[np.ndarray, " run"]],
) -> Sums:
    """Return qᵀ D⁻¹ q and Bᵀ D⁻¹ q of each run.

    Args:
        points: Points of the simulated interfaces.
        sums: Function that returns rᵀ D⁻¹ r and Bᵀ D⁻¹ r for such points; roughly, from some of the observed points,
            if its second argument is true.
        estimate: Function that returns the most probable g from Bᵀ D⁻¹ r, with zeros for errors that no interface
            follows.
        followed: Function that returns the points after the observation's g.
        gram: Bᵀ D⁻¹ B.
        far: Function that returns whether g is so large that a second step is needed.
    """
    if not gram.any():
        return sums(points, False)
    g = estimate(sums(points, True)[1])
    again = np.flatnonzero(far(g))
    if len(again):
        some = {name: rows[again] for name, rows in points.items()}
        g[again] = estimate(sums(followed(some, g[again]), True)[1] + g[again] @ gram)
    squares, products = sums(followed(points, g), False) if g.any() else sums(points, False)
    more = g @ gram
    return squares + 2 * (products * g).sum(axis=1) + (more * g).sum(axis=1), products + more
