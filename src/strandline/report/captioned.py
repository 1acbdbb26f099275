"""A figure of a report with its place and its caption."""

from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

__all__ = ["Captioned", "whole"]


@dataclass(frozen=True, eq=False)
class Captioned:
    """A figure, the name of its file, the section of the report it belongs to, and what it shows."""

    name: str
    section: str
    caption: str
    figure: Figure


def whole(figure: Any) -> Figure:
    """Return a drawing that fills a whole figure as that figure."""
    assert isinstance(figure, Figure)
    return figure
