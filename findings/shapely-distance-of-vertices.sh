#!/usr/bin/env bash
# EXPECTED: shapely treats lines as lines (length, distance, area are exact), so its Hausdorff and Frechet distances are
#           those of the curves, whatever points they are drawn with.
# HAPPENS:  only the vertices count. A straight wall and the same wall with one more vertex in the middle have a Frechet
#           distance of half the wall instead of 0. Two different curves through the same four points have a
#           Hausdorff distance of 0 instead of half a side. No warning; "densify" makes both nearly right.
# VERSION:  shapely 2.2.0 with GEOS 3.14.1.
# MATTERS:  As a misfit between a measured outline (many points) and a computed one (long elements), the number says how
#           finely the two are drawn. A better fit can have a larger distance, and a front whose points are joined in
#           the wrong order has the distance 0.
# Exits 1 once the behaviour changes.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --disable-pip-version-check shapely==2.2.0 numpy==2.4.6
cd "$work"
venv/bin/python - <<'PYTHON'
import numpy as np
import shapely
from shapely import LineString, frechet_distance, hausdorff_distance

print(f"shapely {shapely.__version__}, GEOS {shapely.geos_version_string}\n")
wall, split = LineString([(0, 0), (10, 0)]), LineString([(0, 0), (5, 0), (10, 0)])
same = frechet_distance(wall, split)
print(f"a wall of length 10 and itself with a vertex in the middle (equal as sets: {wall.equals(split)})")
print(f"  Frechet distance {same}, with densify=0.01: {frechet_distance(wall, split, densify=0.01):.3f}, true 0\n")

truth = LineString([(0, 0), (10, 0)])
off = LineString([(0, 1), (10, 1)])
fine = LineString(np.column_stack([np.linspace(0, 10, 101), np.full(101, 0.01)]))
good, bad = frechet_distance(truth, fine), frechet_distance(truth, off)
print(f"the wall and a line 0.01 above it, of 101 points: {good:.3f}; a line 1 above it, of 2 points: {bad:.3f}\n")

across = LineString([(0, 0), (1, 0), (1, 1), (0, 1)])
upwards = LineString([(0, 0), (0, 1), (1, 1), (1, 0)])
points = [line.interpolate(np.linspace(0, 1, 3001), normalized=True) for line in (across, upwards)]
true = max(shapely.distance(points[0], upwards).max(), shapely.distance(points[1], across).max())
zero = hausdorff_distance(across, upwards)
print("the open curves (0,0) (1,0) (1,1) (0,1) and (0,0) (0,1) (1,1) (1,0)")
dense = hausdorff_distance(across, upwards, densify=0.01)
print(f"  Hausdorff distance {zero}, with densify=0.01: {dense:.3f}, true {true:.3f}")

assert wall.equals(split) and same == 5.0, "changed: Frechet"
assert good > bad, "changed: Frechet"
assert not across.equals(upwards) and zero == 0.0 and abs(true - 0.5) < 1e-9, "changed: Hausdorff"
print("\nstill so: both distances are those of the vertices")
PYTHON
