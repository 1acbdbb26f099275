"""A small drawing of a polyline, for notebooks."""

import numpy as np
from jaxtyping import Float

WIDTH, MARGIN = 420.0, 8.0
"""Width of the drawing and of its margin, pixels."""
LEAST, MOST = 40.0, 420.0
"""Smallest and largest height, pixels."""


def drawn(points: Float[np.ndarray, "point 2"]) -> str:
    """Return an SVG of the polyline through some points, y upwards, with equal scales along both axes."""
    low, sides = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-300)
    scale = min((WIDTH - 2 * MARGIN) / sides[0], (MOST - 2 * MARGIN) / sides[1])
    height = max(scale * float(sides[1]) + 2 * MARGIN, LEAST)
    x, y = (scale * (points - low)).T
    places = " ".join(
        f"{a + MARGIN:.1f},{height - MARGIN - b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH:.0f}" height="{height:.0f}" role="img" '
        f'aria-label="polyline of {len(points)} points">'
        f'<polyline points="{places}" fill="none" stroke="#0072B2" stroke-width="2"/></svg>'
    )
