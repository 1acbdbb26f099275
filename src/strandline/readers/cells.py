"""Cells of meshes: their edges, faces and boundaries, and the polylines that edges form."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, depth_first_order
from scipy.spatial import cKDTree

from strandline.readers.contents import Block, refused
from strandline.readers.options import Reading

Points = Float[np.ndarray, "point xyz"]
COINCIDENT = 1e-9
"""Distance of points that count as one, as a share of the mesh's extent: a repeated point may be rounded otherwise."""
ROUNDED, NEARLY = 1e-3, 0.1
"""The same as a share of the shortest side of a cell, and the distance up to which they may be meant as one."""
ALIKE = 1e-4
"""Difference of two sizes, as a share of them, that may be rounding: files print about six digits of each point."""
LINES = {"line": (0, 1), "line3": (0, 2, 1)}
"""Nodes in their order along the cell."""
RINGS = {"triangle": (0, 1, 2), "triangle6": (0, 3, 1, 4, 2, 5), "quad": (0, 1, 2, 3), "pixel": (0, 1, 3, 2)}
RINGS |= dict.fromkeys(("quad8", "quad9"), (0, 4, 1, 5, 2, 6, 3, 7))
"""Nodes in their order around the cell."""
FACES = {
    "tetra": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    "tetra10": ((0, 6, 2, 5, 1, 4), (0, 4, 1, 8, 3, 7), (1, 5, 2, 9, 3, 8), (2, 6, 0, 7, 3, 9)),
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "voxel": ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)),
    "hexahedron20": (
        (0, 11, 3, 10, 2, 9, 1, 8),
        (4, 12, 5, 13, 6, 14, 7, 15),
        (0, 8, 1, 17, 5, 12, 4, 16),
        (1, 9, 2, 18, 6, 13, 5, 17),
        (2, 10, 3, 19, 7, 14, 6, 18),
        (3, 11, 0, 16, 4, 15, 7, 19),
    ),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}
"""Rings of nodes, seen from outside counter-clockwise."""
PIECES: dict[int, tuple[tuple[int, int, int], ...]] = {
    3: ((0, 1, 2),),
    4: ((0, 1, 2), (0, 2, 3)),
    6: ((0, 1, 5), (1, 2, 3), (3, 4, 5), (1, 3, 5)),
    8: ((7, 0, 1), (1, 2, 3), (3, 4, 5), (5, 6, 7), (1, 3, 5), (1, 5, 7)),
}
"""Triangles of a ring, by its number of nodes."""
JUMP, BACK = 5.0, 3.0
"""Distances, in those to the nearest other point: a longer step is a jump; a jump back ends nearer to its start."""
SIDE = 20
"""Most points between a jump and the jump back."""
ZIGZAG = 0.1
"""Share of points that jump and come back, from which a table lists two sides at once."""


def dimension(kind: str) -> int | None:
    """Return the number of dimensions of a kind of cells; None if unknown."""
    return next((k for k, known in enumerate((set(LINES), set(RINGS), set(FACES)), 1) if kind in known), None)


def joined(blocks: Sequence[Block], points: Points, moved: Points, name: str) -> list[Block]:
    """Return cells that share nodes where they touch, also if all have nodes of their own, as NGSolve writes them.

    `moved`: the points with their displacements; parts that come apart keep their nodes.
    """
    nodes = np.concatenate([block.nodes.ravel() for block in blocks])
    used = np.unique(nodes)
    alone, plane = len(used) == len(nodes), all((dimension(block.kind) or 0) > 1 for block in blocks)
    if sum(len(block.nodes) for block in blocks) == 1 or not (alone or plane):
        return list(blocks)
    sides = [points[block.nodes] - points[np.roll(block.nodes, 1, axis=1)] for block in blocks]
    shortest = min(float(np.linalg.norm(side, axis=2).min()) for side in sides)
    reach = max(COINCIDENT * float(np.ptp(points[used], axis=0).max()), ROUNDED * shortest)
    tree = cKDTree(points[used])
    i, j = tree.query_pairs(reach, output_type="ndarray").T
    if alone and len(tree.query_pairs(NEARLY * shortest)) > len(i):
        what = f"{name}: cells have nodes of their own that nearly coincide"
        found = f"some between {reach:.3g} and {NEARLY * shortest:.3g} mm apart"
        raise refused(what, found, "cells that share nodes, or repeat them", "Merge the nodes, or write more digits.")
    if not alone:
        i, j = np.stack([i, j])[:, np.linalg.norm(moved[used[i]] - moved[used[j]], axis=1) <= reach]
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(len(used),) * 2)
    number, together = connected_components(graph, directed=False)
    first = np.full(number, len(points))
    np.minimum.at(first, together, used)
    renumbered = np.arange(len(points))
    renumbered[used] = first[together]
    return [replace(block, nodes=renumbered[block.nodes]) for block in blocks]


