"""Where runs failed, for any number of inputs: parallel axes, the failed runs coloured by the kind of failure."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from strandline.parameters import ParameterSpace
from strandline.report.plots.parallel import draw_axis
from strandline.report.plots.style import CYCLE, DASHES, DOUBLE, GREY, axes_or_new, below, styled

__all__ = ["plot_failed_runs"]


def plot_failed_runs(
    space: ParameterSpace,
    ok: Float[np.ndarray, "run dim"],
    failed: Mapping[str, Float[np.ndarray, "_ dim"]],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw each run as a line across one axis per input: grey if it succeeded, coloured by kind if it failed.

    Args:
        space: the inputs, from left to right; each axis spans the box.
        ok: inputs of the successful runs (run, dim).
        failed: inputs of the failed runs (run, dim) by kind of failure, the commonest first.
        ax: axes to draw in.
    """
    with styled():
        ax = axes_or_new(ax, (DOUBLE, 3.2))
        _lines(ax, space.to_unit(ok), GREY, "-", f"ok: {len(ok)}", width=0.4, alpha=0.35)
        for k, (kind, points) in enumerate(failed.items()):
            colour, dashes = CYCLE[(k + 1) % len(CYCLE)], DASHES[k % len(DASHES)]
            _lines(ax, space.to_unit(points), colour, dashes, f"{kind}: {len(points)}", width=0.9, alpha=0.9)
        for place, parameter in enumerate(space):
            draw_axis(ax, place, *parameter.interval)
        ax.set(xlim=(-0.55, space.dim - 0.85), ylim=(-0.02, 1.02), yticks=[])
        ax.set_xticks(np.arange(space.dim), [parameter.figure_label() for parameter in space])
        ax.tick_params(axis="x", length=0, pad=6, labelsize=8)
        ax.spines[:].set_visible(False)
        below(ax)
    return ax


def _lines(
    ax: Axes,
    heights: Float[np.ndarray, "run dim"],
    colour: str,
    dashes: str | tuple[int, tuple[int, ...]],
    label: str,
    *,
    width: float,
    alpha: float,
) -> None:
    across = np.broadcast_to(np.arange(heights.shape[1], dtype=float), heights.shape)
    segments = list(np.stack([across, heights], axis=-1))
    ax.add_collection(
        LineCollection(segments, colors=colour, linestyles=[dashes], linewidths=width, alpha=alpha, label=label)
    )
