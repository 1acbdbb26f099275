"""CalculiX: printed displacements of a node set (``.dat``), and results of the whole mesh (``.frd``).

A ``.frd`` file has columns of fixed width, in which numbers touch: ten characters for a number of a node, twelve for a
value (CalculiX Graphix' manual, "Result Format"). Places are those of the undeformed body.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.readers.contents import Block, Contents
from strandline.readers.options import Reading
from strandline.readers.problems import refused
from strandline.readers.series import chosen_time

__all__ = ["read_dat", "read_frd"]

PRINTED = re.compile(
    r"^ *displacements \(vx,vy,vz\) for set (\S+) and time +(\S+)\n\s*\n((?:[ \d].*(?:\n|\Z))*)", re.MULTILINE
)
"""Heading of printed displacements, with the set and the time, and their rows."""
KINDS = {
    1: ("hexahedron", 8),
    2: ("wedge", 6),
    3: ("tetra", 4),
    4: ("hexahedron20", 20),
    6: ("tetra10", 10),
    7: ("triangle", 3),
    8: ("triangle6", 6),
    9: ("quad", 4),
    10: ("quad8", 8),
    11: ("line", 2),
    12: ("line3", 3),
}
"""Numbers of kinds of elements → their names and numbers of nodes."""
MIDDLES = [*range(12), *range(16, 20), *range(12, 16)]
"""A hexahedron with 20 nodes lists the middles of its upright edges before those above."""


def read_dat(path: Path, how: Reading, name: str) -> Contents:
    """Return the nodes of a set, printed by ``*NODE PRINT`` with U, at one time; their places are in the deck.

    Raises:
        Unreadable: Several sets are printed, or the deck ``.inp`` beside the file is missing or lacks a node.
    """
    printed = PRINTED.findall(path.read_text(encoding="ascii"))
    times = list(dict.fromkeys(float(time) for _, time, _ in printed))
    time = times[chosen_time(times, how, name)]
    rows = [text for _, at, text in printed if float(at) == time]
    if len(rows) != 1:
        sets = ", ".join(dict.fromkeys(one for one, _, _ in printed))
        raise refused(f"{name} holds displacements of several sets", sets, "one set", "Print U of the interface alone.")
    deck = path.with_suffix(".inp")
    if not deck.is_file():
        remedy = f"Keep the deck beside it, with the places of the nodes; or read {path.stem}.frd."
        raise refused(f"{name} holds displacements without places", f"no {deck.name}", "the deck of the run", remedy)
    places, values = _deck(deck), np.array([line.split() for line in rows[0].splitlines()], dtype=float)
    if values.ndim != 2 or values.shape[1] != 4 or len({text.count("\n") for _, _, text in printed}) > 1:
        raise ValueError("rows of displacements are cut off")
    missing = next((int(node) for node in values[:, 0] if int(node) not in places), None)
    if missing is not None:
        raise refused(f"{deck.name} holds no node {missing}", f"{len(places)} nodes", f"the nodes of {name}")
    points = np.array([places[int(node)] for node in values[:, 0]])
    return Contents(points[:, how.axes], displacement=values[:, 1:][:, how.axes])


def _deck(path: Path) -> dict[int, Float[np.ndarray, "3"]]:
    """Return the places by node of the ``*NODE`` cards of a deck."""
    found: dict[int, Any] = {}
    reads = False
    for line in path.read_text().splitlines():
        if line.startswith("*"):
            reads = reads if line.startswith("**") else re.match(r"\*NODE\s*(,|$)", line, re.IGNORECASE) is not None
        elif reads and line.strip(" ,\t"):
            number, *place = line.split(",")
            found[int(number)] = np.array([*(float(x) for x in place if x.strip()), 0.0, 0.0, 0.0][:3])
    return found


def read_frd(path: Path, how: Reading, name: str) -> Contents:
    """Return the mesh, and the results of one time as point data, e.g. DISP.

    Raises:
        Unreadable: The file is not in ASCII with numbers of ten digits.
        ValueError: It is cut off.
    """
    lines = path.read_bytes().decode("ascii", "replace").splitlines()
    if not lines or lines[-1].strip() != "9999":
        raise ValueError("the file is cut off")
    start = next(k for k, line in enumerate(lines) if line[:6].strip() == "2C")
    if lines[start].split()[-1] != "1":
        expected = "ASCII, with numbers of nodes of ten digits"
        raise refused(f"{name} is in another form of .frd", lines[start].strip(), expected, "Use *NODE FILE.")
    nodes = _values(lines, start + 1, 3)
    order = {node: k for k, node in enumerate(nodes)}
    results = [k for k, line in enumerate(lines) if line.startswith("  100C")]
    times = list(dict.fromkeys(float(lines[k][12:24]) for k in results))
    data: dict[str, Float[np.ndarray, "point component"]] = {}
    if times:
        time = times[chosen_time(times, how, name)]
        for k in (k for k in results if float(lines[k][12:24]) == time):
            title = lines[k + 1].split()[1]
            values = _values(lines, k + 2, sum(line.split()[-1] != "1ALL" for line in _marked(lines, k + 2, " -5")))
            data[title] = np.full((len(nodes), len(next(iter(values.values())))), np.nan)
            data[title][[order[node] for node in values]] = list(values.values())
    return Contents(np.array(list(nodes.values())), _blocks(lines, order), data)


def _marked(lines: list[str], start: int, mark: str) -> Iterator[str]:
    """Yield the lines with a mark from `start` to the end of the block."""
    for line in lines[start:]:
        if line.startswith(" -3"):
            return
        if line.startswith(mark):
            yield line


def _values(lines: list[str], start: int, number: int) -> dict[int, list[float]]:
    """Return up to six values of each node of a block."""
    columns = [slice(13 + 12 * k, 25 + 12 * k) for k in range(min(number, 6))]
    return {int(line[3:13]): [float(line[c]) for c in columns] for line in _marked(lines, start, " -1")}


def _blocks(lines: list[str], order: dict[int, int]) -> tuple[Block, ...]:
    """Return the elements by kind."""
    found: dict[str, list[list[int]]] = {}
    start = next((k for k, line in enumerate(lines) if line[:6].strip() == "3C"), len(lines))
    words = iter([line.split() for line in _marked(lines, start, " -")])
    for head in words:
        kind, number = KINDS.get(int(head[2]), (f"type {head[2]}", 0))
        nodes = [order[int(node)] for node in next(words)[1:]]
        while len(nodes) < number:
            nodes += [order[int(node)] for node in next(words)[1:]]
        found.setdefault(kind, []).append([nodes[k] for k in MIDDLES] if kind == "hexahedron20" else nodes)
    return tuple(Block(kind, np.array(nodes, dtype=np.int64)) for kind, nodes in found.items())
