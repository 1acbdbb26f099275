"""Offsets along normals: a surrogate against the true model, and several models of the same data."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from strandline.report.plots import style
from strandline.report.plots.style import axes_or_new, below, figure_or_new, labelled, legend_under, panel_grid, styled
from strandline.typeset import figure_text, unit_text

MARGIN = 0.03
"""Space on both sides of a histogram, as a share of its width."""


@dataclass(frozen=True, eq=False)
class OffsetBand:
    """Interfaces as offsets along the normals of their pointwise median: 5, 50 and 95 % quantiles at places along it,
    and the offsets of the observed points; all in mm.
    """

    arc_length: Float[np.ndarray, " point"]
    low: Float[np.ndarray, " point"]
    median: Float[np.ndarray, " point"]
    high: Float[np.ndarray, " point"]
    observed_arc_length: Float[np.ndarray, " observed"]
    observed: Float[np.ndarray, " observed"]


def plot_check(
    true: Float[np.ndarray, " draw"],
    surrogate: Float[np.ndarray, " draw"],
    bands: Mapping[str, OffsetBand | None],
    *,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw true against surrogate log-likelihoods and, for each condition, `plot_offsets`.

    True ones are not finite if the run failed; a band is None if there is none to draw.
    """
    with styled():
        figure = figure_or_new(figure, (style.DOUBLE, 3.6 if len(bands) < 2 else 3.0))
        first, *others = figure.subplots(1, 1 + len(bands), squeeze=False)[0]
        _likelihoods(first, true, surrogate)
        for ax, (condition, band) in zip(others, bands.items(), strict=True):
            plot_offsets(band, ax=ax)
            ax.set_title(condition)
    return figure


def _likelihoods(ax: Axes, true: Float[np.ndarray, " draw"], surrogate: Float[np.ndarray, " draw"]) -> None:
    """Draw true against surrogate log-likelihoods, the line of agreement, and the failed runs at the bottom."""
    ok = np.isfinite(true)
    both = np.concatenate([true[ok], surrogate])
    margin = 0.06 * (float(np.ptp(both)) or 1.0)
    limits = (float(both.min()) - margin, float(both.max()) + margin)
    ax.plot(limits, limits, color=style.BLACK, linewidth=0.8, label="agreement")
    ax.plot(surrogate[ok], true[ok], "o", color=style.BLUE, markersize=3.5, alpha=0.6, label="draw of the posterior")
    if not ok.all():
        floor = np.full(np.count_nonzero(~ok), limits[0])
        label = f"failed runs: {len(floor)}"
        ax.plot(surrogate[~ok], floor, "x", color=style.GREY, markersize=6, clip_on=False, label=label)
    ax.set(xlim=limits, ylim=limits, box_aspect=1.0)
    ax.set(xlabel="log-likelihood, surrogate", ylabel="log-likelihood, true model")
    below(ax, columns=2)


def plot_offsets(band: OffsetBand | None, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw the band of the interfaces and the observation over the arc length; a note if there is no band."""
    with styled():
        ax = axes_or_new(ax, (style.SINGLE, 3.6))
        if band is None:
            ax.set_axis_off()
            ax.text(0.5, 0.5, "no band: see the note\nin check.json", ha="center", va="center", color=style.GREY)
            return ax
        order = np.argsort(band.arc_length, kind="stable")
        middle = np.interp(band.observed_arc_length, band.arc_length[order], band.median[order])
        low, high = (style.TO_MICROMETRES * (end - band.median) for end in (band.low, band.high))
        ax.fill_between(band.arc_length, low, high, color=style.SKY, alpha=0.6, linewidth=0, label="draws, 5 to 95 %")
        ax.plot(band.arc_length, 0.0 * band.median, color=style.BLACK, linewidth=0.8, label="draws, median")
        observed = style.TO_MICROMETRES * (band.observed - middle)
        ax.plot(band.observed_arc_length, observed, color=style.GREEN, linewidth=2.0, label="observed")
        ax.set(xlabel="arc length [mm]", ylabel="normal offset from the median [µm]", box_aspect=1.0)
        if legend:
            below(ax, columns=2)
    return ax


def plot_averaged(
    inputs: Mapping[str, Mapping[str, Any]], *, figure: Figure | SubFigure | None = None
) -> Figure | SubFigure:
    """Draw `plot_model_marginals` for each input, three in a row."""
    with styled():
        figure, panels = panel_grid(figure, len(inputs), 2.3)
        for ax, one in zip(panels, inputs.values(), strict=True):
            plot_model_marginals(one, ax=ax)
        legend_under(figure, labelled(panels[0]))
    return figure


def plot_model_marginals(one: Mapping[str, Any], *, ax: Axes | None = None) -> Axes:
    """Draw the histograms of an input under each model, as compare.json has it, and their average on top."""
    histogram, models = one["histogram"], one["histogram"]["models"]
    edges = np.array(histogram["edges"], float)
    with styled():
        ax = axes_or_new(ax, (style.SINGLE, 2.6))
        for (name, density), colour in zip(models.items(), np.resize(style.CYCLE, len(models)), strict=True):
            ax.stairs(density, edges, color=colour, linewidth=1.4, label=name.replace("$", r"\$"))
        ax.stairs(histogram["averaged"], edges, color=style.BLACK, linewidth=1.6, linestyle="--", label="averaged")
        around = MARGIN * (edges[-1] - edges[0])  # a step at an end would seem to be cut off
        ax.set(xlabel=axis_label(one), ylabel="density", xlim=(edges[0] - around, edges[-1] + around), ylim=(0, None))
    return ax


def axis_label(item: Mapping[str, Any]) -> str:
    """Return the label of an input with its unit, for Matplotlib."""
    unit = unit_text(item["unit"])
    return f"{figure_text(item['label'])} [{unit}]" if unit else figure_text(item["label"])


def plot_predictions(
    bands: Mapping[tuple[str, str], OffsetBand], *, figure: Figure | SubFigure | None = None
) -> Figure | SubFigure:
    """Draw the predicted interfaces with the observed one: a row for each condition, a column for each model."""
    conditions, models = (list(dict.fromkeys(key[k] for key in bands)) for k in (0, 1))
    with styled():
        figure = figure_or_new(figure, (style.DOUBLE, 3.0 * len(conditions) + 0.3))
        panels = figure.subplots(len(conditions), len(models), squeeze=False, sharey="row")
        for row, condition in zip(panels, conditions, strict=True):
            for ax, model in zip(row, models, strict=True):
                plot_offsets(bands.get((condition, model)), ax=ax, legend=False)
                ax.set_title((f"{model}, {condition}" if condition else model).replace("$", r"\$"))
                ax.set_box_aspect(None)
                ax.set_ylabel("" if ax is not row[0] else "offset from the median [µm]")
        legend_under(figure, labelled(panels[0][0]))
    return figure
