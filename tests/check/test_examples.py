"""The README's example is that of the examples, and their models are what they say."""

import ast
import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"


def module_of(path):
    spec = importlib.util.spec_from_file_location(f"example_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def readme_example():
    """Return the README's Python block."""
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    return block


def test_the_readme_example_is_the_core_of_the_biofilm_example():
    example = {ast.dump(node) for node in ast.walk(ast.parse((EXAMPLES / "biofilm.py").read_text("utf-8")))}
    text = readme_example()
    guard = next(node for node in ast.parse(text).body if isinstance(node, ast.If))
    statements = [node for node in ast.parse(text).body if not isinstance(node, ast.If)] + guard.body
    assert [ast.unparse(node) for node in statements if ast.dump(node) not in example] == []
    assert len([line for line in text.splitlines() if line.strip()]) <= 15


@pytest.mark.parametrize("ratio", [1e-3, 5.0])
def test_the_beam_of_the_command_example_is_an_elastica(ratio):
    states = np.array(module_of(EXAMPLES / "command" / "beam.py").axis(ratio, 1.0, 1.0, 40))
    s = np.linspace(0.0, 1.0, 41)

    def along(t, y):
        return np.stack([y[1], -ratio * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def at_ends(a, b):
        return np.array([a[0], b[1], a[2], a[3]])

    solved = solve_bvp(along, at_ends, s, np.stack([0.3 * s, 0.3 + 0 * s, s, 0 * s]), tol=1e-9, max_nodes=10_000)
    np.testing.assert_allclose(states[:, :2], solved.sol(s)[2:].T, atol=1e-6)


def test_a_stiff_strip_of_the_python_example_is_a_linear_beam_and_a_soft_one_in_balance(tmp_path):
    """The end of a cantilever under its own weight sinks by w L⁴ / 8 B; a soft one is integrated from its free end."""
    overhang = module_of(EXAMPLES / "strip" / "strip.py").overhang
    for tilt in (0.0, 1.0):
        points = overhang({"B": 1e5, "w": 1e-3, "L": 60.0, "tilt": tilt}, tmp_path).points
        slope = np.radians(tilt)
        sunk = -60 * np.sin(slope) - 1e-3 * 60**4 / 8e5 * np.cos(slope) ** 2
        assert points[-1, 1] == pytest.approx(sunk, rel=1e-4)
    B, w, length = 40.0, 7.85e-4, 60.0
    points = overhang({"B": B, "w": w, "L": length, "tilt": 1.0}, tmp_path).points
    end = points[-1] - points[-2]

    def along(t, y):
        return [y[1], -w / B * t * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]

    start = [np.arctan2(-end[1], end[0]), 0.0, 0.0, 0.0]
    solved = solve_ivp(along, (0.0, length), start, rtol=1e-9, atol=1e-12).y[:, -1]
    assert np.degrees(solved[0]) == pytest.approx(1.0, abs=0.05)
    np.testing.assert_allclose(solved[2:], points[-1, :2] * [1, -1], atol=0.03)
