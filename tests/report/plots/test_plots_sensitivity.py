"""Bars of sensitivity indices: what the artists hold, not how they look."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from strandline.posterior import SobolIndices
from strandline.report.plots import plot_sensitivity


def test_bars_are_the_indices_from_the_top_down() -> None:
    first, total = np.array([0.2, -0.01, 0.5]), np.array([0.3, 0.02, 0.7])
    ax = plot_sensitivity(
        SobolIndices(first, first - 0.05, first + 0.04, total, total - 0.1, total + 0.1, 10), ("E", "nu", "V")
    )
    assert isinstance(ax.figure, Figure)
    FigureCanvasAgg(ax.figure).draw()
    drawn = [[bar.get_width() for bar in container] for container in ax.containers if hasattr(container, "patches")]
    np.testing.assert_allclose(drawn, [first, total])
    assert [text.get_text() for text in ax.get_yticklabels()] == ["E", "nu", "V"]
    assert ax.yaxis_inverted()
    low, high = ax.get_xlim()
    assert low <= -0.06
    assert high >= 1.0
