"""Edges in any order and direction → polylines."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from strandline.readers.contents import refused


@dataclass(frozen=True, eq=False)
class Chain:
    """Nodes in their order along a polyline.

    Args:
        nodes: node numbers, each once.
        closed: whether the last node is joined to the first.
    """

    nodes: Int[np.ndarray, " node"]
    closed: bool


def chains(edges: Int[np.ndarray, "edge 2"], points: Float[np.ndarray, "point 2"], name: str) -> list[Chain]:
    """Return the polylines that `edges` form, each in the direction of most of its edges.

    Raises:
        Unreadable: three or more edges meet at a point.
    """
    edges = edges[edges[:, 0] != edges[:, 1]]
    _, first = np.unique(np.sort(edges, axis=1), axis=0, return_index=True)
    edges = edges[np.sort(first)]
    neighbours: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    for node, others in neighbours.items():
        if len(others) > 2:
            raise refused(
                f"{name}: the interface branches at {_place(points[node])} mm",
                f"{len(others)} segments meet there",
                "one line without branches",
                "Choose a part of it with `block`, `cells`, `points` or `select`.",
            )
    forward = set(map(tuple, edges.tolist()))
    return [_directed(chain, forward) for chain in _walked(neighbours)]


def chosen_chain(
    found: Sequence[Chain],
    points: Float[np.ndarray, "point 2"],
    name: str,
    *,
    near: Sequence[float] | None,
    longest: bool,
) -> Chain:
    """Return the one polyline among those found.

    Raises:
        Unreadable: There is none, or there are several and no option chooses one.
    """
    if not found:
        raise refused(f"{name} holds no interface", None, "cells that form a line", "Look at the selection.")
    if near is not None:
        place = np.asarray(near)[:2]
        return min(found, key=lambda chain: float(np.linalg.norm(points[chain.nodes] - place, axis=1).min()))
    if longest:
        return max(found, key=lambda chain: _length(chain, points))
    if len(found) > 1:
        shown = [f"{_place(points[c.nodes[0]])} to {_place(points[c.nodes[-1]])}" for c in found[:3]]
        raise refused(
            f"{name}: the interface is in {len(found)} pieces",
            ", ".join(shown) + (", …" if len(found) > 3 else "") + " mm",
            "one line without gaps",
            "Choose a piece with `near: [x, y]` or `keep: longest`, or a part of the mesh with `select`.",
        )
    return found[0]


def _walked(neighbours: dict[int, list[int]]) -> list[Chain]:
    """Return the open chains, each from its end with the lower number, then the closed ones."""
    left = dict.fromkeys(sorted(neighbours))
    ends = [node for node in left if len(neighbours[node]) == 1]
    result = []
    for begin in [*ends, *left]:
        if begin not in left:
            continue
        nodes, at = [begin], begin
        del left[begin]
        while (after := next((n for n in neighbours[at] if n in left), None)) is not None:
            nodes.append(after)
            del left[after]
            at = after
        result.append(Chain(np.array(nodes), closed=len(neighbours[begin]) == 2 and len(nodes) > 2))
    return result


def _directed(chain: Chain, forward: set[tuple[Any, ...]]) -> Chain:
    pairs = list(zip(chain.nodes[:-1].tolist(), chain.nodes[1:].tolist(), strict=True))
    along = sum(pair in forward for pair in pairs)
    return chain if 2 * along >= len(pairs) else Chain(chain.nodes[::-1], chain.closed)


def _length(chain: Chain, points: Float[np.ndarray, "point 2"]) -> float:
    corners = points[np.append(chain.nodes, chain.nodes[0]) if chain.closed else chain.nodes]
    return float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())


def _place(point: Float[np.ndarray, " xyz"]) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in point) + ")"


JUMP, BACK = 5.0, 3.0
"""Distances, in those to the nearest other point: a longer step is a jump; a jump back ends nearer to its start."""
SIDE = 20
"""Most points between a jump and the jump back."""
ZIGZAG = 0.1
"""Share of points that jump and come back, from which a table lists two sides at once."""
CLOSE, GAP = 1.5, 0.1
"""Distance of ends that nearly meet, at most, in median distances of neighbours and as a share of the length."""


def require_in_order(points: Float[np.ndarray, "point 2"], name: str, remedy: str) -> None:
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
        raise refused(f"{name} jumps to and fro between two sides", value, "points in order along the line", remedy)


def require_clear_ends(chain: Float[np.ndarray, "point 2"], name: str) -> None:
    """Refuse an outline whose ends are as near to each other as neighbours are: it may be closed."""
    if len(chain) < 3:
        return
    lengths = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    gap, usual = float(np.linalg.norm(chain[0] - chain[-1])), float(np.median(lengths))
    if gap <= min(GAP * lengths.sum(), CLOSE * usual):
        value, expected = f"{gap:.3g} mm apart, neighbours {usual:.3g} mm", "an outline that is clearly open or closed"
        remedy = "Say `closed: true`, as for outlines of OpenCV, or `closed: false`."
        raise refused(f"{name} ends near its first point and does not repeat it", value, expected, remedy)
