"""Projection of the nodes of one triangulated surface onto another: along the normals, and from rim to rim.

Each node of the reference moves along its normal to the nearest crossing with the surface that faces the same side. The
nodes of its rim move to the closest points of the surface's rim; the others first follow them by the harmonic extension
of these displacements, so that a rim that moves within the surface pushes no triangles together. A closed surface has
no rim; the reference is first shifted to the centre of the other surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from hashlib import blake2b
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from strandline.discrepancy import Snapshot, closest_points, squared_distances
from strandline.interface import Interface, shortest_altitudes, triangle_sides, vector_areas

CANDIDATES = 8  # number of runs, counted from the first, whose surface may be the reference
FAR = 3.0
"""Largest distance of a crossing, relative to the nearest triangle's centre; beyond, the closest point is taken."""
FLAT = 0.01
"""Altitude over longest side, as a share of its value in the reference, below which a triangle counts as flat."""
TURNED = 0.01
"""Area over squared longest side, above which a triangle that faces back is turned over: slivers turn by rounding."""
_BRANCHES = 8  # number of parts that a box around triangles is divided into
_EDGE = 1e-9  # how far outside a triangle, in its coordinates, a line may pass, so that neighbours leave no gap

Points = Float[np.ndarray, "point 3"]
Cells = Int[np.ndarray, "cell 3"]
Lines = Float[np.ndarray, "line 3"]
Numbers = Int[np.ndarray, " pair"]
Sides = Int[np.ndarray, "side 2"]


class Topology(NamedTuple):
    """Properties of a surface that no displacement changes."""

    parts: int
    rims: int
    characteristic: int

    def __str__(self) -> str:
        return f"{self.parts} part(s), {self.rims} rim(s), Euler characteristic {self.characteristic}"


class Projection(NamedTuple):
    """The reference's nodes on a surface, mm, in the reference's order.

    The error is the root mean square distance of the surface's nodes from the triangles between the points, or of the
    nodes of its rim from the sides between the points of the rim, whichever is larger, mm.
    """

    points: Points
    error: float


@dataclass(frozen=True, eq=False)
class Reference:
    """The surface whose nodes stand for those of all, and their projections onto other surfaces so far."""

    surface: Interface
    known: dict[bytes, "Projection | str"] = field(default_factory=dict, repr=False)

    @cached_property
    def sides(self) -> Sides:
        return _rim(self.surface)

    @cached_property
    def topology(self) -> Topology:
        return _topology(self.surface)

    @cached_property
    def spread(self) -> Float[np.ndarray, "point rim"]:
        """Displacement of nodes if one of the rim moves by 1: harmonic along the surface; 0 on parts without a rim."""
        number, rim = len(self.surface.points), np.unique(self.sides)
        inner = np.setdiff1d(np.arange(number), rim)
        matrix = _laplacian(self.surface).tocsr()
        out = np.zeros((number, len(rim)))
        out[rim] = np.eye(len(rim))
        if len(rim) and len(inner):
            own = matrix[inner][:, inner]
            held = own + diags_array(np.full(len(inner), 1e-12 * own.diagonal().max()))
            out[inner] = splu(held.tocsc()).solve(-matrix[inner][:, rim].toarray())
        return out

    def on(self, surface: Interface) -> "Projection | str":
        """Return its nodes projected onto `surface`, whichever side that faces; or, in words, why that fails."""
        key = blake2b(surface.points.tobytes() + surface.cells.tobytes()).digest()
        if key not in self.known:
            self.known[key] = _project(surface, self)
        return self.known[key]


def common_reference(surfaces: Sequence[Interface]) -> Reference | str:
    """Return the first of the leading surfaces that fits onto all others; or, in words, why the very first does not.

    A strongly bent surface may not fit onto a flatter one that fits onto it. The projections of the references used
    last are kept, so that each further run costs only its own projection.
    """
    first, hard = "", list[Interface]()
    for candidate in surfaces[:CANDIDATES]:
        reference = _reference(Snapshot.of(candidate))
        misfit = next((one for one in (*hard, *surfaces) if isinstance(reference.on(one), str)), None)
        if misfit is None:
            return reference
        hard.insert(0, misfit)
        first = first or str(reference.on(misfit))
    return first


@lru_cache(maxsize=2 * CANDIDATES)
def _reference(snapshot: Snapshot) -> Reference:
    return Reference(snapshot.interface)


