"""Several models of the same data: marginals of shared inputs, and predicted interfaces side by side."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from strandline.report.plots.check import OffsetBand, plot_offsets
from strandline.report.plots.style import (
    BLACK,
    CYCLE,
    DOUBLE,
    SINGLE,
    axes_or_new,
    figure_or_new,
    legend_under,
    styled,
)
from strandline.typeset import figure_text, unit_text

__all__ = ["ModelMarginals", "plot_averaged", "plot_model_marginals", "plot_predictions"]

COLUMNS = 3


@dataclass(frozen=True, eq=False)
class ModelMarginals:
    """Histograms of one input under several models, and averaged over them.

    Args:
        label: Symbol of the input.
        unit: Its unit; `1` for a pure number.
        edges: Edges of the bins, one more than there are densities.
        averaged: Model-averaged density in each bin.
        models: Densities by name of the model.
    """

    label: str
    unit: str
    edges: Float[np.ndarray, " edge"]
    averaged: Float[np.ndarray, " bin"]
    models: Mapping[str, Float[np.ndarray, " bin"]]


def plot_averaged(
    inputs: Mapping[str, ModelMarginals], *, figure: Figure | SubFigure | None = None
) -> Figure | SubFigure:
    """Draw `plot_model_marginals` for each input, three in a row."""
    columns = min(COLUMNS, len(inputs))
    rows = -(-len(inputs) // columns)
    with styled():
        figure = figure_or_new(figure, (SINGLE if columns == 1 else DOUBLE, 2.3 * rows + 0.5))
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax, one in zip(panels, inputs.values(), strict=False):
            plot_model_marginals(one, ax=ax)
        for ax in panels[len(inputs) :]:
            ax.remove()
        handles, labels = panels[0].get_legend_handles_labels()
        legend_under(figure, dict(zip(labels, handles, strict=True)))
    return figure


def plot_model_marginals(one: ModelMarginals, *, ax: Axes | None = None) -> Axes:
    """Draw the histograms of an input under each model, and the average on top."""
    with styled():
        ax = axes_or_new(ax, (SINGLE, 2.6))
        for (name, density), colour in zip(one.models.items(), np.resize(CYCLE, len(one.models)), strict=True):
            ax.stairs(density, one.edges, color=colour, linewidth=1.4, label=name.replace("$", r"\$"))
        ax.stairs(one.averaged, one.edges, color=BLACK, linewidth=1.6, linestyle="--", label="averaged")
        unit = unit_text(one.unit)
        ax.set(xlabel=figure_text(one.label) + (f" [{unit}]" if unit else ""), ylabel="density")
        ax.set(xlim=(one.edges[0], one.edges[-1]), ylim=(0, None))
    return ax


def plot_predictions(
    bands: Mapping[tuple[str, str], OffsetBand], *, figure: Figure | SubFigure | None = None
) -> Figure | SubFigure:
    """Draw the predicted interfaces with the observed one: a row for each condition, a column for each model.

    Args:
        bands: Bands by condition and model.
        figure: Figure to draw in; a new one by default.
    """
    conditions, models = (list(dict.fromkeys(key[k] for key in bands)) for k in (0, 1))
    with styled():
        figure = figure_or_new(figure, (DOUBLE, 3.0 * len(conditions) + 0.3))
        panels = figure.subplots(len(conditions), len(models), squeeze=False, sharey="row")
        for row, condition in zip(panels, conditions, strict=True):
            for ax, model in zip(row, models, strict=True):
                plot_offsets(bands.get((condition, model)), ax=ax, legend=False)
                ax.set_title((f"{model}, {condition}" if condition else model).replace("$", r"\$"))
                ax.set_box_aspect(None)
                ax.set_ylabel("" if ax is not row[0] else "offset from the median [µm]")
        handles, labels = panels[0][0].get_legend_handles_labels()
        legend_under(figure, dict(zip(labels, handles, strict=True)))
    return figure
