"""XDMF through meshio, after a check of what the file refers to.

An XDMF file names the HDF5 files that hold its numbers, and those can refer to others. Nothing outside the folder of
the XDMF file is opened.
"""

from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from strandline.readers.by_meshio import converted, imported
from strandline.readers.contents import Contents
from strandline.readers.options import Reading
from strandline.readers.series import chosen_time
from strandline.readers.unpacking import Allowance
from strandline.readers.vtk_xml import beside

__all__ = ["read_xdmf"]


def read_xdmf(path: Path, how: Reading, name: str) -> Contents:
    """Return the contents of an XDMF file, or of one of its times; each function may have a series of its own."""
    meshio = imported(name)
    root = ElementTree.fromstring(path.read_bytes())
    _require_own_data(path, root)
    if not any("CollectionType" in grid.attrib for grid in root.iter("Grid")):
        return converted(meshio.xdmf.read(str(path)))
    with meshio.xdmf.TimeSeriesReader(str(path)) as series:
        points, cells = series.read_points_cells()
        point_data: dict[str, Any] = {}
        cell_data: dict[str, Any] = {}
        for grid in (grid for grid in series.domain if grid.get("GridType") == "Collection"):
            series.collection = list(grid)
            times = [float(step.find("Time").attrib["Value"]) for step in series.collection]
            _, of_points, of_cells = series.read_data(chosen_time(times, how, name))
            point_data |= of_points
            cell_data |= of_cells
    return converted(meshio.Mesh(points, cells, point_data=point_data, cell_data=cell_data))


def _require_own_data(path: Path, root: ElementTree.Element) -> None:
    """Refuse data outside the folder of the file, and data that unpack to far more than the files that hold them.

    Raises:
        ValueError: (also KeyError, OSError) There are such data; the message shows the place.
    """
    allowances: dict[Path, Allowance] = {}
    for item in root.iter("DataItem"):
        form, text = item.get("Format", ""), (item.text or "").strip()
        if form == "Binary":
            raise ValueError(f"its data in {text} are of the format Binary, which is not read; write HDF or XML")
        if form == "HDF":
            source, _, place = text.partition(":")
            file = beside(path, source)
            allowance = allowances.setdefault(file, Allowance(file.stat().st_size))
            _require_dataset(file, place, allowance)


def _require_dataset(file: Path, place: str, allowance: Allowance) -> None:
    """Refuse anything but a plain array of numbers within the file itself."""
    h5py: Any = import_module("h5py")
    with h5py.File(file, "r") as found:
        inner: Any = found
        for key in place.strip("/").split("/"):
            if not isinstance(inner.get(key, getlink=True), h5py.HardLink):
                raise ValueError(f"{file.name} refers to data elsewhere at {place}")
            inner = inner[key]
        if not isinstance(inner, h5py.Dataset) or inner.dtype.kind not in "iuf":
            raise ValueError(f"{file.name} holds no numbers at {place}")
        if inner.external or inner.is_virtual:
            raise ValueError(f"{file.name} refers to data in other files at {place}")
        allowance.take(inner.size * inner.dtype.itemsize)