def line_edges(blocks: Sequence[Block], orders: Mapping[str, tuple[int, ...]] = LINES) -> Int[np.ndarray, "edge 2"]:
    """Return the edges of line cells; quadratic ones have two edges, through their middle node."""
    found = []
    for block in blocks:
        chain = block.nodes[:, orders[block.kind]]
        found.append(np.stack([chain[:, :-1], chain[:, 1:]], axis=2).reshape(-1, 2))
    return np.concatenate(found)


def boundary_edges(blocks: Sequence[Block]) -> Int[np.ndarray, "edge 2"]:
    """Return the edges that belong to only one plane cell, with the cell on their left if it is well numbered."""
    edges = line_edges(blocks, {kind: (*ring, ring[0]) for kind, ring in RINGS.items()})
    return np.asarray(edges[_once(edges)])


def surface_triangles(blocks: Sequence[Block]) -> Int[np.ndarray, "cell 3"]:
    """Return plane cells as triangles."""
    return np.concatenate([_triangles(block.nodes[:, RINGS[block.kind]]) for block in blocks])


def boundary_triangles(blocks: Sequence[Block]) -> Int[np.ndarray, "cell 3"]:
    """Return the faces that belong to only one solid cell, as triangles that face outwards."""
    rings: dict[int, list[Int[np.ndarray, "face node"]]] = {}
    for block in blocks:
        for face in FACES[block.kind]:
            rings.setdefault(len(face), []).append(block.nodes[:, face])
    faces = [np.concatenate(group) for group in rings.values()]
    return np.concatenate([_triangles(ring[_once(ring)]) for ring in faces])


def _triangles(ring: Int[np.ndarray, "face node"]) -> Int[np.ndarray, "cell 3"]:
    triangles: Int[np.ndarray, "cell 3"] = ring[:, np.array(PIECES[ring.shape[1]])].reshape(-1, 3)
    return triangles


def _once(rings: Int[np.ndarray, "face node"]) -> Bool[np.ndarray, " face"]:
    """Return which rings of nodes appear only once, in either direction."""
    _, inverse, counts = np.unique(np.sort(rings, axis=1), axis=0, return_inverse=True, return_counts=True)
    return np.asarray(counts[inverse.reshape(-1)] == 1)


@dataclass(frozen=True, eq=False)
class Chain:
    """Nodes in their order along a polyline, each once; if it is closed, the last one is joined to the first."""

    nodes: Int[np.ndarray, " node"]
    closed: bool


def chains(edges: Int[np.ndarray, "edge 2"], points: Float[np.ndarray, "point 2"], name: str) -> list[Chain]:
    """Return the polylines that `edges` form, each in the direction of most of its edges."""
    edges = edges[edges[:, 0] != edges[:, 1]]
    _, first = np.unique(np.sort(edges, axis=1), axis=0, return_index=True)
    edges = edges[np.sort(first)]
    degrees = np.bincount(edges.ravel(), minlength=len(points))
    if degrees.max(initial=0) > 2:
        node = int(np.argmax(degrees > 2))
        what = f"{name}: the interface branches at {_place(points[node])} mm"
        remedy = "Choose a part of it with `block`, `cells`, `points` or `select`."
        raise refused(what, f"{degrees[node]} segments meet there", "one line without branches", remedy)
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(len(points), len(points))).tocsr()
    found: list[Chain] = []
    forward, left = set(map(tuple, edges.tolist())), degrees > 0
    for begin in [*np.flatnonzero(degrees == 1), *np.flatnonzero(degrees == 2)]:  # open ones from an end, closed ones
        if left[begin]:
            nodes = depth_first_order(graph, begin, directed=False, return_predecessors=False).astype(np.int64)
            left[nodes] = False
            found.append(_directed(Chain(nodes, closed=bool(degrees[begin] == 2 and len(nodes) > 2)), forward))
    return found


