"""Normals, spacings and rotations at the points of an interface, steady where its points are noisy."""

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from strandline.interface.interface import Interface

GAP = 10.0
"""Length of a segment, in medians, from which it bridges a part that was not observed."""
_WINDOW = 2.0
"""Half the length over which a steady normal is taken, in the larger of spacing and correlation length."""


def as_complex(points: Float[np.ndarray, "*case 2"]) -> Complex[np.ndarray, "*case"]:
    """Return points of the plane as x + iy: turning and moving many of them is several times as fast."""
    return np.asarray(np.ascontiguousarray(points).view(complex)[..., 0])


def as_pairs(points: Complex[np.ndarray, "*case"]) -> Float[np.ndarray, "*case 2"]:
    """Return points x + iy as rows (x, y)."""
    return np.ascontiguousarray(points)[..., None].view(float)


def rotations(angles: Float[np.ndarray, "run axis"]) -> Float[np.ndarray, "run xyz xyz"]:
    """Return rotation matrices by angles in radians: by one in the plane, or by a rotation vector in space."""
    if angles.shape[1] == 3:
        return np.asarray(Rotation.from_rotvec(angles).as_matrix())
    c, s = np.cos(angles[:, 0]), np.sin(angles[:, 0])
    return np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)


def steady_lengths(polyline: Interface) -> Float[np.ndarray, " segment"]:
    """Return the length of each segment along the course of the polyline, mm.

    Errors of the points make segments longer, not their course: that of a chord over a few of them.
    """
    along = np.concatenate([[0.0], np.cumsum(polyline.lengths)])
    window = _WINDOW * float(np.median(polyline.lengths))
    normals = normals_at(polyline, 0.5 * (along[1:] + along[:-1]), window)
    step = polyline.ends - polyline.starts
    return np.asarray(np.abs(step[:, 0] * normals[:, 1] - step[:, 1] * normals[:, 0]))


def arc_lengths(polyline: Interface) -> Float[np.ndarray, " point"]:
    """Return the arc length at each point of a polyline, from its first point, along its course, mm."""
    return _at_points(polyline, steady_lengths(polyline))


def _at_points(polyline: Interface, lengths: Float[np.ndarray, " segment"]) -> Float[np.ndarray, " point"]:
    corners = np.append(polyline.cells[:, 0], polyline.cells[-1, 1])
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    places = np.zeros(len(polyline.points))
    places[corners[::-1]] = along[::-1]
    return places


def spacings(interface: Interface, *, gaps: bool = True) -> Float[np.ndarray, " point"]:
    """Return the mean length of the segments at each point, mm, or a third of the area of its triangles, mm².

    Lengths are those along the course of the polyline.

    Args:
        interface: A polyline or a triangulated surface.
        gaps: Whether segments across parts of a polyline that were not observed count.
    """
    total, number = np.zeros(len(interface.points)), np.zeros(len(interface.points))
    sizes = interface.sizes if interface.dim == 3 else steady_lengths(interface)
    counts = np.ones(len(sizes)) if gaps or interface.dim == 3 else (sizes < GAP * np.median(sizes)).astype(float)
    for corner in range(interface.cells.shape[1]):
        np.add.at(total, interface.cells[:, corner], sizes * counts)
        np.add.at(number, interface.cells[:, corner], counts)
    if interface.dim == 3:
        return np.asarray(total / 3)
    alone = number == 0  # a point between two gaps
    return np.asarray(np.where(alone, sizes.max(), total / np.where(alone, 1.0, number)))


def point_normals(interface: Interface, window: float) -> Float[np.ndarray, "point xyz"]:
    """Return a unit normal at each point, on the side of `Interface.normals`.

    Segments and triangles of noisy points turn by their noise over their size. So the normal is that of the chord
    between the places `window` mm before and behind the point, or the mean over the triangles less than `window` mm
    away.
    """
    if interface.dim == 2:
        return normals_at(interface, _at_points(interface, interface.lengths), window)
    areas = interface.normals
    own = np.zeros_like(interface.points)
    for corner in range(3):
        np.add.at(own, interface.cells[:, corner], areas)
    near = cKDTree(interface.centres).query_ball_point(interface.points, window)
    normal = np.array([areas[some].sum(axis=0) if some else one for some, one in zip(near, own, strict=True)])
    cancelled = np.linalg.norm(normal, axis=1) < 0.5 * np.linalg.norm(own, axis=1)  # these have their own triangles'
    normal = np.where(cancelled[:, None], own, normal)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def node_normals(
    points: Float[np.ndarray, "run node xyz"], cells: Int[np.ndarray, "cell corner"]
) -> Float[np.ndarray, "run node xyz"]:
    """Return unit normals at the nodes of many smooth interfaces with the same cells, on the side of their normals."""
    touching = csr_array((np.ones(cells.size), (cells.ravel(), np.repeat(np.arange(len(cells)), cells.shape[1]))))
    if points.shape[2] == 2:
        places = as_complex(points)
        turned = touching @ (1j * (places[:, cells[:, 1]] - places[:, cells[:, 0]])).T
        return as_pairs((turned / np.abs(turned)).T)
    first = points[:, cells[:, 0]]
    area = np.cross(points[:, cells[:, 1]] - first, points[:, cells[:, 2]] - first)
    total = touching @ area.transpose(1, 0, 2).reshape(len(cells), -1)
    normal = total.reshape(points.shape[1], len(points), -1).transpose(1, 0, 2)
    return np.asarray(normal / np.linalg.norm(normal, axis=2, keepdims=True))


def steady_normals(seen: Interface, length: float = 0.0) -> Float[np.ndarray, "point xyz"]:
    """Return unit normals at observed points, over as many of them as errors of this correlation length need."""
    spacing = float(np.median(spacings(seen)))
    return point_normals(seen, _WINDOW * max(length, spacing if seen.dim == 2 else float(np.sqrt(spacing))))


def normals_at(polyline: Interface, places: Float[np.ndarray, " place"], window: float) -> Float[np.ndarray, "place 2"]:
    """Return unit normals at places along a polyline, on the side of `Interface.normals`.

    Args:
        polyline: The polyline.
        places: Arc lengths from its first node, mm.
        window: Half the length of the piece whose chord is taken, mm; at most a fifth of the polyline counts.
    """
    path = polyline.points[np.append(polyline.cells[:, 0], polyline.cells[-1, 1])]
    along = np.concatenate([[0.0], np.cumsum(polyline.lengths)])
    whole = float(along[-1])
    window = min(window, 0.2 * whole)

    def at(s: Float[np.ndarray, " place"]) -> Float[np.ndarray, "place 2"]:
        s = s % whole if polyline.closed else np.clip(s, 0.0, whole)
        return np.stack([np.interp(s, along, path[:, axis]) for axis in (0, 1)], axis=1)

    chord = at(places + window) - at(places - window)
    normal = np.stack([-chord[:, 1], chord[:, 0]], axis=1)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))
