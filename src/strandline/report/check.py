"""The picture of a check of the posterior, from the content of check.json alone."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from strandline.report import plots
from strandline.report.figures import Captioned

__all__ = ["band_of", "draw_check"]

CAPTION = (
    "Draws of the posterior, run with the true model. Left: their true log-likelihood against the surrogate's; a "
    "common offset does no harm. Right: the interfaces of the draws and the observed one, as offsets along the normals "
    "of the median interface."
)


def draw_check(check: Mapping[str, Any]) -> Captioned:
    """Return the figure of a check."""
    true, surrogate = (np.array(check["particles"][name], float) for name in ("true", "surrogate"))
    bands = {item["condition"]: band_of(item["offset"]) for item in check["interfaces"]}
    figure = plots.plot_check(true, surrogate, bands)
    assert isinstance(figure, Figure)
    return Captioned("check", "check", CAPTION, figure)


def band_of(offset: Mapping[str, Any] | None) -> plots.OffsetBand | None:
    """Return the band that check.json or compare.json describes; None if there is none."""
    if offset is None:
        return None
    names = {"q05": "low", "q50": "median", "q95": "high"}
    return plots.OffsetBand(**{names.get(key, key): np.array(values) for key, values in offset.items()})
