#!/usr/bin/env bash
# EXPECTED: an ImageJ .roi file with sub-pixel points, written by roifile, has the same points when read-roi reads it.
# HAPPENS:  read-roi returns whole pixels, without a warning. A .roi file holds each point twice, as rounded integers
#           and as floats; a bit of the options says that the floats count. read-roi compares the whole options with
#           that bit. roifile sets two more bits (labels of overlays), so read-roi takes the integers.
#           With that bit alone, the same points are read exactly.
# VERSION:  roifile 2026.2.10 (writes), read-roi 1.6.0 (reads).
# MATTERS:  Outlines from a segmentation are sub-pixel for a reason. Rounded, a small drop has flat sides and corners;
#           its curvature and area, and the noise that one would estimate from the points, are those of the grid.
# Exits 1 once the behaviour changes.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --disable-pip-version-check roifile==2026.2.10 read-roi==1.6.0 numpy==2.4.6
cd "$work"
venv/bin/python - <<'PYTHON'
from importlib.metadata import version

import numpy as np
import read_roi
import roifile

print(f"roifile {version('roifile')}, read-roi {version('read-roi')}")
angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
drop = 10 + 3.4 * np.column_stack([np.cos(angle), np.sin(angle)])


def area(p):
    return 0.5 * abs(np.sum(p[:, 0] * np.roll(p[:, 1], -1) - np.roll(p[:, 0], -1) * p[:, 1]))


def described(name, p):
    radius = np.hypot(*(p - 10).T)
    print(f"{name:34} first points {p[:3].astype(float).round(3).tolist()}")
    print(f"{'':34} area {area(p):.3f}, radius {radius.min():.3f} to {radius.max():.3f}")


def as_read(file):
    (roi,) = read_roi.read_roi_file(file).values()
    return np.column_stack([roi["x"], roi["y"]])


roi = roifile.ImagejRoi.frompoints(drop)
roi.tofile("drop.roi")
options = roi.options
again, other = roifile.ImagejRoi.fromfile("drop.roi").coordinates(), as_read("drop.roi")
roi.options = roifile.ROI_OPTIONS.SUB_PIXEL_RESOLUTION
roi.tofile("alone.roi")
alone = as_read("alone.roi")
print(f"options written by roifile: {int(options)} = {options!r}; the sub-pixel bit is {int(roi.options)}\n")
described("written", drop)
described("read by roifile", again)
described("read by read-roi", other)
described("read by read-roi, that bit alone", alone)
off = np.abs(other - drop).max()
print(f"\nlargest shift of a coordinate: {off:.3f} pixels; area {100 * (area(other) / area(drop) - 1):+.1f} %")

assert np.allclose(again, drop, atol=1e-5) and np.allclose(alone, drop, atol=1e-5)
assert off > 0.3 and np.array_equal(other, np.round(other)), "changed: read-roi keeps sub-pixel points"
print("still so: read-roi rounds what roifile wrote")
PYTHON