def chosen_chain(found: Sequence[Chain], points: Float[np.ndarray, "point 2"], how: Reading, name: str) -> Chain:
    """Return the one polyline among those found."""
    if not found:
        raise refused(f"{name} holds no interface", None, "cells that form a line", "Look at the selection.")
    if how.near is not None:
        place = np.asarray(how.near)[:2]
        return min(found, key=lambda chain: float(np.linalg.norm(points[chain.nodes] - place, axis=1).min()))
    if how.keep is not None:
        return found[largest([_length(chain, points) for chain in found], name)]
    if len(found) > 1:
        shown = [f"{_place(points[c.nodes[0]])} to {_place(points[c.nodes[-1]])}" for c in found[:3]]
        value = ", ".join(shown) + (", …" if len(found) > 3 else "") + " mm"
        remedy = "Choose a piece with `near: [x, y]` or `keep: longest`, or a part of the mesh with `select`."
        raise refused(f"{name}: the interface is in {len(found)} pieces", value, "one line without gaps", remedy)
    return found[0]


def largest(sizes: ArrayLike, name: str) -> int:
    """Return the index of the largest size, or of one that is not finite; refuse several alike but for rounding."""
    found = np.nan_to_num(sizes, nan=np.inf)
    alike = np.flatnonzero(found >= (1 - ALIKE) * found.max())
    if len(alike) > 1:
        what, value = f"{name}: `keep: longest` fits several pieces", f"{len(alike)} of the same size"
        raise refused(what, value, "one that is larger than the others", "Say `near: [x, y]` in mm instead.")
    return int(alike[0])


def _directed(chain: Chain, forward: set[tuple[Any, ...]]) -> Chain:
    pairs = list(zip(chain.nodes[:-1].tolist(), chain.nodes[1:].tolist(), strict=True))
    along = sum(pair in forward for pair in pairs)
    return chain if 2 * along >= len(pairs) else Chain(chain.nodes[::-1], chain.closed)


def _length(chain: Chain, points: Float[np.ndarray, "point 2"]) -> float:
    corners = points[np.append(chain.nodes, chain.nodes[0]) if chain.closed else chain.nodes]
    return float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())


def _place(point: Float[np.ndarray, " xyz"]) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in point) + ")"


def require_in_order(points: Float[np.ndarray, "point 2"], name: str, remedy: str = "") -> None:
    """Refuse points that jump to and fro between two sides, as a list of edge pixels row by row does."""
    steps = np.diff(points, axis=0)
    one_way = (steps > 0).all(axis=0) | (steps < 0).all(axis=0)
    if len(points) < SIDE or not np.isfinite(points).all() or one_way.any():
        return
    near = cKDTree(points).query(points, k=2)[0][:, 1]
    jumps = np.flatnonzero(np.linalg.norm(steps, axis=1) > JUMP * np.maximum(near[:-1], near[1:]))
    there, back = jumps[:-1], jumps[1:]
    gap = np.linalg.norm(points[there] - points[back + 1], axis=1)
    returns = there[(back - there <= SIDE) & (gap <= BACK * np.maximum(near[there], near[back + 1]))]
    if len(returns) > ZIGZAG * len(points) + 1:
        start, end = points[returns[0] : returns[0] + 2].tolist()
        value = f"e.g. from {start} to {end} and back"
        remedy = f"{remedy} Of OpenDrop take fit.csv, which runs along the profile.".strip()
        raise refused(f"{name} jumps to and fro between two sides", value, "points in order along the line", remedy)
