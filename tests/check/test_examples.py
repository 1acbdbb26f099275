"""The examples are short, agree with the README, and their models are what they say."""

import ast
import importlib.util
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def module_of(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"example_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def readme_example() -> str:
    """Return the README's Python block."""
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    return str(block)


def test_the_readme_example_is_the_core_of_the_biofilm_example() -> None:
    example = {ast.dump(node) for node in ast.walk(ast.parse((ROOT / "examples" / "biofilm.py").read_text("utf-8")))}
    text = readme_example()
    guard = next(node for node in ast.parse(text).body if isinstance(node, ast.If))
    statements = [node for node in ast.parse(text).body if not isinstance(node, ast.If)] + guard.body
    assert len(statements) >= 8
    assert [ast.unparse(node) for node in statements if ast.dump(node) not in example] == []
    assert len([line for line in text.splitlines() if line.strip()]) <= 15


def test_an_example_is_short_and_guarded() -> None:
    for path in EXAMPLES:
        text = path.read_text("utf-8")
        assert len(text.splitlines()) <= 80
        assert 'if __name__ == "__main__":' in text
    files = [path for path in (ROOT / "examples" / "command").iterdir() if path.is_file()]  # not __pycache__
    assert sum(len(path.read_text("utf-8").splitlines()) for path in files) <= 80
    drop = (ROOT / "examples" / "pendant-drop" / "drop.py").read_text("utf-8")
    assert len(drop.splitlines()) <= 60


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
