"""Error of a surrogate against the number of training runs, one line per case (Fig. 12)."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from strandline.report.plots.style import (
    CYCLE,
    DASHES,
    SINGLE,
    axes_or_new,
    styled,
)

__all__ = ["plot_convergence"]


def plot_convergence(
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
