"""What the artists of a figure hold, and a posterior to draw."""

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.posterior import Posterior

E, NU = Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", Uniform(-0.8, 0.5), symbol="ν")


def posterior_of(draws: np.ndarray, *inputs: Parameter, weights: Any = 1.0) -> Posterior:
    """Return a posterior of these draws, of equal weights unless they are given."""
    weights, zeros = np.broadcast_to(weights, len(draws)), np.zeros(len(draws))
    return Posterior(ParameterSpace(inputs), draws, np.log(weights / weights.sum()), zeros, zeros, 0.0)


def rendered(figure: Any) -> Any:
    """Draw for real, so that a layout that collapses is a warning and thereby an error."""
    root = figure if isinstance(figure, Figure) else figure.get_figure(root=True)
    root.set_dpi(60)
    FigureCanvasAgg(root).draw()
    return figure


def entries(figure: Any) -> list[str]:
    """Return the texts of the legends of a figure or of axes."""
    legends = figure.legends if hasattr(figure, "legends") else [figure.get_legend()]
    return [text.get_text() for legend in legends for text in legend.get_texts()]


def lines(ax: Any, label: str) -> list[np.ndarray]:
    return [np.asarray(line.get_xydata()) for line in ax.lines if line.get_label() == label]


def hexagon_mass(ax: Any) -> float:
    (hexagons,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
    return float(np.nansum(hexagons.get_array()))
