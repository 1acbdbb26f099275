"""The figure of the alternatives, from the content of what-if.json alone."""

from collections.abc import Mapping
from typing import Any

from strandline.report import plots
from strandline.report.captioned import Captioned, whole
from strandline.typeset import figure_text, unit_text

__all__ = ["draw_what_if"]

CAPTION = (
    "Mean and 90 % interval of each input under each alternative. The band and the line are the present posterior. "
    "Orange: the mean moves by more than {shift:g} present standard deviations, or the standard deviation changes by "
    "more than a factor of {sd_ratio:g}. An input that is taken as known has no mark."
)


def draw_what_if(content: Mapping[str, Any]) -> Captioned:
    """Return the figure of the intervals."""
    inputs = content["present"]["inputs"]
    present = {_label(item): plots.Whisker(item["mean"], item["low"], item["high"]) for item in inputs.values()}
    alternatives = [
        (figure_text(one["name"]), [_whisker(one["inputs"].get(name)) for name in inputs])
        for one in content["alternatives"]
        if one["by"] is not None
    ]
    figure = whole(plots.plot_alternatives(present, alternatives))
    return Captioned("what_if", "what_if", CAPTION.format(**content["limits"]), figure)


def _label(item: Mapping[str, Any]) -> str:
    unit = unit_text(item["unit"])
    return f"{figure_text(item['label'])} [{unit}]" if unit else figure_text(item["label"])


def _whisker(item: Mapping[str, Any] | None) -> plots.Whisker | None:
    return None if item is None else plots.Whisker(item["mean"], item["low"], item["high"], item["moves"])
