"""CalculiX: printed displacements of a node set (``.dat``), and results of the whole mesh (``.frd``).

A ``.frd`` file has columns of fixed width, in which numbers touch: ten characters for a number of a node, twelve for a
value (CalculiX Graphix' manual, "Result Format"). Places are those of the undeformed body.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from strandline.readers.contents import Block, Contents, refused
from strandline.readers.options import Reading
from strandline.readers.vtk_xml import chosen_time

PRINTED = re.compile(r"(?m)^ *displacements \(vx,vy,vz\) for set (\S+) and time +(\S+)\n\s*\n((?:[ \d].*(?:\n|\Z))*)")
"""Heading of printed displacements, with the set and the time, and their rows."""
KINDS = {"1": "hexahedron", "2": "wedge", "3": "tetra", "4": "hexahedron20", "6": "tetra10", "7": "triangle"}
KINDS |= {"8": "triangle6", "9": "quad", "10": "quad8", "11": "line", "12": "line3"}
"""Numbers of kinds of elements → their names."""
MIDDLES = [*range(12), *range(16, 20), *range(12, 16)]
"""A hexahedron with 20 nodes lists the middles of its upright edges before those above."""
STEP = re.compile(r"^\*Step *=.*\n\*Time *=(.*)\n\*Data *=(.*)\n([^*]*)", re.MULTILINE)


def read_dat(path: Path, how: Reading, name: str) -> Contents:
    """Return the nodes of a set, printed by ``*NODE PRINT`` with U, at one time; the deck ``.inp`` has their places."""
    printed = PRINTED.findall(path.read_text(encoding="ascii"))
    times = list(dict.fromkeys(float(time) for _, time, _ in printed))
    time = times[chosen_time(times, how, name)]
    rows = [text for _, at, text in printed if float(at) == time]
    if len(rows) != 1:
        sets = ", ".join(dict.fromkeys(one for one, _, _ in printed))
        raise refused(f"{name} holds displacements of several sets", sets, "one set", "Print U of the interface alone.")
    values = np.array([line.split() for line in rows[0].splitlines()], dtype=float)
    if values.ndim != 2 or values.shape[1] != 4 or len({text.count("\n") for _, _, text in printed}) > 1:
        raise ValueError("rows of displacements are cut off")
    deck = path.with_suffix(".inp")
    places = dict(_nodes(deck.read_text())) if deck.is_file() else {}
    missing = [int(node) for node in values[:, 0] if int(node) not in places]
    if missing:
        value, remedy = f"no node {missing[0]} in {deck.name}", f"Keep the deck beside it; or read {path.stem}.frd."
        raise refused(f"{name} holds displacements without places", value, "the deck of the run", remedy)
    points = np.array([places[int(node)] for node in values[:, 0]])
    return Contents(points[:, how.axes], displacement=values[:, 1:][:, how.axes])


def _nodes(deck: str) -> Iterator[tuple[int, list[float]]]:
    """Yield number and place of each node of the ``*NODE`` cards."""
    reads = False
    for line in deck.splitlines():
        if line.startswith("*"):
            reads = reads if line.startswith("**") else re.match(r"\*NODE\s*(,|$)", line, re.IGNORECASE) is not None
        elif reads and line.strip(" ,\t"):
            number, *place = line.split(",")
            yield int(number), [*(float(x) for x in place if x.strip()), 0.0, 0.0][:3]


def read_frd(path: Path, how: Reading, name: str) -> Contents:
    """Return the mesh, and the results of one time as point data, e.g. DISP."""
    lines = [line.rstrip() for line in path.read_bytes().decode("ascii", "replace").splitlines()]
    if lines[-1:] != [" 9999"]:
        raise ValueError("the file is cut off")
    nodes = _values(lines, next(k for k, line in enumerate(lines) if line.startswith("    2C")))
    order = {node: k for k, node in enumerate(nodes)}
    results = [(float(line[12:24]), k) for k, line in enumerate(lines) if line.startswith("  100C")]
    times = list(dict.fromkeys(time for time, _ in results))
    chosen = times[chosen_time(times, how, name)] if times else 0.0
    data = {}
    for k in (k for time, k in results if time == chosen):
        values = _values(lines, k)
        data[lines[k + 1].split()[1]] = whole = np.full((len(nodes), len(next(iter(values.values())))), np.nan)
        whole[[order[node] for node in values]] = list(values.values())
    return Contents(np.array(list(nodes.values())), _blocks(lines, order), data)


def _values(lines: list[str], start: int) -> dict[int, list[float]]:
    """Return the values of each node in the block that begins at `start`."""
    block = [line for line in lines[start : lines.index(" -3", start)] if line.startswith(" -1")]
    return {int(line[3:13]): [float(line[c : c + 12]) for c in range(13, len(line), 12)] for line in block}


def _blocks(lines: list[str], order: dict[int, int]) -> tuple[Block, ...]:
    found: dict[str, list[list[int]]] = {}
    start = next(k for k, line in enumerate(lines) if line.startswith("    3C"))
    for mark, *words in (line.split() for line in lines[start + 1 : lines.index(" -3", start)]):
        if mark == "-1":
            nodes: list[int] = []
            found.setdefault(KINDS.get(words[1], f"type {words[1]}"), []).append(nodes)
        else:
            nodes += [order[int(node)] for node in words]
    blocks = {kind: np.array(elements, dtype=np.int64) for kind, elements in found.items()}
    if "hexahedron20" in blocks:
        blocks["hexahedron20"] = blocks["hexahedron20"][:, MIDDLES]
    return tuple(Block(kind, elements) for kind, elements in blocks.items())


def read_febio(path: Path, how: Reading, name: str) -> Contents:
    """Return the places of the nodes at one time, in the two coordinates of `plane`."""
    steps = STEP.findall(path.read_text())
    _, data, rows = steps[chosen_time([float(time) for time, _, _ in steps], how, name)]
    titles = ["", *(title.strip() for title in data.split(";"))]
    if not set(how.plane) <= set(titles):
        raise refused(f"{name} holds no places of nodes", data.strip(), "data x;y;z", "Let FEBio write x;y;z.")
    values = np.array([re.findall(r"[^,;\s]+", row) for row in rows.splitlines() if row.strip()], dtype=float)
    return Contents(values.reshape(-1, len(titles))[:, [titles.index(axis) for axis in how.plane]])
