"""Size of a pixel in the headers of ImageJ and OME; dots per inch alone are no scale."""

from typing import Any
from xml.etree import ElementTree

from strandline.imaging.pixel_size import PixelSize

__all__ = ["stated_size"]

TO_MM = {
    "nm": 1e-6,
    "um": 1e-3,
    "µm": 1e-3,
    "μm": 1e-3,
    "\\u00B5m": 1e-3,
    "micron": 1e-3,
    "microns": 1e-3,
    "micrometer": 1e-3,
    "mm": 1.0,
    "cm": 10.0,
    "m": 1e3,
    "inch": 25.4,
    "in": 25.4,
}
"""Units as ImageJ and OME write them; both ways to write µ occur, and its code."""


def stated_size(file: Any, page: Any) -> PixelSize | None:
    """Return the size of a pixel that the header of ImageJ or of OME states; None without a unit of length.

    Args:
        file: File that tifffile opened.
        page: First page of the series.
    """
    if file.is_ome:
        return _of_ome(file.ome_metadata)
    return _of_imagej(file.imagej_metadata or {}, page) if file.is_imagej else None


def _of_ome(header: str) -> PixelSize | None:
    """Return the size in the first ``Pixels`` of an OME header, whose unit is µm unless it names another."""
    if "<!DOCTYPE" in header:
        return None
    pixels = next((e for e in ElementTree.fromstring(header).iter() if e.tag.rpartition("}")[2] == "Pixels"), None)
    if pixels is None:
        return None
    x, y, z = (_physical(pixels, axis) for axis in "XYZ")
    return None if x is None or y is None else PixelSize(x, y, z, "the OME header")


def _physical(pixels: ElementTree.Element, axis: str) -> float | None:
    size = pixels.get(f"PhysicalSize{axis}")
    factor = TO_MM.get(pixels.get(f"PhysicalSize{axis}Unit", "µm"))
    return None if size is None or factor is None else factor * float(size)


def _of_imagej(header: dict[str, Any], page: Any) -> PixelSize | None:
    """Return the size from pixels per unit in the resolution tags, the unit from the description of ImageJ."""
    unit = header.get("unit", "")
    x, y, z = (TO_MM.get(str(header.get(name, unit))) for name in ("unit", "yunit", "zunit"))
    across, along = (_per_pixel(page, f"{axis}Resolution") for axis in "XY")
    if x is None or y is None or across is None or along is None:
        return None
    spacing = abs(float(header.get("spacing") or 0))
    return PixelSize(x * across, y * along, z * spacing if z and spacing else None, "the ImageJ header")


def _per_pixel(page: Any, tag: str) -> float | None:
    """Return units per pixel from a fraction of pixels per unit."""
    found = page.tags.get(tag)
    if found is None or 0 in found.value:
        return None
    above, below = found.value
    return float(below / above)
