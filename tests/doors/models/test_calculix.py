"""The shipped study of a gel membrane in CalculiX: the deck against theory, and a failure.

Skipped where CalculiX is not installed (Debian: calculix-ccx).
"""

import shutil
from pathlib import Path

import pytest

from strandline.runs import RunRequest, attempt
from strandline.studies import load_study

pytestmark = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")

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
