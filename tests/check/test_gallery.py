"""The scripts of the gallery: enough of them, short, each with a title, a sentence and a figure."""

import ast
from pathlib import Path


def test_scripts_are_short_and_end_with_their_figure() -> None:
    scripts = sorted((Path(__file__).parents[2] / "docs" / "gallery").glob("*/plot_*.py"))
    assert len(scripts) >= 20
    for path in scripts:
        text = path.read_text("utf-8")
        tree = ast.parse(text)
        title, rule, _, *sentences = (ast.get_docstring(tree) or "").splitlines()
        assert len(text.splitlines()) <= 30, path
        assert len(rule) >= len(title), path
        assert " ".join(sentences).endswith("."), path
        assert isinstance(tree.body[-1], ast.Expr), f"{path}: the last line returns the figure"
