"""Figures and axes that a notebook shows by themselves, although they are made without pyplot."""

import io

from matplotlib.axes import Axes
from matplotlib.figure import Figure

__all__ = ["ShownAxes", "ShownFigure", "png_of"]

DOTS_PER_INCH = 150


def png_of(figure: Figure) -> bytes:
    """Return a figure as PNG."""
    with io.BytesIO() as file:
        figure.savefig(file, format="png", dpi=DOTS_PER_INCH)
        return file.getvalue()


class ShownFigure(Figure):
    """A figure that a notebook shows below the cell whose last line returns it."""

    def _repr_png_(self) -> bytes:
        return png_of(self)


class ShownAxes(Axes):
    """Axes that a notebook shows, with their whole figure, below the cell whose last line returns them."""

    def _repr_png_(self) -> bytes:
        return png_of(self.figure.figure)
