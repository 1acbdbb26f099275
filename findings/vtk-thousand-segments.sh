#!/usr/bin/env bash
# EXPECTED: "strip" joins the loose segments of a contour to one polyline for each connected curve.
# HAPPENS:  a polyline ends after 1000 segments, in silence, and the rest becomes further "curves". A closed outline is
#           one closed line up to 1000 segments; with more, its first line is an open arc. (max_length sets the limit;
#           join=True makes one line again, but with points twice where the pieces meet.)
#           "length" of what remains is the diagonal of its bounding box.
# VERSION:  pyvista 0.49.1 with VTK 9.7.2 (vtkStripper).
# MATTERS:  On a coarse picture or mesh the first line is the whole interface. On a finer one, the same program takes a
#           part of it: a mesh study seems to converge and then jumps, and a calibration fits the part that is left.
# Exits 1 once the behaviour changes.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --disable-pip-version-check pyvista==0.49.1 vtk==9.7.2 numpy==2.4.6
cd "$work"
venv/bin/python - <<'PYTHON'
import numpy as np
import pyvista as pv
import vtk

print(f"pyvista {pv.__version__}, VTK {vtk.vtkVersion.GetVTKVersion()}")
print("outline of a drop of radius 1 (area 3.142, perimeter 6.283) from pictures of n x n pixels\n")


def outline(n):
    """Return the level set of a drop in a picture, as loose segments."""
    picture = pv.ImageData(dimensions=(n, n, 1), spacing=(3 / (n - 1),) * 2 + (1,), origin=(-1.5, -1.5, 0))
    picture["level"] = 1 - np.hypot(*picture.points[:, :2].T)
    return picture.contour([0.0])


def measured(line):
    """Return the area within a line (closed if it is not) and its length."""
    x, y = line.points[:, :2].T
    steps = np.hypot(np.diff(x), np.diff(y)).sum()
    return 0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)), steps, len(x)


print("   n  segments  lines  first line: points  area   arc     (max_length large: lines  area   arc)")
rows = {}
for n in (100, 200, 300, 400, 800):
    loose = outline(n)
    lines, whole = loose.strip(), loose.strip(max_length=10**6)
    area, arc, points = rows[n] = measured(lines.get_cell(0))
    full = measured(whole.get_cell(0))
    print(f"{n:4} {loose.n_cells:9} {lines.n_cells:6} {points:19} {area:6.3f} {arc:6.3f}", end="  ")
    print(f"{whole.n_cells:24} {full[0]:6.3f} {full[1]:6.3f}")
    assert whole.n_cells == 1 and abs(full[0] - np.pi) < 0.01
    assert (lines.n_cells > 1) == (loose.n_cells > 1000), "changed: number of lines"
print(f"\n\"length\" of the whole outline: {whole.length:.3f}")

assert abs(rows[300][0] - np.pi) < 0.01 and abs(rows[300][1] - 2 * np.pi) < 0.01
assert rows[800][2] == 1001 and rows[800][0] < 2, "changed: a line goes on beyond 1000 segments"
print("still so: lines end after 1000 segments")
PYTHON
