"""Files with several times: PVD, and the choice of one time."""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from strandline.readers.contents import Contents
from strandline.readers.options import Reading
from strandline.readers.problems import refused
from strandline.readers.vtk_xml import beside, joined, read_vtk_xml, require_each_once

__all__ = ["chosen_time", "read_pvd"]


def read_pvd(path: Path, how: Reading, name: str) -> Contents:
    """Return the joined contents of the files that a PVD file names for one time."""
    found = [
        (float(item.get("timestep", "0")), item.attrib["file"])
        for item in ElementTree.fromstring(path.read_bytes()).iter("DataSet")
    ]
    times = sorted({time for time, _ in found})
    chosen = times[chosen_time(times, how, name)]
    files = [file for time, file in found if time == chosen]
    require_each_once(files)
    return joined([read_vtk_xml(beside(path, file), how, name) for file in files])


def chosen_time(times: Sequence[float], how: Reading, name: str) -> int:
    """Return the index of the requested time; of the last one if none is requested.

    Raises:
        Unreadable: there is no such time, or none at all.
    """
    if not times:
        raise refused(f"{name} holds no times", None, "one time or more")
    if how.time is None or isinstance(how.time, str):
        return int(np.argmax(times))
    (kind, value) = next(iter(how.time.items()))
    if kind == "index" and value < len(times):
        return int(value)
    nearest = int(np.argmin(np.abs(np.asarray(times) - value)))
    if kind == "value" and abs(times[nearest] - value) <= 1e-6 * max(abs(value), abs(times[-1] - times[0])):
        return nearest
    shown = f"{len(times)} times from {times[0]:g} to {times[-1]:g}"
    raise refused(f"{name} has no time of {kind} {value:g}", shown, "one of its times", "Correct `time`.")
