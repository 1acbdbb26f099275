"""Logfiles of FEBio with the places of nodes, of the deformed body: ``<node_data data="x;y;z" file="nodes.txt"/>``.

After the lines ``*Step``, ``*Time`` and ``*Data`` come number and values of each node, in the order of the node set.
"""

import re
from pathlib import Path

import numpy as np

from strandline.readers.contents import Contents
from strandline.readers.options import Reading
from strandline.readers.problems import refused
from strandline.readers.series import chosen_time

__all__ = ["read_febio"]

STEP = re.compile(r"^\*Step *=.*\n\*Time *=(.*)\n\*Data *=(.*)\n([^*]*)", re.MULTILINE)


def read_febio(path: Path, how: Reading, name: str) -> Contents:
    """Return the places of the nodes at one time, in the two coordinates of `plane`."""
    steps = STEP.findall(path.read_text())
    _, data, rows = steps[chosen_time([float(time) for time, _, _ in steps], how, name)]
    titles = ["", *(title.strip() for title in data.split(";"))]
    if not set(how.plane) <= set(titles):
        raise refused(f"{name} holds no places of nodes", data.strip(), "data x;y;z", "Let FEBio write x;y;z.")
    values = np.array([re.findall(r"[^,;\s]+", row) for row in rows.splitlines() if row.strip()], dtype=float)
    return Contents(values.reshape(-1, len(titles))[:, [titles.index(axis) for axis in how.plane]])
