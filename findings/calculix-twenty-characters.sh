#!/usr/bin/env bash
# EXPECTED: CalculiX reads every number of its free, comma-separated input in full, or stops with an error.
# HAPPENS:  it looks at the first 20 characters of a number only. What is cut off first is the exponent:
#           3.141592653589793e-05 (21 characters) is read as 3.141592653589793, with exit status 0 and no warning.
#           numpy.savetxt's own format (%.18e) puts exactly 20 characters before the "e" of a positive number, so every
#           positive coordinate of a node table loses its exponent: 4e-3, 5e-4, 2e-4 becomes 4, 5, 2 - another shape,
#           not only another unit. (22 characters, as in %.16e, end inside the exponent: that one is an error.)
# VERSION:  CalculiX CrunchiX 2.20 (Debian calculix-ccx), numpy 2.4.6.
# MATTERS:  Moduli drawn from a prior have as many digits as Python prints. In mm, N and MPa a gel or biofilm of
#           10-100 Pa is a number like 3.1e-05, and two in three of them have 21 characters in Python: these runs
#           are computed 100000 times too stiff and end well, beside runs that are right or stop with an error.
# NEEDS:    ccx. Exits 1 once the behaviour changes.
set -euo pipefail
command -v ccx >/dev/null || { echo "missing: ccx (Debian package calculix-ccx)"; exit 3; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --disable-pip-version-check numpy==2.4.6
cd "$work"
OMP_NUM_THREADS=1 venv/bin/python - <<'PYTHON'
import io
import re
import subprocess
from pathlib import Path

import numpy as np

version = subprocess.run(["ccx", "-v"], capture_output=True, text=True).stdout.split()[-1]
print(f"CalculiX {version}, numpy {np.__version__}")

LENGTH, WIDTH, HEIGHT = 4e-3, 5e-4, 2e-4  # a bar of four bricks along x, in metres
STIFF, FORCE = 100.0, 1e-6
grid = [(x, y, z) for x in np.linspace(0, LENGTH, 5) for y in (0, WIDTH) for z in (0, HEIGHT)]
BRICKS = "".join(f"{e + 1}," + ",".join(str(4 * e + n) for n in (1, 5, 7, 3, 2, 6, 8, 4)) + "\n" for e in range(4))


def run(name, form, modulus):
    """Pull the bar; return the exit status, the volume and the elongation as CalculiX prints them."""
    table = io.StringIO()
    nodes = np.column_stack([np.arange(1, 21), np.array(grid)])
    np.savetxt(table, nodes, delimiter=",", fmt=["%d", form, form, form])
    ends = "".join(f"{n},1,{FORCE / 4!r}\n" for n in range(17, 21))
    Path(f"{name}.inp").write_text(
        f"*NODE,NSET=ALL\n{table.getvalue()}*ELEMENT,TYPE=C3D8,ELSET=BAR\n{BRICKS}"
        f"*MATERIAL,NAME=GEL\n*ELASTIC\n{modulus},0.\n*SOLID SECTION,ELSET=BAR,MATERIAL=GEL\n"
        "*BOUNDARY\n1,1,3\n2,1,3\n3,1,3\n4,1,3\n*STEP\n*STATIC\n*CLOAD\n" + ends +
        "*NODE PRINT,NSET=ALL\nU\n*EL PRINT,ELSET=BAR\nEVOL\n*END STEP\n"
    )
    done = subprocess.run(["ccx", "-i", name], capture_output=True, text=True, timeout=60)
    alarms = re.findall(r"\*(?:ERROR|WARNING).*", done.stdout)
    rows = [line.split() for line in Path(f"{name}.dat").read_text().splitlines()] if done.returncode == 0 else []
    numbers = [[float(word) for word in row] for row in rows if row and row[0].isdigit()]
    volume = sum(row[1] for row in numbers if len(row) == 2)
    pulled = max((row[1] for row in numbers if len(row) == 4), default=float("nan"))
    return done.returncode, alarms, volume, pulled


area = WIDTH * HEIGHT
print(f"\ntrue volume {LENGTH * area:.3e}, elongation {FORCE * LENGTH / STIFF / area:.3e} (E = {STIFF:.0f})")
print(f"{'format':8} {'as written':26} exit  volume     elongation")
found = {}
for form in ("%.12e", "%.18e", "%.16e"):
    status, alarms, volume, pulled = found[form] = run("nodes", form, "100.0")
    print(f"{form:8} {form % HEIGHT:26} {status:4}  {volume:.3e}  {pulled:.3e}  {alarms[:1] or ''}")
print("\nmodulus as Python prints it")
for text in ("3.14159265358979e-05", "3.141592653589793e-05"):
    status, alarms, _, pulled = found[text] = run("gel", "%.12e", text)
    seen = FORCE * LENGTH / area / pulled
    print(f"{text:22} ({len(text)} characters): exit {status}, modulus in the answer {seen:.6g} {alarms[:1] or ''}")

status, alarms, volume, _ = found["%.12e"]
assert status == 0 and not alarms and np.isclose(volume, 4e-10, rtol=1e-5)
status, alarms, volume, _ = found["%.18e"]
assert status == 0 and not alarms and np.isclose(volume, 4 * 5 * 2, rtol=1e-5), "changed: coordinates"
draws = np.random.default_rng(0).uniform(1e-5, 1e-4, 100_000)
share = np.mean([len(repr(float(draw))) == 21 for draw in draws])
print(f"share of uniform draws from 1e-5 to 1e-4 that Python prints with 21 characters: {share:.0%}")
right, wrong = (found[text] for text in ("3.14159265358979e-05", "3.141592653589793e-05"))
assert wrong[:2] == (0, []) and np.isclose(right[3] / wrong[3], 1e5, rtol=1e-4), "changed: modulus"
print("\nstill so: exponents beyond the 20th character are lost in silence")
PYTHON
