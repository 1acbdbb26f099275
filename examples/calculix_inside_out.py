"""A second command for CalculiX (`post`): fails if a brick is inside out, else writes the nodes of an edge.

It reads block.inp (C3D8 in the element set EALL, nodes in NALL) and block.dat (`*NODE PRINT, NSET=NALL` with `U`).
"""

import sys
from pathlib import Path

import numpy as np

NEIGHBOURS = [(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)]  # of a corner

deck = dict(part.partition("\n")[::2] for part in Path("block.inp").read_text("ascii").split("*"))
nodes = np.loadtxt(deck["NODE, NSET=NALL"].splitlines(), delimiter=",")
bricks = np.loadtxt(deck["ELEMENT, TYPE=C3D8, ELSET=EALL"].splitlines(), delimiter=",", dtype=int, ndmin=2)
last = Path("block.dat").read_text("ascii").split("displacements")[-1]
printed = np.loadtxt(last.splitlines()[1:])  # of all nodes, by number
place = {int(number): np.add(x, u) for (number, *x), (_, *u) in zip(nodes, printed, strict=True)}

corners = np.array([[place[number] for number in brick[1:9]] for brick in bricks])
volumes = np.linalg.det(corners[:, NEIGHBOURS] - corners[:, :, None])  # of the edges at each corner
if (volumes <= 0).any():
    sys.exit(f"element {bricks[(volumes <= 0).any(axis=1)][0, 0]} is inside out")
np.savetxt("edge.csv", [place[5][1:], place[8][1:]], delimiter=",", header="x,y", comments="")
