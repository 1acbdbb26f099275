"""Outlines in JSON: GeoJSON (RFC 7946), as shapely, rasterio and QuPath write it, and labelme.

A file of GeoJSON is read as it is, y up. What rasterio without a georeference, QuPath and labelme write are pixels of a
picture, y down: such a file belongs to the picture, see `strandline.imaging.paths`.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.readers.contents import Contents
from strandline.readers.options import Reading
from strandline.readers.problems import refused

__all__ = ["Outline", "outlines", "read_json"]

Outline = tuple[Float[np.ndarray, "point 2"], bool]
"""Points (point, xy) and whether the last one is joined to the first."""
DRAWN = {"polygon": True, "linestrip": False, "line": False}
"""Shapes of labelme → whether they are closed."""
NESTED = {"LineString": 0, "MultiLineString": 1, "Polygon": 1, "MultiPolygon": 2}
"""Geometries of GeoJSON → depth of the lists in which their lines or rings are."""


def read_json(path: Path, how: Reading, name: str) -> Contents:
    """Return the outlines of a GeoJSON file, each a piece of its own."""
    found = outlines(path.read_bytes())
    if not found:
        raise refused(f"{name} holds no outline", "JSON", "GeoJSON with a LineString or a Polygon")
    return Contents.of_outlines(found)


def outlines(content: bytes) -> list[Outline]:
    """Return the outlines in a GeoJSON or labelme file, holes as well.

    Raises:
        ValueError: (also KeyError, TypeError) The content is no JSON, or damaged.
    """
    found = json.loads(content)
    if isinstance(found, dict) and "shapes" in found:
        drawn = [shape for shape in found["shapes"] if shape["shape_type"] in DRAWN]
        return [(_points(shape["points"]), DRAWN[shape["shape_type"]]) for shape in drawn]
    return list(_geometries(found))


def _geometries(found: Any) -> Iterator[Outline]:
    for inner in [*found.get("features", ()), *found.get("geometries", ()), found.get("geometry")]:
        if inner is not None:
            yield from _geometries(inner)
    kind = found.get("type", "")
    lines = [found["coordinates"]] if kind in NESTED else []
    for _ in range(NESTED.get(kind, 0)):
        lines = [line for outer in lines for line in outer]
    yield from ((_points(line), kind.endswith("Polygon")) for line in lines)


def _points(rows: list[Any]) -> Float[np.ndarray, "point 2"]:
    return np.array([row[:2] for row in rows], dtype=float).reshape(-1, 2)