def _project(surface: Interface, reference: Reference) -> Projection | str:
    topology = _topology(surface)
    if topology != reference.topology:
        return f"surfaces of different kinds: {reference.topology} in one run; {topology} in another"
    if surface.runs_against(reference.surface):
        surface = surface.reversed()
    start, sides, rim = reference.surface.points, _rim(surface), np.unique(reference.sides)
    points = start.copy()
    if len(rim):
        on_rim = _closest_on_sides(start[rim], surface.points, sides)
        points += reference.spread @ (on_rim - start[rim])
        points[rim] = on_rim
    else:
        points += _centre(surface) - _centre(reference.surface)
    centres = cKDTree(surface.centres)
    inner = np.setdiff1d(np.arange(len(points)), rim)
    points[inner] = _along_normals(points, inner, reference.surface.cells, surface, centres)
    fault = _fault(points, reference.surface, surface, centres)
    return fault or Projection(points, _error(points, reference, surface, sides))


def _centre(surface: Interface) -> Float[np.ndarray, "3"]:
    return np.average(surface.centres, axis=0, weights=surface.areas)


def _along_normals(
    points: Points, which: Int[np.ndarray, " inner"], cells: Cells, surface: Interface, centres: cKDTree
) -> Float[np.ndarray, "inner 3"]:
    """Return the nearest crossings of the nodes' normals with `surface`; its closest points if these are far."""
    start, normals = points[which], _vertex_normals(points, cells)[which]
    steps = _crossings(start, normals, surface)
    distances, nearest = centres.query(start)
    same_side = np.sum(surface.normals[nearest] * normals, axis=1) > 0
    far = ~np.isfinite(steps) | (same_side & (np.abs(steps) > FAR * distances))
    out = start + np.where(far, 0.0, steps)[:, None] * normals
    if far.any():
        out[far] = closest_points(start[far], surface).points
    return np.asarray(out)


def _crossings(start: Lines, along: Lines, surface: Interface) -> Float[np.ndarray, " line"]:
    """Return how far along each line the nearest triangle that faces the same side is crossed, mm; inf if none is. The
    crossing solves start + t·along = a + v·(b - a) + w·(c - a) by Cramer's rule (Möller and Trumbore).
    """
    lines, cells = _near_lines(start, along, surface)
    a, b, c = (surface.points[surface.cells[cells, k]] for k in range(3))
    d, e, s, n = b - a, c - a, start[lines] - a, along[lines]
    p, q = np.cross(e, n), np.cross(d, s)
    size = np.sum(d * p, axis=1)
    faces = size > _EDGE * np.linalg.norm(d, axis=1) * np.linalg.norm(e, axis=1)
    size = np.where(faces, size, 1.0)
    v, w, t = (np.sum(x * y, axis=1) / size for x, y in ((s, p), (q, n), (q, e)))
    hit = faces & (v >= -_EDGE) & (w >= -_EDGE) & (v + w <= 1 + _EDGE)
    lines, t = lines[hit], t[hit]
    order = np.lexsort((np.abs(t), lines))
    found, first = np.unique(lines[order], return_index=True)
    out = np.full(len(start), np.inf)
    out[found] = t[order][first]
    return out


def _near_lines(start: Lines, along: Lines, surface: Interface) -> tuple[Numbers, Numbers]:
    """Return pairs of a line and a triangle that it may cross, by balls around ever fewer neighbouring triangles."""
    corners, number = surface.points[surface.cells], len(surface.cells)
    order = cKDTree(surface.centres, leafsize=_BRANCHES).indices
    low, high = corners.min(axis=1)[order], corners.max(axis=1)[order]
    lines, balls, size = np.arange(len(start)), np.zeros(len(start), int), 1
    while size < number:
        size *= _BRANCHES
    while size > 1:
        size //= _BRANCHES
        lines = np.repeat(lines, _BRANCHES)
        balls = (_BRANCHES * balls[:, None] + np.arange(_BRANCHES)).ravel()
        begins = np.arange(0, number, size)
        one, two = np.minimum.reduceat(low, begins), np.maximum.reduceat(high, begins)
        centre, radius = (one + two) / 2, (1 + _EDGE) * np.linalg.norm(two - one, axis=1) / 2
        lines, balls = lines[balls < len(begins)], balls[balls < len(begins)]
        offset = centre[balls] - start[lines]
        apart = np.einsum("pk,pk->p", offset, offset) - np.einsum("pk,pk->p", offset, along[lines]) ** 2
        near = apart <= radius[balls] ** 2
        lines, balls = lines[near], balls[near]
    return lines, order[balls]


