"""The figures of repeated experiments, from the content of coverage.json alone."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from strandline.posterior.uniformity import Band
from strandline.report import plots
from strandline.report.captioned import Captioned, whole

__all__ = ["draw_coverage"]

RANKS = (
    "Ranks of the truths in their posteriors: share of the ranks up to each place, minus the share that uniform ranks "
    "would have. If the posteriors are right, all lines stay inside their bands together with a probability of 95 %. "
    "A line that rises first and then falls below zero means posteriors that are too narrow; the reverse, too wide. "
    "The last panel ranks the truth's log-likelihood among those of the draws: a line above zero means posteriors that "
    "are too narrow in all inputs together, one below zero too wide."
)
INTERVALS = "Share of the central 50 % and 90 % intervals that contain the truth, with its 95 % interval (Wilson)."


def draw_coverage(content: Mapping[str, Any]) -> Iterator[Captioned]:
    """Yield the figure of the ranks and that of the intervals."""
    bands = {name: _band(item) for name, item in content["inputs"].items()}
    bands["log-likelihood"] = _band(content["log_likelihood"])
    yield Captioned("coverage_ranks", "coverage", RANKS, whole(plots.plot_rank_bands(bands)))
    found = {name: [_interval(one) for one in item["intervals"]] for name, item in content["inputs"].items()}
    yield Captioned("coverage_intervals", "coverage", INTERVALS, whole(plots.plot_intervals(found).figure))


def _band(item: Mapping[str, Any]) -> Band:
    arrays = {name: np.array(values, float) for name, values in item["band"].items()}
    return Band(**arrays, p_value=item["p_value"])


def _interval(one: Mapping[str, float]) -> plots.IntervalCoverage:
    return plots.IntervalCoverage(one["level"], one["found"], one["low"], one["high"])
