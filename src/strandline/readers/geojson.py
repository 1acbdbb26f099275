"""Outlines that GeoJSON and labelme hold."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.readers.contents import Contents
from strandline.readers.options import Reading

DrawnLine = tuple[Float[np.ndarray, "point 2"], bool]
CLOSED = {"polygon": True, "linestrip": False, "line": False}
CLOSED |= {"Polygon": True, "MultiPolygon": True, "LineString": False, "MultiLineString": False}
"""Shapes of labelme and geometries of GeoJSON → whether they are closed."""


def read_json(path: Path, how: Reading, name: str) -> Contents:
    """Return the outlines of a GeoJSON file, each a piece of its own."""
    found = [points for points, _ in outlines(path.read_bytes())]
    if not found:
        raise ValueError("no LineString or Polygon of GeoJSON in it")
    return Contents(np.concatenate(found), pieces=np.repeat(np.arange(len(found)), [len(points) for points in found]))


def outlines(content: bytes) -> list[DrawnLine]:
    """Return points of each outline in a GeoJSON or labelme file, holes as well, and whether it is closed."""
    return list(_drawn(json.loads(content)))


def _drawn(found: Any) -> Iterator[DrawnLine]:
    inner = [one for key in ("features", "geometries", "shapes") for one in found.get(key, ())]
    for one in filter(None, [*inner, found.get("geometry")]):
        yield from _drawn(one)
    closed = CLOSED.get(found.get("shape_type", found.get("type")))
    if closed is not None:
        lines = [found["points"] if "points" in found else found["coordinates"]]
        while not isinstance(lines[0][0][0], int | float):
            lines = [line for outer in lines for line in outer]
        yield from ((np.array([row[:2] for row in line], dtype=float), closed) for line in lines)