def _fault(points: Points, reference: Interface, surface: Interface, centres: cKDTree) -> str:
    """Return in words which triangles between the points misrepresent the surface; "" if none do."""
    cells = reference.cells
    longest = np.linalg.norm(points[cells] - np.roll(points[cells], 1, axis=1), axis=2).max(axis=1)
    before = np.linalg.norm(reference.points[cells] - reference.points[np.roll(cells, 1, axis=1)], axis=2).max(axis=1)
    thin = shortest_altitudes(reference.points, cells) / before
    flat = shortest_altitudes(points, cells) <= FLAT * thin * longest
    there = surface.normals[centres.query(points[cells].mean(axis=1))[1]]
    facing = np.sum(vector_areas(points, cells) * there, axis=1) / np.linalg.norm(there, axis=1)
    for wrong, word in ((flat, "flattened"), (facing < -TURNED * longest**2, "turned over")):
        if wrong.any():
            where = ", ".join(f"{x:.6g}" for x in reference.points[cells[np.argmax(wrong)]].mean(axis=0))
            what = f"{wrong.sum()} triangle(s) of one run's surface {word}"
            return f"{what} when it is projected onto another's, the first at ({where}) mm"
    return ""


def _error(points: Points, reference: Reference, surface: Interface, sides: Sides) -> float:
    taken = Interface(points, reference.surface.cells)
    error = float(np.sqrt(np.mean(squared_distances(surface.points, taken))))
    if not len(sides):
        return error
    rim = surface.points[np.unique(sides)]
    off = rim - _closest_on_sides(rim, points, reference.sides)
    return max(error, float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))


def _closest_on_sides(start: Lines, points: Points, sides: Sides) -> Lines:
    """Return the closest point on these sides to each point, by trying all sides."""
    a = points[sides[:, 0]]
    d = points[sides[:, 1]] - a
    offset = start[:, None] - a
    share = np.clip(np.einsum("psk,sk->ps", offset, d) / np.sum(d * d, axis=1), 0.0, 1.0)
    offset -= share[..., None] * d
    best = np.argmin(np.einsum("psk,psk->ps", offset, offset), axis=1)
    return np.asarray(start - offset[np.arange(len(start)), best])


def _vertex_normals(points: Points, cells: Cells) -> Points:
    """Return unit normals of the nodes, those of their triangles weighted by area."""
    areas = np.repeat(vector_areas(points, cells), 3, axis=0)
    total = np.stack([np.bincount(cells.ravel(), areas[:, k], len(points)) for k in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(np.divide(total, length, out=np.zeros_like(total), where=length > 0))


def _rim(surface: Interface) -> Sides:
    sides, counts = triangle_sides(len(surface.points), surface.cells)
    return np.asarray(sides[counts == 1])


def _topology(surface: Interface) -> Topology:
    number = len(surface.points)
    sides, counts = triangle_sides(number, surface.cells)
    rim = sides[counts == 1]
    loose = number - len(np.unique(rim))  # nodes that no side of the rim joins to others
    return Topology(_parts(sides, number), _parts(rim, number) - loose, number - len(sides) + len(surface.cells))


def _parts(sides: Sides, number: int) -> int:
    graph = coo_array((np.ones(len(sides)), (sides[:, 0], sides[:, 1])), shape=(number, number))
    return int(connected_components(graph, directed=False, return_labels=False))


def _laplacian(surface: Interface) -> coo_array:
    """Return the stiffness matrix of linear elements: half the cotangent of the angle opposite to each side."""
    cells, areas, number = surface.cells, surface.areas, len(surface.points)
    rows, columns, values = [], [], []
    for k in range(3):
        i, j, corner = (cells[:, (k + m) % 3] for m in range(3))
        p, q = surface.points[i] - surface.points[corner], surface.points[j] - surface.points[corner]
        half = np.sum(p * q, axis=1) / (4 * areas)
        rows += [i, j, i, j]
        columns += [j, i, i, j]
        values += [-half, -half, half, half]
    where = np.concatenate(rows), np.concatenate(columns)
    return coo_array((np.concatenate(values), where), shape=(number, number))
