"""The mesh of a flow cell: a channel with a solid on its floor; the interface polygon consists of mesh edges.

The figure is cut into polygons that share vertices: fluid, and one or more parts of the solid. Elements are as small as
the mesh's name says, and smaller where a narrow gap or a sharp bend of the outline requires it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from netgen.geom2d import SplineGeometry
from netgen.meshing import MeshingParameters
from ngsolve import Mesh

from strandline.foundations import unfit
from strandline.interface import Interface, inside_polygon
from strandline.models.biofilm.mesh.outline import ON_WALL, Channel, Pairs, bodies

FLUID = "fluid"
NARROW = 0.5
"""Free height between the outline and the top, mm, below which elements get smaller; it is 0.53 in the study."""
SHARE = 0.25
"""Largest element in a narrow gap, as a share of the free height."""
SHARP = 12.0
"""Angle between two segments, degrees, above which they get more elements; at most 9.8 in the study."""
PER_SEGMENT = 4
"""Elements on a segment that meets another one at a sharp angle."""
_MOST = 2000
SNAP = 0.2
"""A cut that meets an edge within this share of its length from a vertex goes through it: no tiny elements."""
TOUCHING = 1e-6
"""Points of the floor closer than this are one, mm."""
Places = Float[np.ndarray, "place 3"]
Point = tuple[float, float]


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
    sizes, floor = np.full(len(interface.lengths), size.interface), _on_floor(interface)
    sizes[np.append(floor[1:], False) | np.insert(floor[:-1], 0, False)] = size.foot
    sizes[[0, -1]] = size.foot
    sharp = _sharp(interface)
    return np.where(sharp, np.minimum(sizes, interface.lengths / PER_SEGMENT), sizes)


def is_adapted(interface: Interface, size: MeshSize, channel: Channel) -> bool:
    """Return whether the outline requires smaller elements than those of the mesh's name."""
    return bool(_sharp(interface).any()) or len(gap_sizes(interface, size, channel)) > 0


def _on_floor(interface: Interface) -> np.ndarray:
    """Return which segments lie on the floor, between two bodies, (segment,)."""
    return np.asarray(np.maximum(np.abs(interface.starts[:, 1]), np.abs(interface.ends[:, 1])) < ON_WALL)


def _sharp(interface: Interface) -> np.ndarray:
    """Return which segments meet a neighbour at a sharp angle, (segment,)."""
    dx, dy = (interface.ends - interface.starts).T
    turn = np.abs((np.diff(np.degrees(np.arctan2(dy, dx))) + 180.0) % 360.0 - 180.0) > SHARP
    floor = _on_floor(interface)
    turn &= ~(floor[1:] | floor[:-1])
    return np.asarray(np.append(turn, False) | np.insert(turn, 0, False))


@dataclass(frozen=True)
class Partition:
    """How a solid is cut into parts.

    Args:
        lines: straight cuts ((x, y), (x, y)), mm, in order; each divides those parts that it crosses from side to side.
        markers: a point inside each part; the order numbers the parts 1, 2, …
    """

    lines: tuple[tuple[Point, Point], ...] = ()
    markers: tuple[Point, ...] = ()

    PRESETS: ClassVar[dict[str, "Partition"]] = {}


Partition.PRESETS["three_parts"] = Partition(
    lines=(((0.40, 0.12), (1.50, 0.12)), ((0.78, 0.10), (0.78, 0.60))),
    markers=((0.65, 0.25), (1.00, 0.30), (0.90, 0.05)),
)
"""The heterogeneous specimen of the study (S6): part 2 the largest, part 3 on the ground; for the study's outline."""


@dataclass(frozen=True)
class PolygonEdge:
    """A straight edge from vertex `start` to `end` with the polygons on its sides; None outside."""

    start: int
    end: int
    left: str
    right: str | None


