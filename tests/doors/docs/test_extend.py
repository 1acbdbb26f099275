"""The page "Extend strandline": its examples are one file, pass the conformance suites, and make a study."""

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from strandline.imaging import PictureReading, PixelSize
from strandline.models.biofilm.model import Biofilm
from strandline.readers import Reading
from strandline.studies import load_study, run_study
from strandline.testing import executors

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
    grey = np.random.default_rng(1).integers(0, 4096, (30, 40)).astype("<u2")
    (tmp_path / "seen.raw").write_bytes(np.array(grey.shape, "<u2").tobytes() + grey.tobytes())
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
    for study in (f"{STUDY}report: none\n", with_fit):
        (tmp_path / "study.yaml").write_text(f"{study}draft: true\n", encoding="utf-8")
        posterior = run_study(load_study(tmp_path)).calibration.posterior
        assert abs(posterior.mean[0] - 0.25) < 3 * posterior.sd[0]
        assert (tmp_path / "runs.txt").read_text() == "24 runs\n"
    assert posterior.sd[0] == pytest.approx(0.01, rel=0.2)
    assert "my_doors:Quadratic</td>" in (tmp_path / "report.html").read_text("utf-8")
