"""The shipped study of a gel membrane in CalculiX: the deck against theory, and a failure.

Skipped where CalculiX is not installed (Debian: calculix-ccx).
"""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from strandline.runs import RunRequest, attempt
from strandline.studies import load_study

pytestmark = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")

INSIDE_OUT = Path(__file__).parents[3] / "examples" / "calculix_inside_out.py"
EXAMPLE = Path(__file__).parents[3] / "examples" / "calculix"
RADIUS, THICKNESS, BULK_OVER_SHEAR = 10.0, 1.0, 50.0


@pytest.fixture
def study(tmp_path):
    ignored = shutil.ignore_patterns("*.sqlite", "*.lock", "figures", "runs", "*.nc", "*.json", "*.html")
    return Path(shutil.copytree(EXAMPLE, tmp_path / "calculix", ignore=ignored))


def run(study, mu, p):
    workdir = study.parent / "run"
    workdir.mkdir()
    return attempt(load_study(study).model, RunRequest("run", {"mu": mu, "stiffening": 0.0, "p": p}), workdir)


def test_a_light_load_bends_it_like_a_clamped_plate(study):
    """Kirchhoff's plate, w = p R⁴ / 64 D (Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells, §17)."""
    nu = (3 * BULK_OVER_SHEAR - 2) / (2 * (3 * BULK_OVER_SHEAR + 1))
    stiffness = 2 * 0.02 * (1 + nu) * THICKNESS**3 / (12 * (1 - nu**2))  # N mm, of a shear modulus of 20 kPa
    record = run(study, mu=20.0, p=0.002)
    assert record.ok, record.message
    for condition, load in (("half", 1e-6), ("full", 2e-6)):
        rise = float(record.interfaces[condition].points[0, 1] - THICKNESS)
        assert rise == pytest.approx(load * RADIUS**4 / (64 * stiffness), rel=0.04)


def test_beyond_its_limit_point_the_run_fails_and_says_how_the_log_ends(study):
    """A neo-Hookean membrane has a largest pressure; the first step is solved, the second one is not."""
    record = run(study, mu=10.0, p=2.0)
    assert (record.state, record.failure_kind) == ("failed", "exit_code")
    assert not record.interfaces
    assert "increment size smaller than minimum" in f"{record.message}{record.log}"


BLOCK = """*NODE, NSET=NALL
1,0,0,0
2,1,0,0
3,1,1,0
4,0,1,0
5,0,0,1
6,1,0,1
7,1,1,1
8,0,1,1
*ELEMENT, TYPE=C3D8, ELSET=EALL
1,1,2,3,4,5,6,7,8
*NSET, NSET=FOOT
1,2,3,4
*NSET, NSET=TOP
5,6,7,8
*MATERIAL, NAME=M
*ELASTIC
1000.,0.3
*SOLID SECTION, ELSET=EALL, MATERIAL=M
*BOUNDARY
FOOT,1,3
*STEP, NLGEOM
*STATIC
1.,1.
*CLOAD
TOP,3,{load}
*NODE PRINT, NSET=NALL
U
*END STEP
"""


def test_the_second_command_refuses_a_block_pushed_through_its_own_foot(tmp_path):
    ends = []
    for load in (-30.0, -100.0, -1800.0):
        (tmp_path / "block.inp").write_text(BLOCK.format(load=load))
        solved = subprocess.run(["ccx", "-i", "block"], cwd=tmp_path, capture_output=True, text=True, check=True)
        assert "Job finished" in solved.stdout
        post = subprocess.run([sys.executable, INSIDE_OUT], cwd=tmp_path, capture_output=True, text=True, check=False)
        ends.append(post.stderr.strip())
    assert ends == ["", "element 1 is inside out", "element 1 is inside out"]
    np.testing.assert_allclose(np.loadtxt(tmp_path / "edge.csv", delimiter=",", skiprows=1)[:, 1], 0.864, atol=1e-3)
