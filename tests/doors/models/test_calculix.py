"""The shipped study of a gel membrane in CalculiX: the deck against theory, a failure, and the calibration.

Skipped where CalculiX is not installed (Debian: calculix-ccx).
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from strandline.cli import main
from strandline.runs import RunRecord, RunRequest, attempt
from strandline.studies import load_study

pytestmark = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")

EXAMPLE = Path(__file__).parents[3] / "examples" / "calculix"
TRUTH = {"mu": 22.0, "stiffening": 0.25, "p": 2.04}
RADIUS, THICKNESS, BULK_OVER_SHEAR = 10.0, 1.0, 50.0


@pytest.fixture
def study(tmp_path: Path) -> Path:
    ignored = shutil.ignore_patterns("*.sqlite", "*.lock", "figures", "runs", "*.nc", "*.json", "*.html")
    return Path(shutil.copytree(EXAMPLE, tmp_path / "calculix", ignore=ignored))


def run(study: Path, workdir: Path, **inputs: float) -> RunRecord:
    workdir.mkdir()
    return attempt(load_study(study).model, RunRequest("run", inputs), workdir)


def rise(record: RunRecord, condition: str) -> float:
    """Return how far the middle has moved."""
    return float(record.interfaces[condition].points[0, 1] - THICKNESS)


def test_a_light_load_bends_it_like_a_clamped_plate(study: Path, tmp_path: Path) -> None:
    """Kirchhoff's plate, w = p R⁴ / 64 D (Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells, §17)."""
    nu = (3 * BULK_OVER_SHEAR - 2) / (2 * (3 * BULK_OVER_SHEAR + 1))
    stiffness = 2 * 0.02 * (1 + nu) * THICKNESS**3 / (12 * (1 - nu**2))  # N mm, of a shear modulus of 20 kPa
    record = run(study, tmp_path / "run", mu=20.0, stiffening=0.0, p=0.002)
    assert record.ok, record.message
    for condition, load in (("half", 1e-6), ("full", 2e-6)):
        assert rise(record, condition) == pytest.approx(load * RADIUS**4 / (64 * stiffness), rel=0.04)


def test_only_the_ratio_of_pressure_and_stiffness_matters(study: Path, tmp_path: Path) -> None:
    one = run(study, tmp_path / "one", mu=20.0, stiffening=0.25, p=2.0)
    twice = run(study, tmp_path / "twice", mu=40.0, stiffening=0.25, p=4.0)
    stiffer = run(study, tmp_path / "stiffer", mu=20.0, stiffening=0.35, p=2.0)
    for condition in ("half", "full"):
        np.testing.assert_allclose(
            one.interfaces[condition].points, twice.interfaces[condition].points, atol=2e-5 * RADIUS
        )
        assert rise(one, condition) > rise(stiffer, condition) + 0.005


def test_beyond_its_limit_point_the_run_fails_and_says_how_the_log_ends(study: Path, tmp_path: Path) -> None:
    """A neo-Hookean membrane has a largest pressure; the first step is solved, the second one is not."""
    record = run(study, tmp_path / "run", mu=10.0, stiffening=0.0, p=2.0)
    assert (record.state, record.failure_kind) == ("failed", "exit_code")
    assert not record.interfaces
    assert "increment size smaller than minimum" in f"{record.message}{record.log}"


@pytest.mark.long
def test_the_study_recovers_the_truth(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["run", str(study), "--quiet"])
    summary = json.loads((study / "summary.json").read_text())
    for name, true in TRUTH.items():
        item = summary["inputs"][name]
        assert abs(item["mean"] - true) < 2 * item["sd"], f"{name}: {item['mean']:.4g} ± {item['sd']:.2g}, true {true}"
    assert summary["inputs"]["mu"]["sd"] < 0.25 * (30 - 16) / np.sqrt(12)
    assert not any("DO NOT TRUST" in warning for warning in summary["warnings"])
    assert (study / "report.html").exists()
