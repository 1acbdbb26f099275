"""CalculiX's printed displacements of the node set TOP → the outline at half and at full pressure, mm."""

import csv
from pathlib import Path

import numpy as np

NAMES = ("half.csv", "full.csv")


def reference(deck: str) -> dict[int, tuple[float, float]]:
    """Return the undeformed (r, z) of every node of the deck."""
    rows = deck.partition("*NODE")[2].partition("\n")[2].partition("*")[0].split("\n")
    numbers = [row.split(",") for row in rows if row.strip()]
    return {int(node): (float(r), float(z)) for node, r, z, _ in numbers}


def displacements(printed: str) -> list[dict[int, tuple[float, float]]]:
    """Return the displacements by node, of each step that was finished."""
    steps: list[dict[int, tuple[float, float]]] = []
    for words in map(str.split, printed.splitlines()):
        if words[:1] == ["displacements"]:
            steps.append({})
        elif len(words) == 4 and words[0].isdigit():
            steps[-1][int(words[0])] = (float(words[1]), float(words[2]))
    return steps


def main() -> None:
    places = reference(Path("bulge.inp").read_text(encoding="ascii"))
    for name, moved in zip(NAMES, displacements(Path("bulge.dat").read_text(encoding="ascii")), strict=False):
        points = np.array([np.add(places[node], step) for node, step in moved.items()])
        with Path(name).open("w", newline="", encoding="ascii") as file:
            csv.writer(file).writerows([("r", "z"), *points[np.argsort(list(moved))].tolist()])


if __name__ == "__main__":
    main()
