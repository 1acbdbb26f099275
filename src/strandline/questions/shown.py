"""Answers as a notebook shows them: a sentence and a table, and their figures by name."""

import html
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from strandline.report.figure_files import Captioned
from strandline.typeset import html_table, html_text, unit_text

__all__ = ["figures_of", "html_answer", "input_label"]


def figures_of(drawn: Iterable[Captioned]) -> dict[str, Figure]:
    """Return figures by name."""
    return {one.name: one.figure for one in drawn}


def html_answer(sentence: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a sentence over a table; the cells are text."""
    escaped = ([html.escape(cell) for cell in row] for row in rows)
    return f"<p>{html.escape(sentence)}</p>{html_table(head, escaped)}"


def input_label(name: str, item: Mapping[str, Any]) -> str:
    """Return an input's label with its unit."""
    unit, label = unit_text(item.get("unit") or ""), item.get("label") or html_text(name)
    return f"{label} [{unit}]" if unit else str(label)
