"""Sums of residuals for which shift, rotation, scale and offset of the observation are estimated first.

Residuals r are linear in these global errors g only as long as a shift t is small: t²/(2R) is the error for radius of
curvature R. So g is estimated for each simulated interface, the interface follows the observation by g, and the
residuals r' of the moved one take the place of r. With r' = e + B (g_true - g), q = r' + B g = e + B g_true is what
the residuals would be if they were linear. This holds for any g near the most probable one: two steps with some
of the observed points lead there. An offset along the normals is linear however large it is: no interface follows it.
"""

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

__all__ = ["ROUGH", "Rows", "Sums", "linear_sums"]

Rows = Mapping[str, Float[np.ndarray, "run point xyz"]]
"""Points of simulated interfaces by condition, one interface a row, mm."""
Sums = tuple[Float[np.ndarray, " run"], Float[np.ndarray, "run error"]]
"""rᵀ D⁻¹ r and Bᵀ D⁻¹ r of each run."""
ROUGH = 64
"""Places along an observed polyline that estimate g, about."""


def linear_sums(
    points: Rows,
    sums: Callable[[Rows, bool], Sums],
    estimate: Callable[[Float[np.ndarray, "run error"]], Float[np.ndarray, "run error"]],
    followed: Callable[[Rows, Float[np.ndarray, "run error"]], Rows],
    gram: Float[np.ndarray, "error error"],
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
    """
    if not gram.any():
        return sums(points, False)
    g = estimate(sums(points, True)[1])
    g = estimate(sums(followed(points, g), True)[1] + g @ gram)
    squares, products = sums(followed(points, g), False)
    more = g @ gram
    return squares + 2 * (products * g).sum(axis=1) + (more * g).sum(axis=1), products + more
