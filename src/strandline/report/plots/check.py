"""A surrogate's posterior against the true model: log-likelihoods and interfaces at its draws."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from strandline.report.plots.style import (
    BLACK,
    BLUE,
    DOUBLE,
    GREEN,
    GREY,
    SINGLE,
    SKY,
    axes_or_new,
    below,
    figure_or_new,
    styled,
)

__all__ = ["OffsetBand", "plot_check", "plot_likelihoods", "plot_offsets"]

MM_TO_MICROMETRES = 1e3


@dataclass(frozen=True, eq=False)
class OffsetBand:
    """Interfaces as offsets along the normals of their pointwise median; all in mm.

    Args:
        arc_length: places along the median.
        low: 5 % quantiles there.
        median: 50 % quantiles there.
        high: 95 % quantiles there.
        observed_arc_length: places of the observed points along the median.
        observed: their offsets.
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
    """Draw `plot_likelihoods` and, for each condition, `plot_offsets`.

    Args:
        true: Log-likelihoods of the draws by the true model; not finite if the run failed.
        surrogate: Log-likelihoods of the draws by the surrogate.
        bands: Bands by condition; None if there is no band to draw.
        figure: Figure to draw in; a new one by default.
    """
    with styled():
        figure = figure_or_new(figure, (DOUBLE, 3.6 if len(bands) < 2 else 3.0))
        first, *others = figure.subplots(1, 1 + len(bands), squeeze=False)[0]
        plot_likelihoods(true, surrogate, ax=first)
        for ax, (condition, band) in zip(others, bands.items(), strict=True):
            plot_offsets(band, ax=ax)
            ax.set_title(condition)
    return figure


def plot_likelihoods(true: Float[np.ndarray, " draw"], surrogate: Float[np.ndarray, " draw"], *, ax: Axes) -> Axes:
    """Draw true against surrogate log-likelihoods, the line of agreement, and the failed runs at the bottom."""
    with styled():
        ok = np.isfinite(true)
        both = np.concatenate([true[ok], surrogate])
        margin = 0.06 * (float(np.ptp(both)) or 1.0)
        limits = (float(both.min()) - margin, float(both.max()) + margin)
        ax.plot(limits, limits, color=BLACK, linewidth=0.8, label="agreement")
        ax.plot(surrogate[ok], true[ok], "o", color=BLUE, markersize=3.5, alpha=0.6, label="draw of the posterior")
        if not ok.all():
            floor = np.full(np.count_nonzero(~ok), limits[0])
            label = f"failed runs: {len(floor)}"
            ax.plot(surrogate[~ok], floor, "x", color=GREY, markersize=6, clip_on=False, label=label)
        ax.set(xlim=limits, ylim=limits, box_aspect=1.0)
        ax.set(xlabel="log-likelihood, surrogate", ylabel="log-likelihood, true model")
        below(ax, columns=2)
    return ax


def _along(band: OffsetBand) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """Return the arc lengths of the median in ascending order, and the median there."""
    order = np.argsort(band.arc_length, kind="stable")
    return band.arc_length[order], band.median[order]


def plot_offsets(band: OffsetBand | None, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw the band of the interfaces and the observation over the arc length; a note if there is no band."""
    with styled():
        ax = axes_or_new(ax, (SINGLE, 3.6))
        if band is None:
            ax.set_axis_off()
            ax.text(0.5, 0.5, "no band: see the note\nin check.json", ha="center", va="center", color=GREY)
            return ax
        low, median, high, observed = (
            MM_TO_MICROMETRES * values
            for values in (
                band.low - band.median,
                np.zeros_like(band.median),
                band.high - band.median,
                band.observed - np.interp(band.observed_arc_length, *_along(band)),
            )
        )
        ax.fill_between(band.arc_length, low, high, color=SKY, alpha=0.6, linewidth=0, label="draws, 5 to 95 %")
        ax.plot(band.arc_length, median, color=BLACK, linewidth=0.8, label="draws, median")
        ax.plot(band.observed_arc_length, observed, color=GREEN, linewidth=2.0, label="observed")
        ax.set(xlabel="arc length [mm]", ylabel="normal offset from the median [µm]", box_aspect=1.0)
        if legend:
            below(ax, columns=2)
    return ax
