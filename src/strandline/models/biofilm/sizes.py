"""Element sizes: by the mesh's name, and smaller where a narrow gap or a sharp bend of the outline requires it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.interface import Interface
from strandline.models.biofilm.channel import ON_WALL, Channel

__all__ = ["FINER", "MESHES", "MeshSize", "gap_sizes", "is_adapted", "segment_sizes"]


@dataclass(frozen=True)
class MeshSize:
    """Largest element sizes, mm: away from the interface, along it, at its two feet; `grading` as in Netgen."""

    far: float
    interface: float
    foot: float
    grading: float


MESHES = {
    "coarse": MeshSize(far=0.25, interface=0.075, foot=0.015, grading=0.7),
    "default": MeshSize(far=0.1, interface=0.0225, foot=0.01, grading=0.3),
    "fine": MeshSize(far=0.05, interface=0.0112, foot=0.005, grading=0.25),
}
"""Element sizes by the name used in study files.

The nodes of the study's outline are 0.022 mm apart, so `interface` of ``coarse`` affects only base and inner edges
there. Its values are the best of several hundred; values close to them make up to three times the error, at random.
Measure every change with ``python -m verification.validation.biofilm_mesh``, and on other outlines with
``python -m verification.validation.mesh_on_other_outlines``.
"""

FINER = {
    "coarse": MESHES["default"],
    "default": MESHES["fine"],
    "fine": MeshSize(far=0.035, interface=0.0075, foot=0.0033, grading=0.22),
}
"""The next finer element sizes by the name of a mesh."""

NARROW = 0.5
"""Free height between the outline and the top, mm, below which elements get smaller; it is 0.53 in the study."""
SHARE = 0.25
"""Largest element in a narrow gap, as a share of the free height."""
SHARP = 12.0
"""Angle between two segments, degrees, above which they get more elements; at most 9.8 in the study."""
PER_SEGMENT = 4
"""Elements on a segment that meets another one at a sharp angle."""
_MOST = 2000

Places = Float[np.ndarray, "place 3"]


def gap_sizes(interface: Interface, size: MeshSize, channel: Channel) -> Places:
    """Return (x, y, largest element), mm, at places between outline and top; none if the flow has room.

    For a layer, or a bump within half a millimetre of the top, the free height gets as many elements as half a
    millimetre has with `size`, and at least four.
    """
    free = channel.height - interface.points[:, 1]
    on_floor = interface.points[[0, -1], 1] < ON_WALL
    if on_floor.all() and free.min() >= NARROW:
        return np.empty((0, 3))
    share = min(SHARE, size.far / NARROW)
    number = int(np.ceil(interface.lengths.sum() / (share * free.min())))
    x, y = interface.resampled(int(np.clip(number, len(interface.points), _MOST))).points.T
    free = channel.height - y
    small = share * free < size.far
    x, y, free = x[small], y[small], free[small]
    return np.concatenate([np.stack([x, y + part * free, share * free], axis=1) for part in (0.5, 1.0)])


def segment_sizes(interface: Interface, size: MeshSize) -> Float[np.ndarray, " cell"]:
    """Return the largest element on each segment of the outline, mm: finest at the feet and at sharp bends."""
    sizes = np.full(len(interface.lengths), size.interface)
    sizes[_beside_floor(interface)] = size.foot
    sizes[[0, -1]] = size.foot
    sharp = _sharp(interface)
    return np.where(sharp, np.minimum(sizes, interface.lengths / PER_SEGMENT), sizes)


def is_adapted(interface: Interface, size: MeshSize, channel: Channel) -> bool:
    """Return whether the outline requires smaller elements than those of the mesh's name."""
    return bool(_sharp(interface).any()) or len(gap_sizes(interface, size, channel)) > 0


def _on_floor(interface: Interface) -> np.ndarray:
    """Return which segments lie on the floor, between two bodies, (segment,)."""
    return np.asarray(np.maximum(np.abs(interface.starts[:, 1]), np.abs(interface.ends[:, 1])) < ON_WALL)


def _beside_floor(interface: Interface) -> np.ndarray:
    """Return which segments meet the floor between two bodies, (segment,)."""
    floor = _on_floor(interface)
    return np.asarray(np.append(floor[1:], False) | np.insert(floor[:-1], 0, False))


def _sharp(interface: Interface) -> np.ndarray:
    """Return which segments meet a neighbour at a sharp angle, (segment,)."""
    dx, dy = (interface.ends - interface.starts).T
    turn = np.abs((np.diff(np.degrees(np.arctan2(dy, dx))) + 180.0) % 360.0 - 180.0) > SHARP
    floor = _on_floor(interface)
    turn &= ~(floor[1:] | floor[:-1])
    return np.asarray(np.append(turn, False) | np.insert(turn, 0, False))
