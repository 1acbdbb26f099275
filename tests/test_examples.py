"""The examples and the README's own one do what they say."""

import ast
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp

from strandline.runs import LocalProcesses
from strandline.studies import load_study, run_study

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
FIGURE = r"([-+.\de]+)"


def run(script: Path, folder: Path) -> str:
    """Run `script` in an interpreter of its own in `folder` and return what it printed."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, str(script)], cwd=folder, env=environment, capture_output=True, text=True, timeout=500
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def found(text: str, name: str) -> tuple[float, float]:
    """Return mean and sd of `name` from a line such as ``E = 404 ± 4 Pa``."""
    match = re.search(rf"^{name} = {FIGURE} ± {FIGURE}", text, re.MULTILINE)
    assert match, text
    return float(match[1]), float(match[2])


def module_of(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"example_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def exact_moments(measured: Sequence[float], unit_deflection: Sequence[float], noise: float) -> tuple[float, float]:
    """Return mean and sd of E ~ U(94, 1000) from Gaussian deflections w/E, by a fine sum."""
    E = np.linspace(94.0, 1000.0, 100_001)
    misfit = (np.asarray(measured) - np.asarray(unit_deflection) / E[:, None]) / noise
    log_likelihood = -0.5 * np.sum(misfit**2, axis=1)
    weight = np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    mean = weight @ E
    return float(mean), float(np.sqrt(weight @ (E - mean) ** 2))


def agrees(found: tuple[float, float], exact: tuple[float, float]) -> bool:
    """Tell whether a mean and a standard deviation are the exact ones within the noise of 2000 particles."""
    return abs(found[0] - exact[0]) < 0.12 * exact[1] and abs(found[1] / exact[1] - 1.0) < 0.12


@pytest.mark.long
def test_own_model_finds_the_exact_posterior(tmp_path: Path) -> None:
    script = ROOT / "examples" / "own_model.py"
    example = module_of(script)
    points = example.measured().points
    nodes = [int(np.argmin(np.abs(points[:, 0] - x))) for x in example.STATIONS]
    stiff = example.beam({"E": 1.0e6, "q": example.PRESSURE}, tmp_path).points[nodes, 1] * 1.0e6
    exact = exact_moments(points[nodes, 1], stiff, example.NOISE)
    printed = found(run(script, tmp_path), "E")
    assert agrees(printed, exact)
    assert abs(printed[0] - example.TRUE_E) < 2 * printed[1]
    planted = exact_moments(points[nodes, 1], stiff, example.NOISE * np.sqrt(2.0))  # σ² without its ½
    assert not agrees(printed, planted)


@pytest.mark.long
def test_biofilm_finds_the_truth_and_repeats_no_run(tmp_path: Path) -> None:
    script = ROOT / "examples" / "biofilm.py"
    first = run(script, tmp_path)
    assert_biofilm(first)
    assert (tmp_path / "figures" / "posterior.png").stat().st_size > 10_000
    before = (tmp_path / "ledger.sqlite").stat().st_size
    assert run(script, tmp_path) == first
    assert (tmp_path / "ledger.sqlite").stat().st_size - before < 50_000  # a session, and no 200 interfaces


@pytest.mark.long
def test_the_readme_example_runs_as_it_stands(tmp_path: Path) -> None:
    script = tmp_path / "readme.py"
    script.write_text(readme_example(), encoding="utf-8")
    assert_biofilm(run(script, tmp_path))


def test_the_readme_example_is_the_core_of_the_biofilm_example() -> None:
    example = {ast.dump(node) for node in ast.walk(ast.parse((ROOT / "examples" / "biofilm.py").read_text("utf-8")))}
    text = readme_example()
    guard = next(node for node in ast.parse(text).body if isinstance(node, ast.If))
    statements = [node for node in ast.parse(text).body if not isinstance(node, ast.If)] + guard.body
    assert len(statements) >= 8
    assert [ast.unparse(node) for node in statements if ast.dump(node) not in example] == []
    assert len([line for line in text.splitlines() if line.strip()]) <= 15


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_an_example_is_short_and_guarded(path: Path) -> None:
    text = path.read_text("utf-8")
    assert len(text.splitlines()) <= 80
    assert 'if __name__ == "__main__":' in text


def readme_example() -> str:
    """Return the README's Python block."""
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    return str(block)


