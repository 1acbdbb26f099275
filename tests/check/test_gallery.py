"""The scripts of the gallery: enough of them, short, each with a title, a sentence and a figure."""

import ast
from pathlib import Path

import pytest

GALLERY = Path(__file__).parents[2] / "docs" / "gallery"
SCRIPTS = sorted(GALLERY.glob("*/plot_*.py"))
LINES = 30


def test_there_are_twenty() -> None:
    assert len(SCRIPTS) >= 20


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_is_short_and_ends_with_its_figure(path: Path) -> None:
    text = path.read_text("utf-8")
    assert len(text.splitlines()) <= LINES
    tree = ast.parse(text)
    title, rule, _, *sentences = (ast.get_docstring(tree) or "").splitlines()
    assert len(rule) >= len(title)
    assert " ".join(sentences).endswith(".")
    assert isinstance(tree.body[-1], ast.Expr), "the last line returns the figure"
