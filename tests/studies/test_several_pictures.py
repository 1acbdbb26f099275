"""Pictures of one specimen at two loads, taken by a fixed camera: from the pictures to the posterior."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from verification.validation.rendered import Camera

import strandline as sl
from strandline.runs import InProcess
from strandline.studies import Study, load_study, run_study
from strandline.testing.studies import write_study

TRUTH = {"E": 400.0, "nu": 0.3}
RATES = {"slow": 50.0, "fast": 100.0}
PIXEL, SHAPE, ORIGIN = 0.005, (150, 300), (-60.0, 120.0)
MOVED = (1.3, -0.9)
"""What the camera is off by, pixels: shift with a standard deviation of 1.6."""


def rendered(folder: Path) -> None:
    random = np.random.default_rng(3)
    for name, rate in RATES.items():
        points = sl.Biofilm()({**TRUTH, "V_in": rate}).interface.points
        pixels = points * [1, -1] / PIXEL + ORIGIN + np.array(MOVED)
        below = [[pixels[-1, 0], SHAPE[0] + 40], [pixels[0, 0], SHAPE[0] + 40]]
        grey = 150 * Camera(light=0.0)(np.concatenate([pixels, below]), SHAPE, random)
        Image.fromarray(np.clip(np.round(grey), 0, 255).astype(np.uint8)).save(folder / f"{name}.png")
        clicked = pixels[np.linspace(0, len(pixels) - 1, 12).round().astype(int)]
        np.save(folder / f"{name}.npy", clicked + random.standard_normal(clicked.shape))


def study(folder: Path, *, shared: bool) -> Study:
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
        )
    )


def test_each_condition_has_its_picture(tmp_path: Path) -> None:
    found = study(tmp_path / "s", shared=True)
    assert {name: one.picture.name for name, one in found.pictures.items()} == {"slow": "slow.png", "fast": "fast.png"}
    middle = {name: one.points[:, 0].mean() for name, one in found.observed.items()}
    assert middle["fast"] > middle["slow"] + PIXEL  # the faster flow bends it further


@pytest.mark.long
@pytest.mark.usefixtures("without_report")
def test_a_fixed_camera_makes_the_posterior_narrower(tmp_path: Path) -> None:
    found = {}
    for shared in (True, False):
        result = run_study(study(tmp_path / f"{shared}", shared=shared), executor=InProcess())
        found[shared] = result.summary["inputs"]
        assert not result.summary["misfit"]["flagged"]
        for name, true in TRUTH.items():
            assert abs(found[shared][name]["mean"] - true) < 2.5 * found[shared][name]["sd"]
    assert found[True]["E"]["sd"] < 0.9 * found[False]["E"]["sd"]
