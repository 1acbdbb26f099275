"""Figure of the outcomes in the study's box."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap
from verification.validation.biofilm_mesh import BOX
from verification.validation.failure_tables import differing

from strandline.report.plots.style import SKY
from strandline.runs import RunRecord

__all__ = ["draw", "outcomes"]


def draw(default: Sequence[RunRecord], fine: Sequence[RunRecord], fold: Callable[[Any], Any], path: Path) -> None:
    """Draw the outcomes on the default mesh, the fold on the fine mesh, and the points where the two meshes differ."""
    figure, axes = plt.subplots(figsize=(8, 4.8), layout="constrained")
    outcomes(axes, default)
    ratios = np.linspace(*BOX[1], 200)
    axes.plot(fold(ratios), ratios, "k-", lw=1.4, label="fold, mesh fine")
    cases = differing(default, fine)
    if cases:
        x, y = np.array([case.point for case in cases]).T
        axes.scatter(x, y, s=80, facecolors="none", edgecolors="k", lw=1.1, label="solved on one mesh only")
    axes.set(xlim=BOX[0], ylim=BOX[1], xlabel="E, Pa", ylabel="ν")
    figure.legend(loc="outside upper center", ncols=5, frameon=False, fontsize="small", columnspacing=1.2)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def outcomes(ax: Axes, runs: Sequence[RunRecord]) -> None:
    """Draw solved runs coloured by their largest displacement, failed ones by the load at which they turned back."""
    stalled = [run for run in runs if not run.ok and "limit_load" not in run.diagnostics]
    _marks(ax, stalled, c=SKY, marker="X", s=42, label="failed, stalled")
    for figure, factor, name, style in (
        ("max_displacement", 1e3, "largest displacement, µm", {"cmap": "viridis", "s": 15, "label": "solved"}),
        (
            "limit_load", 1.0, "limit load, mm²/s",
            {"cmap": _dark("Oranges"), "marker": "X", "s": 30, "label": "failed at a limit point"},
        ),
    ):  # fmt: skip
        having = [run for run in runs if figure in run.diagnostics]
        values = [factor * run.diagnostics[figure] for run in having]
        drawn = _marks(ax, having, c=values, **style)
        if drawn is not None:
            ax.figure.colorbar(drawn, ax=ax, label=name, pad=0.02, aspect=30)


def _marks(ax: Axes, runs: Sequence[RunRecord], **style: Any) -> Any:
    """Draw a mark at each run; return None if there are none."""
    if not runs:
        return None
    places = np.array([(run.inputs["E"], run.inputs["nu"]) for run in runs])
    return ax.scatter(places[:, 0], places[:, 1], lw=0, clip_on=False, **style)


def _dark(name: str) -> Colormap:
    """Return a colour map without its palest part."""
    return ListedColormap(mpl.colormaps[name](np.linspace(0.35, 1.0, 256)))