@dataclass
class Subdivision:
    """Vertices, and polygons as counter-clockwise rings of vertex numbers, by name."""

    vertices: list[Point]
    rings: dict[str, list[int]] = field(default_factory=dict)

    def cut(self, names: list[str], line: tuple[Point, Point]) -> list[str]:
        """Divide each of the named polygons that `line` crosses from side to side; return the names afterwards."""
        result = []
        for name in names:
            result.append(name)
            crossings, ring = self._crossings(name, line), self.rings[name]
            i, j = sorted(map(ring.index, crossings)) if len(crossings) == 2 else (0, 1)
            if j - i not in (1, len(ring) - 1):
                result.append(f"piece {len(self.rings)}")
                self.rings[name], self.rings[result[-1]] = ring[i : j + 1], ring[j:] + ring[: i + 1]
        return result

    def split_floor(self, x: float) -> None:
        """Put a vertex at (x, 0) on the edge of a polygon that has x inside; none if a vertex is there."""
        for ring in list(self.rings.values()):
            for start, end in _pairs(ring):
                (x0, y0), (x1, y1) = self.vertices[start], self.vertices[end]
                if y0 == y1 == 0 and min(x0, x1) + TOUCHING < x < max(x0, x1) - TOUCHING:
                    self._insert(start, end, (x, 0.0))
                    return

    def rename(self, names: list[str], markers: tuple[Point, ...], prefix: str) -> list[str]:
        """Name the polygons prefix1, prefix2, … by the marker that lies in each."""
        if len(markers) != len(names):
            expected = f"{len(names)}, one in each part that the lines make of this outline"
            remedy = "Add or remove markers, or correct the lines. `three_parts` is made for the study's outline."
            raise unfit("markers of the partition", f"{len(markers)} markers", expected, remedy)
        found = [[name for name in names if self.contains(name, marker)] for marker in markers]
        for marker, inside in zip(markers, found, strict=True):
            if len(inside) != 1 or found.count(inside) > 1:
                place = f"({marker[0]:g}, {marker[1]:g}) mm"
                expected = "a point inside the solid, each in a part of its own"
                raise unfit("marker of the partition", place, expected, "Move the marker.")
        chosen = {f"{prefix}{k}": self.rings[inside[0]] for k, inside in enumerate(found, 1)}
        for name in names:
            del self.rings[name]
        self.rings |= chosen
        return list(chosen)

    def contains(self, name: str, point: Point) -> bool:
        corners = np.array([self.vertices[v] for v in self.rings[name]])
        return bool(inside_polygon(np.array(point), corners))

    def edges(self) -> Iterator[PolygonEdge]:
        """Yield every edge once, with the polygons on both sides."""
        owner = {pair: name for name, ring in self.rings.items() for pair in _pairs(ring)}
        seen: set[tuple[int, int]] = set()
        for (start, end), name in owner.items():
            if (end, start) not in seen:
                seen.add((start, end))
                yield PolygonEdge(start, end, name, owner.get((end, start)))

    def _crossings(self, name: str, line: tuple[Point, Point]) -> list[int]:
        """Return the vertices at which `line` meets a polygon, created if they do not exist yet."""
        found: list[int] = []
        for start, end in _pairs(self.rings[name]):
            vertex = self._meeting(start, end, line)
            if vertex is not None and vertex not in found:
                found.append(vertex)
        return found

    def _meeting(self, start: int, end: int, line: tuple[Point, Point]) -> int | None:
        a, b, p, q = (np.array(c) for c in (self.vertices[start], self.vertices[end], *line))
        s, t = _intersection(a, b - a, p, q - p)
        if not (0 <= s <= 1 and 0 <= t <= 1):
            return None
        if s < SNAP:
            return start
        if s > 1 - SNAP:
            return end
        x, y = a + s * (b - a)
        return self._insert(start, end, (float(x), float(y)))

    def _insert(self, start: int, end: int, point: Point) -> int:
        """Put a new vertex between two neighbours of every ring that has this edge; return its number."""
        self.vertices.append(point)
        vertex = len(self.vertices) - 1
        for ring in self.rings.values():
            for i, pair in enumerate(_pairs(ring)):
                if pair in ((start, end), (end, start)):
                    ring.insert(i + 1, vertex)
                    break
        return vertex


def _pairs(ring: list[int]) -> list[tuple[int, int]]:
    return list(zip(ring, ring[1:] + ring[:1], strict=True))


def _intersection(
    a: Float[np.ndarray, "2"], d: Float[np.ndarray, "2"], p: Float[np.ndarray, "2"], e: Float[np.ndarray, "2"]
) -> tuple[float, float]:
    """Return s, t with a + s d = p + t e; NaN for parallel lines."""
    denominator = d[0] * e[1] - d[1] * e[0]
    if denominator == 0:
        return float("nan"), float("nan")
    gap = p - a
    return float((gap[0] * e[1] - gap[1] * e[0]) / denominator), float((gap[0] * d[1] - gap[1] * d[0]) / denominator)


