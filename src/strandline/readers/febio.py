"""Logfiles of FEBio with the places of nodes: ``<node_data data="x;y;z" file="nodes.txt"/>``.

Each time begins with lines ``*Step``, ``*Time`` and ``*Data``; then come number and values of each node, in the
order of the node set and separated by blanks or by the file's `delim`. The places are those of the deformed body.
"""

import re
from pathlib import Path

import numpy as np

from strandline.readers.contents import Contents
from strandline.readers.options import Reading
from strandline.readers.problems import refused
from strandline.readers.series import chosen_time

__all__ = ["read_febio"]


def read_febio(path: Path, how: Reading, name: str) -> Contents:
    """Return the places of the nodes at one time, in the two coordinates of `plane`."""
    content = path.read_text()
    blocks = re.split(r"^\*Step *=.*\n", content, flags=re.MULTILINE)[1:]
    times = [float(_said(block, "Time")) for block in blocks]
    block = blocks[chosen_time(times, how, name)]
    titles = [title.strip() for title in _said(block, "Data").split(";")]
    if any(axis not in titles for axis in how.plane):
        raise refused(f"{name} holds no places of nodes", ";".join(titles), "data x;y;z", "Let FEBio write x;y;z.")
    lines = [line for line in block.splitlines() if line.strip() and not line.startswith("*")]
    values = np.array([re.split(r"[,;\s]+", line.strip(" ,;\t")) for line in lines], dtype=float)
    if values.ndim != 2 or values.shape[1] != len(titles) + 1:
        raise ValueError(f"rows of {values.shape[-1]} numbers instead of {len(titles) + 1}")
    return Contents(values[:, [1 + titles.index(axis) for axis in how.plane]])


def _said(block: str, key: str) -> str:
    found = re.search(rf"^\*{key} *=(.*)$", block, flags=re.MULTILINE)
    if found is None:
        raise ValueError(f"a time without *{key}")
    return found[1].strip()
