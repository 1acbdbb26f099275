"""The page "Extend strandline": its examples are one file, pass the conformance suites, and make a study."""

import importlib
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.special import ndtr

from strandline.imaging import PictureReading, PixelSize
from strandline.models.biofilm.model import Biofilm
from strandline.readers import Reading
from strandline.studies import load_study, run_study
from strandline.testing import executors
from strandline.testing.studies import write_study

PAGE = (Path(__file__).parents[3] / "docs" / "how-to" / "extend.md").read_text("utf-8")
(STUDY,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def doors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    source = "\n\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL))
    (tmp_path / "my_doors.py").write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    yield importlib.import_module("my_doors")
    sys.modules.pop("my_doors")


@pytest.mark.smoke
def test_its_entries_pass_the_suites(doors: ModuleType, tmp_path: Path) -> None:
    arch = doors.Arch()
    np.savetxt(tmp_path / "seen.pts", arch({"height": 0.2}, Path()).points, header="x y", comments="")
    grey = np.random.default_rng(1).integers(0, 4096, (30, 40))
    write_raw(tmp_path / "seen.raw", grey)
    picture = PictureReading(pixel=PixelSize(0.008, 0.008, source="the test"), reader="my_doors:read_raw")
    given = {
        "discrepancies": [doors.Hausdorff()],
        "priors": [doors.Exponential(0.3)],
        "noise": [doors.LaplaceNoise(0.01)],
        "simulators": [arch, {"height": 0.25}],
        "kernels": [doors.MATERN72],
        "surrogates": [doors.Quadratic],
        "criteria": [doors.at_random],
        "edges": [doors.Steepest()],
        "pictures": [tmp_path / "seen.raw", picture],
        "readers": [tmp_path / "seen.pts", Reading("seen.pts", "mm", reader="my_doors:read_points")],
    }
    for suite, arguments in given.items():
        for check in importlib.import_module(f"strandline.testing.{suite}").CHECKS.values():
            check(*arguments)
    for check in executors.CHECKS.values():
        check(doors.Patient(), workers=1)


def write_raw(path: Path, grey: np.ndarray) -> None:
    path.write_bytes(np.array(grey.shape, "<u2").tobytes() + np.round(grey).astype("<u2").tobytes())


def test_its_material_law_bends_less_than_neo_hookean_and_has_exact_sensitivities(doors: ModuleType) -> None:
    inputs = {"E": 300.0, "nu": 0.4, "V_in": 100.0}
    neo = Biofilm(mesh="coarse", material="neo_hookean")(inputs).diagnostics["max_displacement"]
    gent = Biofilm(mesh="coarse", material="my_doors:Gent", sensitivities=True)
    stiffer, hardly = (gent(inputs | {"slack": slack}) for slack in (0.5, 1e6))
    assert stiffer.diagnostics["max_displacement"] < 0.99 * neo
    np.testing.assert_allclose(hardly.diagnostics["max_displacement"], neo, rtol=1e-5)
    apart = [gent(inputs | {"slack": slack}).interface.points for slack in (0.51, 0.49)]
    slope = (apart[0] - apart[1]) / 0.02
    np.testing.assert_allclose(stiffer.sensitivities[""]["slack"], slope, atol=1e-2 * np.abs(slope).max())


def test_its_study_runs_and_its_surrogate_makes_another(doors: ModuleType, tmp_path: Path) -> None:
    with_fit = STUDY.replace('kernel: "my_doors:MATERN72"', 'fit: "my_doors:Quadratic"')
    assert with_fit != STUDY
    for study in (f"{STUDY}report: none\n", with_fit):
        (tmp_path / "study.yaml").write_text(f"{study}draft: true\n", encoding="utf-8")
        posterior = run_study(load_study(tmp_path)).calibration.posterior
        assert abs(posterior.mean[0] - 0.25) < 3 * posterior.sd[0]
        assert (tmp_path / "runs.txt").read_text() == "24 runs\n"
    assert posterior.sd[0] == pytest.approx(0.01, rel=0.2)
    found = json.loads((tmp_path / "summary.json").read_text("utf-8"))["surrogate"]
    assert (found["n_train"], found["hyperparameters"], found["optimiser"]) == (24, None, None)
    report = (tmp_path / "report.html").read_text("utf-8")
    said = [words in report for words in ("Leave-a-tenth-out", "Leave-one-out", "my_doors:Quadratic</td>")]
    assert said == [True, False, True]


def test_its_picture_format_and_edge_method_find_an_edge(doors: ModuleType, tmp_path: Path) -> None:
    """The edge of the example lies where the blurred step of the picture does, as `erf` finds it."""
    x, y = np.meshgrid(np.arange(200.0), np.arange(100.0))
    grey = 900 + 600 * ndtr((y - 60 + 20 * np.sin(np.pi * x / 200)) / 1.5)
    grey += 8 * np.random.default_rng(1).standard_normal(grey.shape)
    write_raw(tmp_path / "seen.raw", grey)
    image = {"file": "seen.raw", "reader": "my_doors:read_raw", "pixel": {"size": 8, "unit": "um"}, "solid": "bright"}
    image |= {"frame": {"origin": [0, 60]}, "path": [[3, 60], [50, 46], [100, 40], [150, 46], [196, 60]]}
    found = []
    for edge in ("erf", "my_doors:Steepest", {"method": "my_doors:Steepest", "options": {"reach": 5.5}}):
        write_study(tmp_path, observation={"image": {**image, "edge": edge}}, noise={"sd": "image", "unit": "um"})
        found.append(load_study(tmp_path).pictures[""].edge)
    reference, whole, short = found
    assert (whole.method, short.method) == (doors.Steepest(), doors.Steepest(reach=5.5))
    x, y = reference.points[np.argsort(reference.points[:, 0])].T
    for one in (whole, short):
        off = one.points[:, 1] - np.interp(one.points[:, 0], x, y)
        assert abs(off.mean()) < 0.1
        assert off.std() < 0.3
        assert one.errors.offset >= 0.2 * 0.008
