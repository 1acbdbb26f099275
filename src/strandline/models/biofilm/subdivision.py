"""A plane figure cut into polygons that share vertices: fluid, and one or more parts of the solid."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput

__all__ = ["Edge", "Partition", "Subdivision", "check_partition"]

Point = tuple[float, float]
SNAP = 0.2
"""A cut that meets an edge within this share of its length from a vertex goes through it: no tiny elements."""

TOUCHING = 1e-6
"""Points of the floor closer than this are one, mm."""


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


def check_partition(lines: Sequence[object] = (), markers: Sequence[object] = ()) -> None:
    """Refuse lists from a study file that are not the lines and markers of a partition.

    Raises:
        InvalidInput: There is such a list; the message shows it.
    """
    for what, given, shape, example in (
        ("lines", lines, (2, 2), "pairs of points in mm, e.g. [[[0.4, 0.1], [1.5, 0.1]]]"),
        ("markers", markers, (2,), "points in mm, e.g. [[0.6, 0.2], [0.9, 0.05]]"),
    ):
        if not (isinstance(given, list | tuple) and all(_is_numbers(item, shape) for item in given)):
            raise InvalidInput(
                f"{what} of the partition",
                value=given,
                expected=f"a list of {example}",
                remedy="Correct the brackets and numbers.",
            )


def _is_numbers(value: object, shape: tuple[int, ...]) -> bool:
    """Return whether `value` is an array of finite numbers with this shape."""
    try:
        array = np.array(value, float)
    except (TypeError, ValueError):
        return False
    return array.shape == shape and bool(np.isfinite(array).all())


@dataclass(frozen=True)
class Edge:
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
            crossings = self._crossings(name, line)
            if len(crossings) != 2:
                result.append(name)
                continue
            ring = self.rings[name]
            i, j = sorted(ring.index(vertex) for vertex in crossings)
            if j - i in (1, len(ring) - 1):
                result.append(name)
                continue
            other = f"piece {len(self.rings)}"
            self.rings[name], self.rings[other] = ring[i : j + 1], ring[j:] + ring[: i + 1]
            result += [name, other]
        return result

    def split_floor(self, x: float) -> None:
        """Put a vertex at (x, 0) on the edge of a polygon that has x inside; none if a vertex is there."""
        for ring in list(self.rings.values()):
            for start, end in _pairs(ring):
                (x0, y0), (x1, y1) = self.vertices[start], self.vertices[end]
                if y0 == y1 == 0 and min(x0, x1) + TOUCHING < x < max(x0, x1) - TOUCHING:
                    self.vertices.append((x, 0.0))
                    self._insert(start, end, len(self.vertices) - 1)
                    return

    def rename(self, names: list[str], markers: tuple[Point, ...], prefix: str) -> list[str]:
        """Name the polygons prefix1, prefix2, … by the marker that lies in each."""
        if len(markers) != len(names):
            raise InvalidInput(
                "markers of the partition",
                value=f"{len(markers)} markers",
                expected=f"{len(names)}, one in each part that the lines make of this outline",
                remedy="Add or remove markers, or correct the lines. `three_parts` is made for the study's outline.",
            )
        found = [[name for name in names if self.contains(name, marker)] for marker in markers]
        for marker, inside in zip(markers, found, strict=True):
            if len(inside) != 1 or found.count(inside) > 1:
                raise InvalidInput(
                    "marker of the partition",
                    value=f"({marker[0]:g}, {marker[1]:g}) mm",
                    expected="a point inside the solid, each in a part of its own",
                    remedy="Move the marker.",
                )
        chosen = {f"{prefix}{k}": self.rings[inside[0]] for k, inside in enumerate(found, 1)}
        for name in names:
            del self.rings[name]
        self.rings |= chosen
        return list(chosen)

    def contains(self, name: str, point: Point) -> bool:
        """Return whether `point` lies inside a polygon, by the crossings of a ray."""
        a = np.array([self.vertices[v] for v in self.rings[name]])
        b = np.roll(a, -1, axis=0)
        spans = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            at = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
        return bool(np.sum(spans & (at > point[0])) % 2)

    def area(self, name: str) -> float:
        """Return the area of a polygon."""
        x, y = np.array([self.vertices[v] for v in self.rings[name]]).T
        return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))

    def edges(self) -> Iterator[Edge]:
        """Yield every edge once, with the polygons on both sides."""
        owner = {pair: name for name, ring in self.rings.items() for pair in _pairs(ring)}
        seen: set[tuple[int, int]] = set()
        for (start, end), name in owner.items():
            if (end, start) not in seen:
                seen.add((start, end))
                yield Edge(start, end, name, owner.get((end, start)))

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
        self.vertices.append((float(x), float(y)))
        self._insert(start, end, len(self.vertices) - 1)
        return len(self.vertices) - 1

    def _insert(self, start: int, end: int, vertex: int) -> None:
        """Put a vertex between two neighbours of every ring that has this edge."""
        for ring in self.rings.values():
            for i, pair in enumerate(_pairs(ring)):
                if pair in ((start, end), (end, start)):
                    ring.insert(i + 1, vertex)
                    break


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