def subdivide(
    interface: Interface, channel: Channel, partition: Partition, clamped: Pairs = ()
) -> tuple[Subdivision, list[str]]:
    """Return fluid and solid as polygons, and the names of the solid's parts: ``solid``, or ``solid1``, ``solid2`` etc.

    The first vertices are those of `interface`, in its order. Several bodies without a partition are one part; their
    polygons are called ``solid``, ``solid@2`` etc. The ends of the `clamped` stretches of the floor are vertices.
    """
    outline: list[Point] = [(float(x), 0.0 if abs(y) < ON_WALL else float(y)) for x, y in interface.points]
    outline[0], outline[-1] = _on_wall(outline[0], 0.0), _on_wall(outline[-1], channel.length)
    corners = [(0.0, 0.0), (channel.length, 0.0), (channel.length, channel.height), (0.0, channel.height)]
    count = len(outline)
    origin, right, top_right, top_left = range(count, count + 4)
    along = list(range(count))
    # A lower corner belongs to the solid if the outline ends on the channel's end, above it; else to the fluid.
    of_solid = [corner for corner, end in ((origin, outline[0]), (right, outline[-1])) if end[1] > 0]
    before, after = ([c] if c not in of_solid else [] for c in (origin, right))
    fluid = [*before, *along, *after, top_right, top_left]
    solids = [list(reversed(along[body])) for body in bodies(interface.points)]
    solids[-1] = [*(c for c in of_solid if c == right), *solids[-1]]
    solids[0] = [*(c for c in of_solid if c == origin), *solids[0]]
    names = ["solid", *(f"solid@{k}" for k in range(2, len(solids) + 1))]
    figure = Subdivision([*outline, *corners], {FLUID: fluid} | dict(zip(names, solids, strict=True)))
    parts = names
    for line in partition.lines:
        parts = figure.cut(parts, line)
    for x in sorted({x for stretch in clamped for x in stretch}):
        figure.split_floor(x)
    divided = partition.lines or (len(names) > 1 and partition.markers)
    return figure, figure.rename(parts, partition.markers, "solid") if divided else names[:1]


def _on_wall(end: Point, wall: float) -> Point:
    """Return an end of the outline, moved exactly onto the floor or the channel's end if it is within 1e-9 of it."""
    x, y = end
    return (x, 0.0) if abs(y) < ON_WALL else (wall, y)


def mesh_flow_cell(
    interface: Interface,
    size: MeshSize,
    channel: Channel = Channel(),
    partition: Partition = Partition(),
    clamped: Pairs = (),
) -> Any:
    """Return the NGSolve mesh of a channel with a solid below `interface`.

    Regions: ``fluid`` and the parts of the solid; boundaries: ``inlet``, ``outlet``, ``top``, ``floor``, ``base``,
    ``loose`` (the base beside the clamped stretches, if there are any), ``side`` (a layer's ends), ``interface``,
    ``inner`` (between parts). Deterministic: the same arguments give the same mesh, bit for bit.
    """
    figure, _ = subdivide(interface, channel, partition, clamped)
    number = {name: k for k, name in enumerate((FLUID, *(name for name in figure.rings if name != FLUID)), 1)}
    geometry = SplineGeometry()
    along = segment_sizes(interface, size)
    ids = [geometry.AppendPoint(x, y) for x, y in figure.vertices]
    for edge in sorted(figure.edges(), key=lambda e: _place(e, figure, channel)):
        name = _name(edge, figure, channel, clamped)
        largest = 2 * size.interface if name in ("base", "loose", "inner") else size.far
        largest = along[min(edge.start, edge.end)] if name == "interface" else largest
        sides = {"leftdomain": number[edge.left], "rightdomain": number[edge.right] if edge.right else 0}
        geometry.Append(["line", ids[edge.start], ids[edge.end]], bc=name, maxh=largest, **sides)
    for name, k in number.items():
        geometry.SetMaterial(k, name.partition("@")[0])
    parameters = MeshingParameters(maxh=size.far, grading=size.grading)
    for x, y, largest in gap_sizes(interface, size, channel).tolist():
        parameters.RestrictH(x=x, y=y, z=0.0, h=largest)
    for x in (x for stretch in clamped for x in stretch):
        parameters.RestrictH(x=x, y=0.0, z=0.0, h=size.foot)
    return Mesh(geometry.GenerateMesh(parameters))


def _place(edge: PolygonEdge, figure: Subdivision, channel: Channel) -> tuple[int, float]:
    """Order: the outer boundary counter-clockwise from the origin, the interface along itself, then inner edges."""
    if edge.right is None:
        (x0, y0), (x1, y1) = figure.vertices[edge.start], figure.vertices[edge.end]
        x, y, length, height = 0.5 * (x0 + x1), 0.5 * (y0 + y1), channel.length, channel.height
        if y == 0:
            return 0, x
        if x == length:
            return 0, length + y
        return (0, 2 * length + height - x) if y == height else (0, 2 * (length + height) - y)
    return (1, 0.5 * (edge.start + edge.end)) if FLUID in (edge.left, edge.right) else (2, 0.0)


def _name(edge: PolygonEdge, figure: Subdivision, channel: Channel, clamped: Pairs) -> str:
    if edge.right is not None:
        return "interface" if FLUID in (edge.left, edge.right) else "inner"
    (x0, y0), (x1, y1) = figure.vertices[edge.start], figure.vertices[edge.end]
    if y0 == y1 == 0:
        held = not clamped or any(a < 0.5 * (x0 + x1) < b for a, b in clamped)
        return "floor" if edge.left == FLUID else ("base" if held else "loose")
    if y0 == y1 == channel.height:
        return "top"
    if edge.left != FLUID:
        return "side"
    at_left = x0 == x1 == 0
    return "inlet" if at_left == (channel.inlet == "left") else "outlet"
