"""Whole studies that take minutes: examples with pictures, a fixed camera, a driver that is killed."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from verification.validation.rendered import Camera

import strandline as sl
from strandline.posterior import read
from strandline.runs import InProcess, Ledger
from strandline.studies import Study, load_study, run_study
from strandline.testing.studies import TWO_LOADS_STUDY, write_study

EXAMPLES = Path(__file__).parents[2] / "examples"
ACTIVE: dict[str, Any] = {
    **TWO_LOADS_STUDY,
    "design": {"active": {"runs": 50, "batch": 4, "check": 20}},
    "noise": {"sd": 0.05},
    "sampler": {"smc": {"particles": 400, "rejuvenation_steps": 5, "zeta": 0.5}},
}
SPECIMEN = {"E": 400.0, "nu": 0.3}
RATES = {"slow": 50.0, "fast": 100.0}
PIXEL, SHAPE, ORIGIN = 0.005, (150, 300), (-60.0, 120.0)
MOVED = (1.3, -0.9)
"""What the camera is off by, pixels: shift with a standard deviation of 1.6."""


def rendered(folder: Path) -> None:
    random = np.random.default_rng(3)
    for name, rate in RATES.items():
        points = sl.Biofilm()({**SPECIMEN, "V_in": rate}).interface.points
        pixels = points * [1, -1] / PIXEL + ORIGIN + np.array(MOVED)
        below = [[pixels[-1, 0], SHAPE[0] + 40], [pixels[0, 0], SHAPE[0] + 40]]
        grey = 150 * Camera(light=0.0)(np.concatenate([pixels, below]), SHAPE, random)
        Image.fromarray(np.clip(np.round(grey), 0, 255).astype(np.uint8)).save(folder / f"{name}.png")
        clicked = pixels[np.linspace(0, len(pixels) - 1, 12).round().astype(int)]
        np.save(folder / f"{name}.npy", clicked + random.standard_normal(clicked.shape))


def photographed(folder: Path, *, shared: bool) -> Study:
    folder.mkdir()
    rendered(folder)
    seen: list[dict[str, Any]] = [
        {
            "condition": name,
            "image": {
                "file": f"{name}.png",
                "pixel": {"size": 5, "unit": "um"},
                "frame": {"origin": list(ORIGIN)},
                "path": np.load(folder / f"{name}.npy").tolist(),
                "solid": "bright",
            },
        }
        for name in RATES
    ]
    return load_study(
        write_study(
            folder,
            model={"biofilm": {"inflow_rates": RATES}},
            fixed={},
            inputs={
                "E": {"prior": {"uniform": [150, 800]}, "unit": "Pa"},
                "nu": {"prior": {"uniform": [0, 0.48]}},
            },
            observation=seen,
            discrepancy={"normal_offset": {}},
            noise={"sd": "image", "unit": "um", "unknown": {"shift": 8, "rotation": 0.5, "shared": shared}},
            design={"active": {"runs": 40}},
            surrogate={"field": {}},
            report="none",
        )
    )


@pytest.mark.long
def test_a_fixed_camera_makes_the_posterior_narrower(tmp_path: Path) -> None:
    found = {}
    for shared in (True, False):
        result = run_study(photographed(tmp_path / f"{shared}", shared=shared), executor=InProcess())
        found[shared] = result.summary["inputs"]
        assert not result.summary["misfit"]["flagged"]
        for name, true in SPECIMEN.items():
            assert abs(found[shared][name]["mean"] - true) < 2.5 * found[shared][name]["sd"]
    assert found[True]["E"]["sd"] < 0.9 * found[False]["E"]["sd"]


@pytest.mark.long
def test_the_lengths_of_all_inputs_are_told(tmp_path: Path) -> None:
    kernel = {"log_likelihood": {"kernel": "matern32_product"}}
    folder = write_study(tmp_path / "beam", surrogate=kernel)
    outcome = run_study(load_study(folder), executor=InProcess())
    lengths = json.loads((folder / "summary.json").read_text("utf-8"))["surrogate"]["hyperparameters"]["length_scale"]
    np.testing.assert_allclose(lengths, outcome.calibration.surrogate.process.length_scale)
    assert len(lengths) == 2
    assert ", ".join(f"{length:.3g}" for length in lengths) in outcome.report.read_text("utf-8")
    assert outcome.summary["quadrature_check"]["max_mean_error_sd"] < 0.1


@pytest.mark.long
def test_the_example_finds_stiffness_and_poissons_ratio(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    folder.mkdir()
    for name in ("study.yaml", "undeformed.png", "deformed.png"):
        shutil.copy(EXAMPLES / "oct-biofilm" / name, folder)
    outcome = run_study(load_study(folder), executor=InProcess())
    posterior = outcome.calibration.posterior
    assert (np.abs(posterior.mean - [400.0, 0.3]) < 2.5 * posterior.sd).all()
    assert posterior.sd[0] < 60
    of = outcome.summary["undeformed_outline"]
    assert 1.02 < of["expected_sd"]["E"] / of["expected_sd_without"]["E"] < 2
    assert of["expected_sd"]["E"] == pytest.approx(posterior.sd[0], rel=0.4)
    assert "The undeformed outline comes from a picture" in (folder / "report.html").read_text("utf-8")


@pytest.mark.long
def test_the_example_finds_the_surface_tension(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = EXAMPLES / "pendant-drop"
    monkeypatch.syspath_prepend(str(source))
    shutil.copytree(source, tmp_path / "drop", ignore=shutil.ignore_patterns("__pycache__"))
    posterior = run_study(load_study(tmp_path / "drop"), executor=InProcess()).calibration.posterior
    z = (posterior.mean[0] - 72.4) / posterior.sd[0]
    assert abs(z) < 3
    assert 0.3 < posterior.sd[0] < 1.5


def ended_runs(folder: Path) -> int:
    study = load_study(folder)
    if not study.ledger_path.is_file():
        return 0
    with Ledger.open(study.ledger_path, model=None, read_only=True) as ledger:
        return sum(1 for _ in ledger)


@pytest.mark.long
def test_a_killed_study_goes_on_to_the_same_posterior(tmp_path: Path) -> None:
    """The driver is killed with -9 among its first runs and in a later batch; one worker."""
    whole, killed = (write_study(tmp_path / name, **ACTIVE) for name in ("whole", "killed"))
    command = [sys.executable, "-m", "strandline", "run", "--quiet"]
    subprocess.run([*command, str(whole)], check=True, capture_output=True)
    for after in (3, 9):
        driver = subprocess.Popen([*command, str(killed)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while driver.poll() is None and ended_runs(killed) < after:
            time.sleep(0.02)
        assert driver.poll() is None
        driver.send_signal(signal.SIGKILL)
        driver.wait()
    subprocess.run([*command, str(killed)], check=True, capture_output=True)
    assert read(whole / "posterior.nc").identical(read(killed / "posterior.nc"))
    one, other = (json.loads((folder / "summary.json").read_text()) for folder in (whole, killed))
    assert one["certificate"] == other["certificate"]
