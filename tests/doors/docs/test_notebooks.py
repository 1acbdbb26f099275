"""The notebooks are run from top to bottom, and find what they were made to find."""

import json
import re
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[3] / "docs" / "notebooks"
FOUND = {"own-simulator": {"E": 400.0}, "picture-to-posterior": {"gamma": 72.4, "b": 1.3}, "what-next": {"E": 400.0}}
"""True values of inputs, by notebook."""
SLOW = [pytest.param(name, marks=pytest.mark.long) for name in ("picture-to-posterior", "what-next")]


def run(name: str, folder: Path) -> Any:
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OMP_NUM_THREADS", "1")
        patch.delenv("MPLBACKEND", raising=False)
        NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(folder)}}).execute()
    return notebook


def shown(notebook: Any) -> list[dict[str, Any]]:
    """Return what the cells show, by type."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    return [output["data"] for output in outputs if "data" in output]


def moments(line: str, name: str) -> tuple[float, float]:
    """Return mean and standard deviation of an input in what a calibration shows."""
    found = re.search(rf"\b{name} = ([-\d.]+) ± ([\d.]+)", line.replace("\u00a0", " "))
    assert found, line
    return float(found[1]), float(found[2])


@pytest.mark.smoke
def test_every_notebook_is_known_and_kept_without_outputs() -> None:
    assert {path.stem for path in NOTEBOOKS.glob("*.ipynb")} == set(FOUND)
    for path in NOTEBOOKS.glob("*.ipynb"):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        assert all(not cell.get("outputs") and cell.get("execution_count") is None for cell in cells)
    assert moments("<Calibration E = 412 ± 3 Pa, q = 0.25 ± 0.01 Pa; 32 of 32 runs ok>", "E") == (412.0, 3.0)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", ["own-simulator", *SLOW])
def test_a_notebook_finds_the_truth_and_shows_figures(name: str, tmp_path: Path) -> None:
    seen = shown(run(name, tmp_path))
    (line,) = (one["text/plain"] for one in seen if re.match("<(Calibration|Outcome)", one["text/plain"]))
    for inputs, truth in FOUND[name].items():
        mean, sd = moments(line, inputs)
        assert abs(mean - truth) < 2.5 * sd
        assert np.isfinite(sd)
    assert any("image/png" in one for one in seen)
    assert any("text/html" in one for one in seen)
