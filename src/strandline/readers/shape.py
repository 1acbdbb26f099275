"""Points and cells of a file → the interface that the options choose."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from strandline.interface import Interface, signed_volume, vector_areas
from strandline.readers import cells
from strandline.readers.cells import Chain, chains, chosen_chain, require_in_order
from strandline.readers.contents import Block, Contents, refused
from strandline.readers.options import Reading
from strandline.readers.tables import SD

Points = Float[np.ndarray, "point xyz"]
Plane = Float[np.ndarray, "point 2"]
Chosen = Int[np.ndarray, " chosen"]
FLATNESS = 1e-6
"""Share of the extent by which points may leave a plane: files in single precision are rounded by 1e-7."""
ROUNDED = 1e-6
"""Slack of the sides of a box, as a share of the size of what is read: files print about six digits."""
CLOSING = 1e-3
"""Distance of a last point from the first, in median distances of neighbours, up to which an outline is closed."""
CLOSE, GAP = 1.5, 0.1
"""Distance of ends that nearly meet, at most, in median distances of neighbours and as a share of the length."""
STRAIGHT = 0.5
"""Cosine of the angles to its neighbours, at least, of a segment that would go on as a ring does."""
OPEN_OR_CLOSED = "Say `closed: true`, as for outlines of OpenCV, or `closed: false`."
LEAST_SEEN = 10
"""Fewest points that may be left if some are hidden."""
IN_ORDER = "Put the points in order along the interface: `sort: x` does it if x grows along it, `sort: y` if y does."
SURFACES = (".stl", ".ply")
"""Suffixes of files that hold surfaces, even plane ones."""
DISPLACEMENT = re.compile(r"u[_:]?[xyz\d]|(.*[\W_])?(disp|d[eé]pl|deform|verschieb).*", re.IGNORECASE)
"""Names that programs give to displacements and their components; vectors may also be called ``u`` or ``u_h``."""


def interface_of(contents: Contents, how: Reading, name: str) -> Interface:
    """Return the interface, in mm."""
    places, moved = _places(contents, how, name)
    found = (_of_cells if contents.blocks else _of_table)(contents, places, moved, how, name)
    if how.count is not None and len(found.points) != how.count:
        remedy = "Check what writes the file, or `count`."
        raise refused(f"{name}: number of points", len(found.points), f"{how.count}", remedy)
    return found


def _places(contents: Contents, how: Reading, name: str) -> tuple[Points, Points]:
    """Return the points as they are in the file and with the displacement added, mm."""
    places, displacement = contents.points, contents.displacement
    moving = [key for key, v in contents.data.items() if _may_move(key, v)]
    if how.field is None and displacement is None and moving:
        component = contents.data[moving[0]].ndim == 1
        say = "Write its components as one vector" if component else f"Say `field: {moving[0]}`"
        remedy = f"{say} to add them, or `field: none` if they are none or the points have moved."
        raise refused(f"{name} holds what may be displacements", moving[0], "`field`", remedy)
    if isinstance(how.field, str) and how.field != "none":
        displacement = np.asarray(_data(contents.data, how.field, f"{name} has no point data"), float)
        if displacement.ndim != 2 or not 2 <= displacement.shape[1] <= 3:
            raise refused(f"{name}: point data {how.field}", f"the shape {displacement.shape}", "one vector per point")
    if displacement is None:
        return places * how.factor, places * how.factor
    width = places.shape[1]
    moved = np.zeros_like(places)
    moved[:, : min(width, displacement.shape[1])] = displacement[:, :width]
    return places * how.factor, (places + moved) * how.factor


def _may_move(key: str, values: Shaped[np.ndarray, "..."]) -> bool:
    """Return whether point data may be displacements, or a component of them, that are not all 0."""
    vectors = values.shape[1:] in ((2,), (3,))
    named = DISPLACEMENT.fullmatch(key) or (vectors and key.lower() in ("u", "uh", "u_h"))
    return bool(named) and (vectors or values.ndim == 1) and bool(np.nan_to_num(values).any())


def point_sds(contents: Contents, how: Reading, name: str) -> Float[np.ndarray, " point"]:
    """Return the standard deviations of the points of the interface that `interface_of` returns, in mm."""
    places, moved = _places(contents, how, name)
    order = _order(contents, places, how, name)
    if how.closed is not False and repeats_first(moved[order]):
        order = order[:-1]
    sds = how.factor * np.asarray(_data(contents.data, SD, f"{name} has no point data"), float)[order]
    if not (np.isfinite(sds) & (sds > 0)).all():
        worst = int(np.argmin(np.where(np.isfinite(sds), sds, -np.inf)))
        what = f"{name}: standard deviation {_place(int(order[worst]), contents.lines)}"
        raise refused(what, float(sds[worst] / how.factor), "a number above 0", "Correct it, or hide the point.")
    return np.asarray(sds)


def _of_table(contents: Contents, places: Points, moved: Points, how: Reading, name: str) -> Interface:
    order = _order(contents, places, how, name)
    _require_finite(moved, order, name, contents.lines)
    chain = moved[order]
    require_in_order(chain, name, IN_ORDER if how.sort is None else "Sorting does not order these.")
    repeated = how.closed is not False and repeats_first(chain)
    polyline = Interface.polyline(chain[:-1] if repeated else chain, closed=repeated or how.closed is True)
    polyline.require_simple(f"{IN_ORDER} Else remove the loop." if how.sort is None else "Remove the loop.")
    if not repeated and how.closed is None:
        require_clear_ends(chain, name)
    return polyline


def _order(contents: Contents, places: Points, how: Reading, name: str) -> Chosen:
    """Return the numbers of the chosen points of a table, along the interface."""
    if places.shape[1] != 2:
        raise refused(f"{name} holds points and no cells", f"{len(places)} points", "lines or faces between them")
    order = np.arange(len(places))
    if how.select is not None:
        order = order[_inside(places, how.select)]
    if contents.pieces is not None:
        order = _one_piece(order, contents.pieces[order], places, how, name)
    if how.sort is not None:
        order = order[np.argsort(places[order, "xy".index(how.sort)], kind="stable")]
    elif (np.diff(order) != 1).any():
        gap = places[order[int(np.argmax(np.diff(order) != 1))]]
        found = f"the first one ends at {np.round(gap, 6).tolist()} mm"
        advice = "Choose a box that the interface enters once."
        raise refused(f"{name}: the box of `select` cuts the interface into pieces", found, "one piece", advice)
    if how.hide:
        hidden = np.array([_inside(places[order], box) for box in how.hide])
        if not hidden.any(axis=1).all():
            empty = dict(how.hide[int(np.argmin(hidden.any(axis=1)))])
            remedy = "Correct the box; boxes are in mm."
            raise refused(f"{name}: a box of `hide` without a point", empty, "a part of the interface", remedy)
        order = order[~hidden.any(axis=0)]
        if len(order) < LEAST_SEEN:
            remedy = "Make the boxes smaller."
            raise refused(f"{name}: points outside the boxes of `hide`", len(order), f"at least {LEAST_SEEN}", remedy)
    return order


def _one_piece(order: Chosen, pieces: Chosen, places: Points, how: Reading, name: str) -> Int[np.ndarray, " piece"]:
    """Return the points of the piece that `near` or `keep` chooses."""
    found = [order[pieces == one] for one in np.unique(pieces)]
    if len(found) == 1:
        return order
    if how.near is not None:
        near = np.asarray(how.near)[:2]
        return min(found, key=lambda one: float(np.linalg.norm(places[one] - near, axis=1).min()))
    if how.keep is not None:
        lengths = [np.linalg.norm(np.diff(places[one], axis=0), axis=1).sum() for one in found]
        return np.asarray(found[cells.largest(lengths, name)])
    value = f"{len(found)}, of {', '.join(str(len(one)) for one in found[:5])} points"
    expected = "one polyline: no blank line or comment between its points, no column that tells pieces apart"
    remedy = "Leave one in the file, or choose by `keep: longest` or `near: [x, y]` in mm."
    raise refused(f"{name} holds several pieces or times", value, expected, remedy)


def _of_cells(contents: Contents, places: Points, moved: Points, how: Reading, name: str) -> Interface:
    blocks = _chosen(contents, how, name)
    used = np.unique(np.concatenate([block.nodes.ravel() for block in blocks]))
    _require_finite(places, used, name)
    wanted = _wanted(contents, places, how, name)
    remedy = f"Write {how.field or 'the displacement'} for all nodes, or choose those that have it by `select`."
    _require_finite(moved, _kept(used[:, None], wanted, name).ravel(), name, remedy=remedy)
    blocks = cells.joined(blocks, places, moved, name)
    lowest = min(cells.dimension(block.kind) or 0 for block in blocks)
    known = used[np.isfinite(moved[used]).all(axis=1)]
    flat = _is_flat(places[used], how.axes) and _is_flat(moved[known], how.axes)
    if lowest == 3 or (lowest == 2 and (not flat or how.suffix in SURFACES)):
        parts = cells.surface_triangles(blocks) if lowest == 2 else cells.boundary_triangles(blocks)
        if lowest == 3 and signed_volume(places, parts) < 0:
            parts = parts[:, ::-1]  # solids that are numbered inside out
        triangles = _chosen_part(_kept(parts, wanted, name), places, how, name)
        own, corners = np.unique(triangles, return_inverse=True)
        return Interface(np.ascontiguousarray(moved[own]), corners.reshape(-1, 3).astype(np.int64))
    parts = cells.line_edges(blocks) if lowest == 1 else cells.boundary_edges(blocks)
    if not flat:
        faces = next((block.kind for block in contents.blocks if cells.dimension(block.kind) == 2), None)
        remedy = f"For the surface give `block: {faces}`; for a line choose `plane`." if faces else "Choose `plane`."
        raise refused(f"{name}: the line leaves its plane", how.plane, "a line in a plane", remedy)
    _, first, same = np.unique(places, axis=0, return_index=True, return_inverse=True)  # of points that coincide
    edges = first[same.reshape(-1)][_kept(parts, wanted, name)]
    plane = places[:, how.axes]
    chain = chosen_chain(chains(edges, plane, name), plane, how, name)
    return _polyline(chain, plane, moved[:, how.axes], how.start)


def _chosen(contents: Contents, how: Reading, name: str) -> list[Block]:
    """Return the cells that `block` and `cells` select, and of these the ones of the lowest dimension."""
    blocks = list(contents.blocks)
    if isinstance(how.block, int):
        if how.block >= len(blocks):
            raise refused(f"{name} has no block {how.block}", f"{len(blocks)} blocks", "a number from 0")
        blocks = [blocks[how.block]]
    elif how.block is not None:
        kinds = ", ".join(dict.fromkeys(block.kind for block in blocks))
        blocks = [block for block in blocks if block.kind == how.block]
        if not blocks:
            raise refused(f"{name} has no cells of the kind {how.block}", kinds, "one of them", "Correct `block`.")
    for key, wanted in (how.cells or {}).items():
        blocks = [_where(block, key, wanted, name) for block in blocks]
    blocks = [block for block in blocks if len(block.nodes)]
    if not blocks:
        shown = ", ".join(f"{key} = {value}" for key, value in (how.cells or {}).items())
        raise refused(f"{name} has no such cells", shown, "cells that form the interface", "Correct `cells`.")
    unknown = [block.kind for block in blocks if cells.dimension(block.kind) is None]
    if unknown:
        raise refused(f"{name} has cells that are not read", unknown[0], "lines, faces or solids up to second order")
    lowest = min(cells.dimension(block.kind) or 0 for block in blocks)
    return [block for block in blocks if cells.dimension(block.kind) == lowest]


def _where(block: Block, key: str, wanted: Any, name: str) -> Block:
    chosen = _is_one_of(_data(block.data, key, f"{name} has no cell data"), wanted)
    return Block(block.kind, block.nodes[chosen], {k: values[chosen] for k, values in block.data.items()})


def _data(known: Mapping[str, Shaped[np.ndarray, "..."]], key: str, what: str) -> Shaped[np.ndarray, "..."]:
    if key not in known:
        raise refused(f"{what} {key}", ", ".join(known) or "none", "one of its names", "Correct the name.")
    return known[key]


def _is_one_of(values: Shaped[np.ndarray, "..."], wanted: Any) -> Bool[np.ndarray, " row"]:
    several = wanted if isinstance(wanted, tuple) else (wanted,)
    return np.asarray(np.isin(values.reshape(len(values), -1)[:, 0], several))


def _wanted(contents: Contents, places: Points, how: Reading, name: str) -> Bool[np.ndarray, " point"]:
    """Return which nodes are in the box and have the requested point data."""
    good = np.ones(len(places), dtype=bool)
    for key, wanted in (how.points or {}).items():
        good &= _is_one_of(_data(contents.data, key, f"{name} has no point data"), wanted)
    return good if how.select is None else good & _inside(places, how.select)


def _kept(
    parts: Int[np.ndarray, "part node"], good: Bool[np.ndarray, " point"], name: str
) -> Int[np.ndarray, "kept node"]:
    """Return the nodes, edges or triangles all of whose nodes are good."""
    kept = np.asarray(parts[good[parts].all(axis=1)])
    if not len(kept):
        raise refused(f"{name} holds no interface", "nothing in the selection", "a part of the mesh", "Widen it.")
    return kept


def _inside(places: Points, box: Mapping[str, Sequence[float]]) -> Bool[np.ndarray, " point"]:
    """Return which points lie in a box; its sides are as exact as files print coordinates."""
    good, slack = np.ones(len(places), dtype=bool), ROUNDED * float(np.ptp(places, axis=0).max(initial=0.0))
    for axis, (low, high) in box.items():
        column = places[:, "xyz".index(axis)] if "xyz".index(axis) < places.shape[1] else np.zeros(len(places))
        good &= (low - slack <= column) & (column <= high + slack)
    return good


def _polyline(chain: Chain, places: Plane, moved: Plane, start: Any) -> Interface:
    """Return a chain as an interface that begins at `start`; a closed one runs counter-clockwise."""
    nodes = chain.nodes
    if chain.closed and _area(places[nodes]) < 0:
        nodes = nodes[::-1]
    if start is not None:
        distance = np.linalg.norm(places[nodes] - np.asarray(start)[:2], axis=1)
        if chain.closed:
            nodes = np.roll(nodes, -int(np.argmin(distance)))
        elif distance[-1] < distance[0]:
            nodes = nodes[::-1]
    polyline = Interface.polyline(moved[nodes], closed=chain.closed)
    polyline.require_simple()
    return polyline


def _area(ring: Plane) -> float:
    after = np.roll(ring, -1, axis=0)
    return float((ring[:, 0] * after[:, 1] - ring[:, 1] * after[:, 0]).sum())


def _chosen_part(
    triangles: Int[np.ndarray, "cell 3"], places: Points, how: Reading, name: str
) -> Int[np.ndarray, "chosen 3"]:
    """Return the connected part of a surface that `near` or `keep` chooses, if there are several."""
    sides = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    number = len(places)
    part = connected_components(coo_array((np.ones(len(sides)), sides.T), shape=(number, number)), directed=False)[1]
    found, of_triangle = np.unique(part[triangles[:, 0]], return_inverse=True)
    areas = np.bincount(of_triangle, weights=np.linalg.norm(vector_areas(places, triangles), axis=1))
    if len(found) == 1:
        return triangles
    if how.near is not None:
        used = np.unique(triangles)
        chosen = part[used[np.argmin(np.linalg.norm(places[used] - np.array([*how.near, 0.0][:3]), axis=1))]]
    elif how.keep is not None:
        chosen = found[cells.largest(areas, name)]
    else:
        value = f"areas of {', '.join(f'{area:.4g}' for area in areas[:5])} mm²"
        remedy = "Choose by `keep: longest`, the one of the largest area, or `near: [x, y, z]` in mm."
        raise refused(f"{name} holds {len(found)} surfaces apart from each other", value, "one surface", remedy)
    return np.asarray(triangles[part[triangles[:, 0]] == chosen])


def _is_flat(points: Points, axes: tuple[int, int]) -> bool:
    others = [k for k in range(points.shape[1]) if k not in axes]
    extent = float(np.ptp(points, axis=0).max())
    return all(float(np.ptp(points[:, k])) <= FLATNESS * extent for k in others)


def _place(point: int, lines: Sequence[int]) -> str:
    """Return where a person finds a point in the file."""
    return f"in line {lines[point]}" if lines else f"with the number {point + 1}, counted from 1,"


def _require_finite(points: Points, chosen: Chosen, name: str, lines: Sequence[int] = (), remedy: str = "") -> None:
    finite = np.isfinite(points[chosen]).all(axis=1)
    if not finite.all():
        first = int(chosen[np.argmin(finite)])
        what = f"{name}: the point {_place(first, lines)} is not finite"
        remedy = remedy or "Remove or correct the point."
        raise refused(what, points[first].tolist(), "finite coordinates in mm", remedy, kind="non_finite")


def repeats_first(chain: Plane) -> bool:
    """Return whether a chain repeats its first point at its end, but for rounding."""
    if len(chain) <= 3:
        return False
    lengths = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    return bool(np.linalg.norm(chain[0] - chain[-1]) <= CLOSING * np.median(lengths))


def require_clear_ends(chain: Plane, name: str, remedy: str = OPEN_OR_CLOSED) -> None:
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
