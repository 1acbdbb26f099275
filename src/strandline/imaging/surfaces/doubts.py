"""When a stack says too little about a surface: one line that says what is missing."""

from strandline.errors import InvalidInput
from strandline.imaging.surfaces.surface_errors import SurfaceErrors

__all__ = ["FEWEST", "require_left", "require_surface", "require_triangles"]

FEWEST = 100
"""Fewest triangles of a surface."""
FEWEST_LEFT = 10
"""Fewest triangles beside the regions that are left out."""
LEAST_CONTRAST = 2.0
"""Smallest contrast to noise of a voxel."""
MOST_OPEN = 0.5
"""Largest share of the surface of the solid that the faces of the stack cut off."""
LOST = 0.02
"""Largest share of the points without a crossing of the half level nearby."""


def require_triangles(number: int) -> None:
    """Refuse a surface of fewer than 100 triangles.

    Raises:
        InvalidInput: It has fewer.
    """
    if number < FEWEST:
        raise InvalidInput(
            "number of triangles of the surface",
            value=number,
            expected=f"at least {FEWEST}",
            remedy="Use a stack with smaller voxels, or ask for more `triangles`.",
        )


def require_left(number: int) -> None:
    """Refuse regions that leave out nearly all of a surface.

    Raises:
        InvalidInput: Fewer than 10 triangles are left.
    """
    if number < FEWEST_LEFT:
        raise InvalidInput(
            "number of triangles outside of the regions to exclude",
            value=number,
            expected=f"at least {FEWEST_LEFT}",
            remedy="Exclude less, and check the frame in whose coordinates the regions are given.",
        )


def require_surface(errors: SurfaceErrors, lost: float) -> None:
    """Refuse a surface of which the stack says too little.

    Args:
        errors: Errors of its points.
        lost: Share of the points without a crossing of the half level nearby.

    Raises:
        InvalidInput: Contrast to noise below 2, a solid cut off by the faces of the stack over most of its surface, or
            more than 2 % of the points without an edge.
    """
    if not errors.contrast_to_noise >= LEAST_CONTRAST:
        raise InvalidInput(
            "contrast over noise at the surface",
            value=f"{errors.contrast_to_noise:.3g}",
            expected=f"at least {LEAST_CONTRAST:g}",
            remedy="Use a stack with less noise, e.g. the mean of several.",
        )
    if errors.open_share > MOST_OPEN:
        raise InvalidInput(
            "surface cut off by the faces of the stack",
            value=f"{100 * errors.open_share:.0f} % of the solid's surface",
            expected=f"at most {100 * MOST_OPEN:g} %",
            remedy="Use a larger stack, or check `solid: bright` or `dark`.",
        )
    if lost > LOST:
        raise InvalidInput(
            "points of the surface without an edge nearby",
            value=f"{100 * lost:.1f} % of them",
            expected=f"at most {100 * LOST:g} %",
            remedy="Use a stack with less noise or more even light.",
        )
