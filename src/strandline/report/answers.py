"""The figures of answers to questions, each from the content of its JSON file alone."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from strandline.posterior.rank_tests import Band
from strandline.report import plots
from strandline.report.figure_files import Captioned
from strandline.report.plots.comparison import axis_label
from strandline.typeset import figure_text

MOST_CANDIDATES = 20
"""Candidates that are drawn."""
CHECK = (
    "Draws of the posterior, run with the true model. Left: their true log-likelihood against the surrogate's; a "
    "common offset does no harm. Right: the interfaces of the draws and the observed one, as offsets along the normals "
    "of the median interface."
)
MARGINALS = (
    "Posterior of the inputs that all models share, under each model, and averaged over the models with their "
    "probabilities."
)
PREDICTIVE = (
    "Predicted interfaces under each model and the observed one, as offsets along the normals of the median of the "
    "predicted interfaces. The band holds 90 % of the draws of the posterior, without the noise of the observation."
)
RANKS = (
    "Ranks of the truths in their posteriors: share of the ranks up to each place, minus the share that uniform ranks "
    "would have. If the posteriors are right, all lines stay inside their bands together with a probability of 95 %. "
    "A line that rises first and then falls below zero means posteriors that are too narrow; the reverse, too wide. "
    "The last panel ranks the truth's log-likelihood among those of the draws: a line above zero means posteriors that "
    "are too narrow in all inputs together, one below zero too wide."
)
COVERED = "Share of the central 50 % and 90 % intervals that contain the truth, with its 95 % interval (Wilson)."
GAINS = (
    "Left: expected information about the inputs from each candidate; the pale part is lost where the specimen folds "
    "or the run fails. Right: expected standard deviation of each input, as a share of the present one."
)
DIRECTIONS = (
    "Combinations of the inputs, in prior standard deviations, one in each column, from the least to the best known. "
    "Below each column: the share of the prior's width that is left."
)
OF_SPECIMENS = (
    "90 % intervals of {} for each specimen, from its own outline alone (grey) and given all specimens (blue), with "
    "their medians, in the order of the blue ones. The less certain specimens move most towards the population; as the "
    "inputs of a specimen move together, a single one may move away."
)
ALONE = "90 % intervals of {} for each specimen, with their medians."
DENSITY = (
    "Density of {} over the population, median and 90 % band. Each stroke is the mean of a specimen given all of them."
)
ALTERNATIVES = (
    "Mean and 90 % interval of each input under each alternative. The band and the line are the present posterior. "
    "Orange: the mean moves by more than {shift:g} present standard deviations, or the standard deviation changes by "
    "more than a factor of {sd_ratio:g}. An input that is taken as known has no mark."
)


def draw_check(check: Mapping[str, Any]) -> Captioned:
    """Return the figure of a check of the posterior, check.json."""
    true, surrogate = (np.array(check["particles"][name], float) for name in ("true", "surrogate"))
    bands = {item["condition"]: _offset_band(item["offset"]) for item in check["interfaces"]}
    return Captioned("check", "check", CHECK, plots.plot_check(true, surrogate, bands))


def _offset_band(offset: Mapping[str, Any] | None) -> plots.OffsetBand | None:
    """Return the band that check.json or compare.json describes; None if there is none."""
    if offset is None:
        return None
    names = {"q05": "low", "q50": "median", "q95": "high"}
    return plots.OffsetBand(**{names.get(key, key): np.array(values) for key, values in offset.items()})


def draw_comparison(content: Mapping[str, Any]) -> Iterator[Captioned]:
    """Yield the figure of the inputs shared by the models of compare.json, and that of predictions of polylines."""
    if content["averaged"]:
        yield Captioned("compare_marginals", "compare", MARGINALS, plots.plot_averaged(content["averaged"]))
    bands = {
        (str(item["condition"]), str(name)): found
        for item in content["predictive"]
        for name, band in item["models"].items()
        if (found := _offset_band(band)) is not None
    }
    if bands:
        yield Captioned("compare_predictive", "compare", PREDICTIVE, plots.plot_predictions(bands))


def draw_coverage(content: Mapping[str, Any]) -> Iterator[Captioned]:
    """Yield the figure of the ranks of coverage.json, and that of the intervals."""
    ranked = {**content["inputs"], "log-likelihood": content["log_likelihood"]}
    bands = {
        name: Band(**{key: np.array(values, float) for key, values in item["band"].items()}, p_value=item["p_value"])
        for name, item in ranked.items()
    }
    yield Captioned("coverage_ranks", "coverage", RANKS, plots.plot_rank_bands(bands))
    found = {name: item["intervals"] for name, item in content["inputs"].items()}
    yield Captioned("coverage_intervals", "coverage", COVERED, plots.plot_intervals(found))


def draw_next(content: Mapping[str, Any]) -> Iterator[Captioned]:
    """Yield the figure of the candidates of next.json, and that of the combinations of the inputs."""
    drawn = [one for one in content["candidates"] if one["gain"] is not None][:MOST_CANDIDATES]
    names = {name: item["label"] for name, item in content["inputs"].items()}
    if drawn:
        figure = plots.plot_candidates(
            [one["label"] for one in drawn],
            np.array([one["gain"] for one in drawn]),
            np.array([one["error"] for one in drawn]),
            np.array([one["failing"] or 0.0 for one in drawn]),
            {label: np.array([one["sd_ratio"][name] for one in drawn]) for name, label in names.items()},
        )
        yield Captioned("next_candidates", "next", GAINS, figure)
    if len(names) > 1:
        weights = np.array([[one["weights"][name] for name in names] for one in content["directions"]])
        left = np.array([one["left"] for one in content["directions"]])
        axes = plots.plot_directions(list(names.values()), weights, left)
        yield Captioned("next_directions", "next", DIRECTIONS, axes)


def draw_specimens(content: Mapping[str, Any]) -> Iterator[Captioned]:
    """Yield the intervals of each input of specimens.json, and its density in the population."""
    specimens, population = content["specimens"], content["population"]
    for name, item in content["inputs"].items() if specimens else ():
        label, caption = axis_label(item), ALONE if population is None else OF_SPECIMENS
        axes = plots.plot_caterpillar(specimens, name, label)
        yield Captioned(f"specimens_intervals_{name}", "specimens", caption.format(item["label"]), axes)
        if population is not None:
            density = {key: np.array(some, float) for key, some in population["inputs"][name]["density"].items()}
            means = np.array([one["inputs"][name]["shrunk"]["mean"] for one in specimens])
            axes = plots.plot_population(density, means, label)
            yield Captioned(f"specimens_population_{name}", "specimens", DENSITY.format(item["label"]), axes)


def draw_what_if(content: Mapping[str, Any]) -> Iterator[Captioned]:
    """Yield the figure of the intervals of what-if.json."""
    inputs = content["present"]["inputs"]
    alternatives = [
        (figure_text(one["name"]), [one["inputs"].get(name) for name in inputs])
        for one in content["alternatives"]
        if one["by"] is not None
    ]
    figure = plots.plot_alternatives({axis_label(item): item for item in inputs.values()}, alternatives)
    yield Captioned("what_if", "what_if", ALTERNATIVES.format(**content["limits"]), figure)
