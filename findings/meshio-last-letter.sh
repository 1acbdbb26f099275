#!/usr/bin/env bash
# EXPECTED: meshio.medit.read, told by its name to read Medit's format, looks at the file's suffix (.mesh is text, .meshb
#           is binary) or at its first bytes, whatever else the file is called.
# HAPPENS:  It looks at the last letter of the name alone. A text file whose name ends with "b" is read as binary and
#           refused with "Invalid code"; the same bytes under another name are read. meshio.medit.write does the same
#           in the other direction: it writes a binary file.
# VERSION:  meshio 5.3.5.
# MATTERS:  A program that hands meshio a temporary file without a suffix works 36 times of 37: Python's temporary names
#           end with a random letter, digit or underscore. The failure looks like a damaged mesh. The remedy is a suffix.
# Exits 1 once the behaviour changes.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --disable-pip-version-check meshio==5.3.5 numpy==2.4.6
cd "$work"
venv/bin/python - <<'PYTHON'
import shutil

import meshio
import numpy as np

print(f"meshio {meshio.__version__}")
points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
mesh = meshio.Mesh(points, [("triangle", [[0, 1, 2], [0, 2, 3]])])
meshio.medit.write("plate.mesh", mesh)
ends = {}
for name in ("tmp_8xa", "tmp_8xb", "plate_b", "plate_b.mesh"):
    shutil.copy("plate.mesh", name)
    try:
        ends[name] = f"{len(meshio.medit.read(name).points)} points"
    except meshio.ReadError as error:
        ends[name] = f"ReadError: {error}"
    print(f"the same bytes as {name:13} {ends[name]}")
meshio.medit.write("written_a", mesh)
meshio.medit.write("written_b", mesh)
starts = {name: open(name, "rb").read(4) for name in ("written_a", "written_b")}
print(f"first bytes written: {starts}")

assert ends["tmp_8xa"] == ends["plate_b.mesh"] == "4 points"
assert ends["tmp_8xb"] == ends["plate_b"] == "ReadError: Invalid code", "changed: the name's last letter no longer counts"
assert starts["written_a"] == b"Mesh" and starts["written_b"] == b"\x01\0\0\0"
print("still so: a name that ends with b makes a Medit file binary")
PYTHON
