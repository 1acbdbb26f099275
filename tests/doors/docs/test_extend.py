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

import strandline as sl
from strandline.imaging import PictureReading, PixelSize
from strandline.models.biofilm.model import Biofilm
from strandline.readers import Reading, read_interface
from strandline.studies import load_study, run_study
from strandline.testing import (
    criteria,
    discrepancies,
    edges,
    executors,
    kernels,
    noise,
    pictures,
    priors,
    readers,
    simulators,
    surrogates,
)
from strandline.testing.studies import write_study

PAGE = (Path(__file__).parents[3] / "docs" / "how-to" / "extend.md").read_text("utf-8")


@pytest.fixture
def doors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    source = "\n\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL))
    (tmp_path / "my_doors.py").write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    yield importlib.import_module("my_doors")
    sys.modules.pop("my_doors")


def test_its_entries_pass_the_suites(doors: ModuleType) -> None:
    for check in discrepancies.CHECKS.values():
        check(doors.Hausdorff())
    for check in priors.CHECKS.values():
        check(doors.Exponential(0.3))
    for check in noise.CHECKS.values():
        check(doors.LaplaceNoise(0.01))
    for check in executors.CHECKS.values():
        check(doors.Patient(), workers=1)
    for check in simulators.CHECKS.values():
        check(doors.Arch(), {"height": 0.25})
    for check in kernels.CHECKS.values():
        check(doors.MATERN72)
    for check in surrogates.CHECKS.values():
        check(doors.Quadratic)
    for check in criteria.CHECKS.values():
        check(doors.at_random)


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


def test_its_study_runs(doors: ModuleType, tmp_path: Path, without_report: None) -> None:
    (study,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "study.yaml").write_text(study, encoding="utf-8")
    posterior = run_study(load_study(tmp_path)).calibration.posterior
    assert abs(posterior.mean[0] - 0.25) < 3 * posterior.sd[0]
    assert (tmp_path / "runs.txt").read_text() == "24 runs\n"


def test_its_edge_method_and_picture_format_pass_their_suites(doors: ModuleType, tmp_path: Path) -> None:
    for check in edges.CHECKS.values():
        check(doors.Steepest())
    grey = np.random.default_rng(1).integers(0, 4096, (30, 40))
    path = tmp_path / "seen.raw"
    path.write_bytes(np.array(grey.shape, "<u2").tobytes() + grey.astype("<u2").tobytes())
    how = PictureReading(pixel=PixelSize(0.008, 0.008, source="the test"), reader="my_doors:read_raw")
    for one in pictures.CHECKS.values():
        one(path, how)


def test_its_picture_format_and_edge_method_find_an_edge(doors: ModuleType, tmp_path: Path) -> None:
    """The edge of the example lies where the blurred step of the picture does, as `erf` finds it."""
    x, y = np.meshgrid(np.arange(200.0), np.arange(100.0))
    grey = 900 + 600 * ndtr((y - 60 + 20 * np.sin(np.pi * x / 200)) / 1.5)
    grey += 8 * np.random.default_rng(1).standard_normal(grey.shape)
    content = np.array(grey.shape, "<u2").tobytes() + np.round(grey).astype("<u2").tobytes()
    (tmp_path / "seen.raw").write_bytes(content)
    image = {
        "file": "seen.raw",
        "reader": "my_doors:read_raw",
        "pixel": {"size": 8, "unit": "um"},
        "frame": {"origin": [0, 60]},
        "path": [[3, 60], [50, 46], [100, 40], [150, 46], [196, 60]],
        "solid": "bright",
    }
    found = {}
    for edge in ("erf", "my_doors:Steepest", {"method": "my_doors:Steepest", "options": {"reach": 5.5}}):
        write_study(tmp_path, observation={"image": {**image, "edge": edge}}, noise={"sd": "image", "unit": "um"})
        found[str(edge)] = load_study(tmp_path).pictures[""].edge
    reference, whole, short = found.values()
    assert (whole.method, short.method) == (doors.Steepest(), doors.Steepest(reach=5.5))
    for one in (whole, short):
        off = one.points[:, 1] - np.interp(
            one.points[:, 0], *reference.points[:: -1 if reference.points[0, 0] > 100 else 1].T
        )
        assert abs(off.mean()) < 0.1
        assert off.std() < 0.3
        assert one.errors.offset >= 0.2 * 0.008


def test_its_surrogate_makes_a_study(doors: ModuleType, tmp_path: Path) -> None:
    (study,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    with_fit = study.replace('kernel: "my_doors:MATERN72"', 'fit: "my_doors:Quadratic"')
    assert with_fit != study
    (tmp_path / "study.yaml").write_text(with_fit, encoding="utf-8")
    outcome = run_study(load_study(tmp_path))
    posterior = outcome.calibration.posterior
    assert abs(posterior.mean[0] - 0.25) < 3 * posterior.sd[0]
    assert posterior.sd[0] == pytest.approx(0.01, rel=0.2)
    found = json.loads((tmp_path / "summary.json").read_text("utf-8"))["surrogate"]
    assert (found["n_train"], found["hyperparameters"], found["optimiser"]) == (24, None, None)
    report = (tmp_path / "report.html").read_text("utf-8")
    assert "Leave-a-tenth-out" in report
    assert "Leave-one-out" not in report
    assert "my_doors:Quadratic</td>" in report


def test_its_noise_model_is_used(doors: ModuleType) -> None:
    arch = doors.Arch()
    seen = sl.Observation(arch({"height": 0.25}, Path()), doors.LaplaceNoise(0.02))
    likelihood = sl.InterfaceLikelihood((seen,), doors.Hausdorff())
    assert likelihood(arch({"height": 0.26}, Path())) == pytest.approx(-0.5, abs=0.01)


def test_its_format_is_read(doors: ModuleType, tmp_path: Path) -> None:
    points = doors.Arch()({"height": 0.2}, Path()).points
    np.savetxt(tmp_path / "seen.pts", points, header="x y", comments="")
    how = Reading("seen.pts", "mm", reader="my_doors:read_points")
    np.testing.assert_allclose(read_interface(tmp_path / "seen.pts", how).points, points, atol=1e-12)
    for check in readers.CHECKS.values():
        check(tmp_path / "seen.pts", how)
