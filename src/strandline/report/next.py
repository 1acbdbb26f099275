"""The figures of candidates for the next experiment, from the content of next.json alone."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from strandline.report import plots
from strandline.report.captioned import Captioned, whole

__all__ = ["draw_next"]

MOST = 20
"""Candidates that are drawn."""
GAINS = (
    "Left: expected information about the inputs from each candidate; the pale part is lost where the specimen folds "
    "or the run fails. Right: expected standard deviation of each input, as a share of the present one."
)
DIRECTIONS = (
    "Combinations of the inputs, in prior standard deviations, one in each column, from the least to the best known. "
    "Below each column: the share of the prior's width that is left."
)


def draw_next(content: Mapping[str, Any]) -> Iterator[Captioned]:
    """Yield the figure of the candidates and that of the combinations of the inputs."""
    shown = [one for one in content["candidates"] if one["gain"] is not None][:MOST]
    names = {name: item["label"] for name, item in content["inputs"].items()}
    if shown:
        figure = plots.plot_candidates(
            [one["label"] for one in shown],
            np.array([one["gain"] for one in shown]),
            np.array([one["error"] for one in shown]),
            np.array([one["failing"] or 0.0 for one in shown]),
            {label: np.array([one["sd_ratio"][name] for one in shown]) for name, label in names.items()},
        )
        yield Captioned("next_candidates", "next", GAINS, whole(figure))
    if len(names) > 1:
        weights = np.array([[one["weights"][name] for name in names] for one in content["directions"]])
        left = np.array([one["left"] for one in content["directions"]])
        axes = plots.plot_directions(list(names.values()), weights, left)
        yield Captioned("next_directions", "next", DIRECTIONS, whole(axes.figure))
