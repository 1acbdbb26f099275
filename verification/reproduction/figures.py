"""Figures of the reproduction: nested likelihoods (Fig. 8), errors against runs (Fig. 12), parts (Fig. 11)."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch
from matplotlib.ticker import NullLocator
from verification.reproduction.grid_posterior import GridPosterior
from verification.reproduction.nested import NestedStep

from strandline.parameters import ParameterSpace
from strandline.report.plots.style import (
    BLACK,
    CYCLE,
    DASHES,
    DOUBLE,
    GREY,
    RED,
    SINGLE,
    axes_or_new,
    below,
    figure_or_new,
    mark,
    styled,
)

__all__ = ["plot_convergence", "plot_nested_likelihoods", "plot_parts", "plot_surrogate_errors"]

_WINDOW_SDS = 5.0
_POINTS = (121, 101)
_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.9)
_COLOURS = ("#dbe9f4", "#7fb3d5", "#f0b27a", "#82c39b", "#c39bd3", "#f7dc6f")


def plot_nested_likelihoods(
    steps: Sequence[NestedStep],
    truth: GridPosterior,
    space: ParameterSpace,
    *,
    training: Float[np.ndarray, "run 2"],
    ground_truth: Float[np.ndarray, "2"] | None = None,
    columns: int = 3,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw exp(surrogate - its maximum) of each nested design around the true posterior, with the latter's contours.

    Args:
        steps: Steps from `nested_surrogates`.
        truth: True posterior under uniform priors, which is the likelihood.
        space: Space of E and ν.
        training: Inputs of the successful runs in the order of the design; each panel shows those its design uses.
        ground_truth: Inputs of the synthetic observation.
        columns: Number of panels side by side.
        figure: Figure to draw in; a new one by default.
    """
    low = np.maximum(truth.mean - _WINDOW_SDS * truth.sd, space.low)
    high = np.minimum(truth.mean + _WINDOW_SDS * truth.sd, space.high)
    e, nu = (np.linspace(a, b, n) for a, b, n in zip(low, high, _POINTS, strict=True))
    points = np.stack(np.meshgrid(e, nu, indexing="ij"), axis=-1).reshape(-1, 2)
    rows = -(-len(steps) // columns)
    with styled():
        figure = figure_or_new(figure, (DOUBLE, 0.6 + 1.8 * rows))
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for ax, step in zip(panels, steps, strict=False):
            values = step.surrogate.process.mean(points).reshape(_POINTS)
            drawn = ax.pcolormesh(
                e,
                nu,
                np.exp(values - values.max()).T,
                cmap="viridis",
                vmin=0,
                vmax=1,
                shading="gouraud",
                rasterized=True,
            )
            ax.contour(
                truth.grid.young,
                truth.grid.nu,
                (truth.density / truth.density.max()).T,
                levels=_LEVELS,
                colors="white",
                linewidths=0.6,
                linestyles="dashed",
            )
            used = training[: step.succeeded]
            ax.plot(*used.T, "o", color="white", markersize=2.6, markeredgecolor=BLACK, markeredgewidth=0.3)
            if ground_truth is not None:
                mark(ax, ground_truth, RED, "ground truth", marker="o", size=6.0)
            ax.set_title(f"{step.runs} runs, TV {step.total_variation:.2g}")
            ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        for ax in panels[len(steps) :]:
            ax.remove()
        for ax in panels[: len(steps)]:
            ax.set(xlabel=space.parameters[0].figure_label(), ylabel=space.parameters[1].figure_label())
            ax.label_outer()
        figure.colorbar(drawn, ax=list(panels[: len(steps)]), label="likelihood / maximum", pad=0.01)
    return figure


def plot_convergence(steps: Mapping[str, Sequence[NestedStep]], *, ax: Axes | None = None) -> Axes:
    """Draw total variation to the truth (lines) and leave-one-out error near the mode (dashed) against the runs.

    Args:
        steps: Steps from `nested_surrogates`, by the name of the measure.
        ax: Axes to draw in; new ones by default.
    """
    with styled():
        ax = axes_or_new(ax, (SINGLE, 3.0))
        for colour, (name, sequence) in zip(CYCLE, steps.items(), strict=False):
            runs = [step.runs for step in sequence]
            ax.plot(runs, [s.total_variation for s in sequence], "o-", color=colour, label=name)
            proxy = [s.loo_rms_near_mode for s in sequence]
            ax.plot(runs, proxy, "s", linestyle=DASHES[1], fillstyle="none", color=colour)
        ax.plot([], [], "o-", color=GREY, label="total variation")
        ax.plot([], [], "s", linestyle=DASHES[1], fillstyle="none", color=GREY, label="leave-one-out near the mode")
        ax.set(xscale="log", yscale="log", xlabel="forward runs of the design", ylabel="error")
        ticks = sorted({step.runs for sequence in steps.values() for step in sequence})
        ax.set_xticks(ticks, labels=[str(n) for n in ticks], minor=False)
        ax.minorticks_off()
        below(ax, columns=2)
    return ax


def plot_surrogate_errors(
    sizes: Sequence[int] | Int[np.ndarray, " size"],
    errors: Mapping[str, Sequence[float] | Float[np.ndarray, " size"]],
    *,
    quantity: str = "relative L² error at the test points",
    ax: Axes | None = None,
) -> Axes:
    """Draw errors against the number of training runs, both on logarithmic scales.

    Args:
        sizes: numbers of training runs (size,).
        errors: error at each size (size,), by the name of the case.
        quantity: what the errors are.
        ax: axes to draw in.
    """
    with styled():
        ax = axes_or_new(ax, (SINGLE, 2.8))
        for k, (case, values) in enumerate(errors.items()):
            colour, dashes = CYCLE[k % len(CYCLE)], DASHES[k % len(DASHES)]
            ax.loglog(sizes, values, linestyle=dashes, marker="o", markersize=4, color=colour, label=case)
        ax.set(xlabel="training runs", ylabel=quantity)
        ax.set_xticks(list(sizes), [f"{n:d}" for n in sizes])
        ax.xaxis.set_minor_locator(NullLocator())
        ax.legend()
    return ax


def plot_parts(
    points: Float[np.ndarray, "point 2"],
    cells: Mapping[str, Int[np.ndarray, "_ 3"]],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw the triangles of each part in its own colour.

    Args:
        points: vertices of the mesh, mm.
        cells: vertex numbers of the triangles by name of the part, in the order of the legend; at most six parts.
        ax: axes to draw in.
    """
    with styled():
        ax = axes_or_new(ax, (DOUBLE, 3.8))
        for (_, triangles), colour in zip(cells.items(), _COLOURS, strict=False):
            shade, faces = ListedColormap([colour]), np.zeros(len(triangles))
            x, y = points.T
            ax.tripcolor(x, y, triangles, facecolors=faces, cmap=shade, edgecolors="0.4", lw=0.3, rasterized=True)
        handles = [Patch(facecolor=colour, edgecolor="0.4") for colour in _COLOURS[: len(cells)]]
        ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        ax.legend(handles, list(cells), loc="upper right", ncols=len(cells))
    return ax