def assert_biofilm(printed: str) -> None:
    for name, truth, widest in (("E", 400.0, 60.0), ("nu", 0.3, 0.2)):
        mean, sd = found(printed, name)
        assert abs(mean - truth) < 2 * sd
        assert 0 < sd < widest


@pytest.fixture(scope="module")
def command_example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("example") / "command"
    shutil.copytree(ROOT / "examples" / "command", folder)
    return folder


def test_the_command_example_finds_the_truth(command_example: Path) -> None:
    study = load_study(command_example)
    found = run_study(study, executor=LocalProcesses(workers=1)).summary["inputs"]["E"]
    assert abs(found["mean"] - 400.0) < 3 * found["sd"] < 100.0
    files = [path for path in (ROOT / "examples" / "command").iterdir() if path.is_file()]  # not __pycache__
    assert sum(len(path.read_text("utf-8").splitlines()) for path in files) <= 80


@pytest.mark.parametrize("ratio", [1e-3, 0.5, 5.0])
def test_the_beam_of_the_command_example_is_an_elastica(ratio: float) -> None:
    states = np.array(module_of(ROOT / "examples" / "command" / "beam.py").axis(ratio, 1.0, 1.0, 40))
    s = np.linspace(0.0, 1.0, 41)
    solved = solve_bvp(
        lambda t, y: np.stack([y[1], -ratio * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]),
        lambda a, b: np.array([a[0], b[1], a[2], a[3]]),
        s,
        np.stack([0.3 * s, 0.3 + 0 * s, s, 0 * s]),
        tol=1e-9,
        max_nodes=10_000,
    )
    np.testing.assert_allclose(states[:, :2], solved.sol(s)[2:].T, atol=1e-6)


@pytest.mark.parametrize("tilt", [0.0, 1.0])
def test_a_stiff_strip_of_the_python_example_is_a_linear_beam(tilt: float, tmp_path: Path) -> None:
    """The end of a cantilever under its own weight sinks by w L⁴ / 8 B."""
    overhang = module_of(ROOT / "examples" / "strip" / "strip.py").overhang
    points = overhang({"B": 1e5, "w": 1e-3, "L": 60.0, "tilt": tilt}, tmp_path).points
    slope = np.radians(tilt)
    assert points[-1, 1] == pytest.approx(-60 * np.sin(slope) - 1e-3 * 60**4 / 8e5 * np.cos(slope) ** 2, rel=1e-4)


def test_the_strip_of_the_python_example_is_in_balance(tmp_path: Path) -> None:
    """Integrated from the free end by another method, it has the same shape."""
    B, w, length = 40.0, 7.85e-4, 60.0
    overhang = module_of(ROOT / "examples" / "strip" / "strip.py").overhang
    points = overhang({"B": B, "w": w, "L": length, "tilt": 1.0}, tmp_path).points
    end = points[-1] - points[-2]

    def slope(t: float, state: np.ndarray) -> list[float]:
        return [state[1], -w / B * t * np.cos(state[0]), np.cos(state[0]), np.sin(state[0])]

    start = np.arctan2(-end[1], end[0])
    solved = solve_ivp(slope, (0.0, length), [start, 0.0, 0.0, 0.0], rtol=1e-9, atol=1e-12).y[:, -1]
    assert np.degrees(solved[0]) == pytest.approx(1.0, abs=0.05)
    np.testing.assert_allclose(solved[2:], points[-1, :2] * [1, -1], atol=0.03)
