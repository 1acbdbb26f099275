"""Figures of the answers to questions and of the check: candidates, ranks, intervals, offsets along normals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from strandline.foundations import figure_text, unit_text
from strandline.posterior import Band
from strandline.report.plots import style

CANDIDATES_APART, LEVELS_APART = 0.16, 0.12
"""Distance of the marks of one candidate, and of one input."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
ROW, AROUND = 0.17, 0.75
"""Heights of a row of alternatives and of what is above and below the rows, inches."""
LABELLED = 1.9
"""Width of the names, inches."""
MOST_NAMED = 60
"""Largest number of specimens whose names are written below their intervals."""
STROKE = 0.025
"""Length of the strokes that stand for specimens, as a share of the axes."""
QUANTILES = ("q05", "q50", "q95")


@style.drawn()
def plot_candidates(candidates: Sequence[Mapping[str, Any]], names: Mapping[str, str]) -> Figure:
    """Draw the gain of each candidate of next.json, nats, with its error as a bar, and beside it the expected widths.

    The part of the gain that is lost because the experiment may fail is drawn pale. The widths are expected standard
    deviations over the present ones; `names` are the labels of the inputs.
    """
    rows = [(one["gain"], one["error"], one["failing"] or 0.0) for one in candidates]
    gains, errors, failing = np.array(rows).T
    place = np.arange(len(rows))
    figure = style.new_figure(style.DOUBLE, 1.3 + 0.24 * len(rows))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.2, 1))
    bars = {"ecolor": style.BLACK, "elinewidth": 0.9, "capsize": 2.0}
    left.barh(place, gains, 0.6, color=style.SKY, alpha=0.45, label="lost where it fails")
    left.barh(place, gains * (1 - failing), 0.6, xerr=errors, color=style.BLUE, label="gain", error_kw=bars)
    left.set_yticks(place, [figure_text(one["label"]) for one in candidates])
    left.set_xlabel("expected information gain [nats]")
    left.set_xlim(left=0.0)
    for k, (name, label) in enumerate(names.items()):
        look = {"marker": MARKERS[k % len(MARKERS)], "color": style.CYCLE[k % len(style.CYCLE)], "linestyle": ""}
        shift = CANDIDATES_APART * (k - 0.5 * (len(names) - 1))
        ratio = [one["sd_ratio"][name] for one in candidates]
        right.plot(ratio, place + shift, markersize=4, label=figure_text(label), **look)
    right.axvline(1.0, color=style.GREY, linewidth=0.8, linestyle=":")
    right.set(xlabel="expected sd / present sd", xlim=(0.0, 1.08))
    left.invert_yaxis()
    style.legend_under(figure, style.labelled(left, right))
    return figure


@style.drawn()
def plot_directions(
    directions: Sequence[Mapping[str, Any]], names: Mapping[str, str], *, ax: Axes | None = None
) -> Axes:
    """Draw the combinations of the inputs in next.json as columns of a matrix, with what is left of the prior's width.

    Weights are in prior standard deviations; `names` are the labels of the inputs.
    """
    weights = np.array([[one["weights"][name] for one in directions] for name in names])
    ax = ax or style.new_axes(1.6 + 0.5 * len(names), 1.2 + 0.36 * len(names))
    picture = ax.imshow(weights, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    for (row, column), value in np.ndenumerate(weights):
        text, colour = f"{value:+.2f}".replace("-", "−"), "white" if abs(value) > 0.6 else style.BLACK
        ax.text(column, row, text, ha="center", va="center", fontsize=6.5, color=colour)
    ax.set_xticks(range(len(directions)), [f"{100 * one['left']:.0f} %" for one in directions])
    ax.set_yticks(range(len(names)), [figure_text(label) for label in names.values()])
    ax.set(xlabel="prior width left in each combination")
    ax.figure.colorbar(picture, ax=ax, label="weight", shrink=0.9)
    return ax


@style.drawn()
def plot_rank_bands(bands: Mapping[str, Band]) -> Figure:
    """Draw how far the distribution of each input's ranks is from uniform, and the band that it must stay inside."""
    figure, panels = style.panel_grid(len(bands), 2.2)
    for ax, (name, band) in zip(panels, bands.items(), strict=True):
        places = band.places
        low, high = band.low - places, band.high - places
        ax.fill_between(places, low, high, color=style.SKY, alpha=0.6, linewidth=0, label="95 % band")
        ax.axhline(0.0, color=style.GREY, linewidth=0.8)
        colour, label = (style.BLUE, "ranks") if band.inside else (style.RED, "ranks that leave it")
        ax.plot(places, band.found - places, color=colour, label=label)
        ax.set(xlabel="rank of the truth", ylabel="share below minus rank", xlim=(0, 1), title=figure_text(name))
    style.legend_under(figure, style.labelled(*panels))
    return figure


@style.drawn(style.SINGLE, 2.7)
def plot_intervals(found: Mapping[str, Sequence[Mapping[str, float]]], *, ax: Axes = style.NEW) -> Axes:
    """Draw the share of intervals that contain the truth, for each input and probability, as coverage.json has them."""
    levels = [one["level"] for one in next(iter(found.values()))]
    for k, (level, colour) in enumerate(zip(levels, style.CYCLE, strict=False)):
        share, low, high = (np.array([each[k][key] for each in found.values()]) for key in ("found", "low", "high"))
        places = np.arange(len(share)) + LEVELS_APART * (k - 0.5 * (len(levels) - 1))
        ax.axhline(level, color=colour, linewidth=0.8, linestyle=":")
        reach = np.maximum([share - low, high - share], 0.0)
        label = f"{100 * level:.0f} % intervals"
        ax.errorbar(places, share, reach, fmt="o", color=colour, markersize=4, label=label)
    ax.set_xticks(range(len(found)), [figure_text(name) for name in found])
    ax.set(ylabel="share that contain the truth", xlim=(-0.5, len(found) - 0.5), ylim=(0, 1.02))
    style.below(ax)
    return ax


@style.drawn()
def plot_alternatives(
    present: Mapping[str, Mapping[str, float]], alternatives: Sequence[tuple[str, Sequence[Mapping[str, float] | None]]]
) -> Figure:
    """Draw mean and interval of each input under each alternative, over a band for the present posterior.

    `present` has the `mean`, and the ends of the 90 % interval, `low` and `high`, by the label of the input;
    alternatives have the same of each input and whether it `moves` by more than what counts, or None if it is fixed.
    """
    height, sharing = ROW * (len(alternatives) + 1) + AROUND, {"sharey": True}
    figure, panels = style.panel_grid(len(present), height, margin=0.3, single=style.SINGLE + LABELLED, **sharing)
    for i, (ax, (label, band)) in enumerate(zip(panels, present.items(), strict=True)):
        _whiskers(ax, band, [some[i] for _, some in alternatives])
        ax.set_xlabel(label)
    panels[0].set_yticks(range(len(alternatives)), [name for name, _ in alternatives])
    panels[0].set_ylim(len(alternatives) - 0.4, -0.6)
    style.legend_under(figure, style.labelled(*panels))
    return figure


def _whiskers(ax: Axes, band: Mapping[str, float], some: Sequence[Mapping[str, float] | None]) -> None:
    ax.axvspan(band["low"], band["high"], color=style.SKY, alpha=0.35, linewidth=0, label="present 90 % interval")
    ax.axvline(band["mean"], color=style.GREY, linewidth=0.8, label="present mean")
    for moves, colour, more in ((False, style.BLUE, ""), (True, style.RED, ", moved")):
        chosen = [(k, one) for k, one in enumerate(some) if one is not None and one["moves"] == moves]
        if not chosen:
            continue
        mean, low, high = np.array([(one["mean"], one["low"], one["high"]) for _, one in chosen]).T
        reach = np.maximum([mean - low, high - mean], 0.0)
        places, label = [k for k, _ in chosen], f"mean and 90 % interval{more}"
        ax.errorbar(mean, places, xerr=reach, fmt="o", color=colour, markersize=3, linewidth=1.0, label=label)
    ax.xaxis.set_major_locator(MaxNLocator(4))
    ax.tick_params(axis="y", length=0)


@style.drawn(style.DOUBLE, 2.9)
def plot_caterpillar(specimens: Sequence[Mapping[str, Any]], name: str, label: str, *, ax: Axes = style.NEW) -> Axes:
    """Draw 90 % intervals of an input, with its label, for all in specimens.json, sorted by their medians."""
    items = [one["inputs"][name] for one in specimens]
    own = np.array([[item[q] for q in QUANTILES] for item in items])
    given_all = np.array([[item["shrunk"][q] for q in QUANTILES] for item in items if "shrunk" in item]).reshape(-1, 3)
    order = np.argsort((given_all if len(given_all) else own)[:, 1], kind="stable")
    odd = np.array([bool(one.get("outlier")) for one in specimens])[order]
    places, many = np.arange(len(order)), len(order) > MOST_NAMED
    apart, width, size = (0.0, 0.6, 2) if many else (0.15, 1.2, 4)
    kinds = (own, -apart, style.GREY, "own outline alone"), (given_all, apart, style.BLUE, "given all specimens")
    for values, shift, colour, words in kinds:
        if len(values):
            low, median, high = values[order].T
            ax.vlines(places + shift, low, high, color=colour, linewidth=width, label=words)
            ax.plot(places + shift, median, ".", color=colour, markersize=size)
    if odd.any():
        look: Any = {"color": style.RED, "fillstyle": "none", "markersize": 7, "label": "outlier"}
        ax.plot(places[odd], own[order][odd, 1], "o", **look)
    if many:
        ax.set(xlabel="specimens, sorted", xticks=[])
    else:
        ax.set_xticks(places, [specimens[i]["specimen"] for i in order], rotation=90, fontsize=6)
    ax.set(ylabel=label, xlim=(-1, len(order)))
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)  # above: names of any length stand below
    return ax


@style.drawn(style.SINGLE, 2.7)
def plot_population(
    density: Mapping[str, Sequence[float]], means: Sequence[float], label: str, *, ax: Axes = style.NEW
) -> Axes:
    """Draw the density of an input in the population, above a stroke for the mean of each specimen given all of them.

    `density` has values `x` of the input, and the `median` and the quantiles of 5 % (`low`) and 95 % (`high`) of the
    density there, per unit of the input; `label` is its symbol with its unit, for Matplotlib.
    """
    x, low, median, high = (np.array(density[key], float) for key in ("x", "low", "median", "high"))
    ax.fill_between(x, low, high, color=style.SKY, alpha=0.6, linewidth=0, label="90 % band")
    ax.plot(x, median, color=style.BLUE, label="population")
    top = float(high.max())
    ax.vlines(means, -2 * STROKE * top, -STROKE * top, color=style.GREY, linewidth=0.6, label="specimens")
    ends = np.append(x[high > 1e-3 * top], means)
    ax.set(xlabel=label, ylabel="density", xlim=(ends.min(), ends.max()))
    style.below(ax)
    return ax


MARGIN = 0.03
"""Space on both sides of a histogram, as a share of its width."""


@dataclass(frozen=True, eq=False)
class OffsetBand:
    """Interfaces as offsets along the normals of their pointwise median: 5, 50 and 95 % quantiles at places along it,
    and the offsets of the observed points; all in mm.
    """

    arc_length: Float[np.ndarray, " point"]
    low: Float[np.ndarray, " point"]
    median: Float[np.ndarray, " point"]
    high: Float[np.ndarray, " point"]
    observed_arc_length: Float[np.ndarray, " observed"]
    observed: Float[np.ndarray, " observed"]

    @classmethod
    def of(cls, offset: Mapping[str, Any] | None) -> "OffsetBand | None":
        """Return the band that check.json or compare.json describes; None if there is none."""
        if offset is None:
            return None
        names = {"q05": "low", "q50": "median", "q95": "high"}
        return cls(**{names.get(key, key): np.array(values) for key, values in offset.items()})


@style.drawn()
def plot_check(
    true: Float[np.ndarray, " draw"], surrogate: Float[np.ndarray, " draw"], bands: Mapping[str, OffsetBand | None]
) -> Figure:
    """Draw true log-likelihoods, not finite if runs failed, over the surrogate's, and `plot_offsets` by condition."""
    figure = style.new_figure(style.DOUBLE, 3.6 if len(bands) < 2 else 3.0)
    first, *others = figure.subplots(1, 1 + len(bands), squeeze=False)[0]
    _likelihoods(first, true, surrogate)
    for ax, (condition, band) in zip(others, bands.items(), strict=True):
        plot_offsets(band, ax=ax)
        ax.set_title(condition)
    return figure


def _likelihoods(ax: Axes, true: Float[np.ndarray, " draw"], surrogate: Float[np.ndarray, " draw"]) -> None:
    """Draw true against surrogate log-likelihoods, the line of agreement, and the failed runs at the bottom."""
    ok = np.isfinite(true)
    both = np.concatenate([true[ok], surrogate])
    margin = 0.06 * (float(np.ptp(both)) or 1.0)
    limits = (float(both.min()) - margin, float(both.max()) + margin)
    ax.plot(limits, limits, color=style.BLACK, linewidth=0.8, label="agreement")
    ax.plot(surrogate[ok], true[ok], "o", color=style.BLUE, markersize=3.5, alpha=0.6, label="draw of the posterior")
    if not ok.all():
        floor = np.full(np.count_nonzero(~ok), limits[0])
        label = f"failed runs: {len(floor)}"
        ax.plot(surrogate[~ok], floor, "x", color=style.GREY, markersize=6, clip_on=False, label=label)
    ax.set(xlim=limits, ylim=limits, box_aspect=1.0)
    ax.set(xlabel="log-likelihood, surrogate", ylabel="log-likelihood, true model")
    style.below(ax, columns=2)


@style.drawn(style.SINGLE, 3.6)
def plot_offsets(band: OffsetBand | None, *, legend: bool = True, ax: Axes = style.NEW) -> Axes:
    """Draw the band of the interfaces and the observation over the arc length; a note if there is no band."""
    if band is None:
        ax.set_axis_off()
        ax.text(0.5, 0.5, "no band: see the note\nin check.json", ha="center", va="center", color=style.GREY)
        return ax
    order = np.argsort(band.arc_length, kind="stable")
    middle = np.interp(band.observed_arc_length, band.arc_length[order], band.median[order])
    low, high = (style.TO_MICROMETRES * (end - band.median) for end in (band.low, band.high))
    ax.fill_between(band.arc_length, low, high, color=style.SKY, alpha=0.6, linewidth=0, label="draws, 5 to 95 %")
    ax.plot(band.arc_length, 0.0 * band.median, color=style.BLACK, linewidth=0.8, label="draws, median")
    observed = style.TO_MICROMETRES * (band.observed - middle)
    ax.plot(band.observed_arc_length, observed, color=style.GREEN, linewidth=2.0, label="observed")
    ax.set(xlabel="arc length [mm]", ylabel="normal offset from the median [µm]", box_aspect=1.0)
    if legend:
        style.below(ax, columns=2)
    return ax


@style.drawn()
def plot_averaged(inputs: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw the histograms of each input under each model, as compare.json has them, and their average on top."""
    figure, panels = style.panel_grid(len(inputs), 2.3)
    for ax, one in zip(panels, inputs.values(), strict=True):
        edges, models = np.array(one["histogram"]["edges"], float), one["histogram"]["models"]
        for (name, density), colour in zip(models.items(), np.resize(style.CYCLE, len(models)), strict=True):
            ax.stairs(density, edges, color=colour, linewidth=1.4, label=name.replace("$", r"\$"))
        average = one["histogram"]["averaged"]
        ax.stairs(average, edges, color=style.BLACK, linewidth=1.6, linestyle="--", label="averaged")
        around = MARGIN * (edges[-1] - edges[0])  # a step at an end would seem to be cut off
        ends = edges[0] - around, edges[-1] + around
        ax.set(xlabel=axis_label(one), ylabel="density", xlim=ends, ylim=(0, None))
    style.legend_under(figure, style.labelled(panels[0]))
    return figure


def axis_label(item: Mapping[str, Any]) -> str:
    """Return the label of an input with its unit, for Matplotlib."""
    unit = unit_text(item["unit"])
    return f"{figure_text(item['label'])} [{unit}]" if unit else figure_text(item["label"])


@style.drawn()
def plot_predictions(bands: Mapping[tuple[str, str], OffsetBand]) -> Figure:
    """Draw the predicted interfaces with the observed one: a row for each condition, a column for each model."""
    conditions, models = (list(dict.fromkeys(key[k] for key in bands)) for k in (0, 1))
    figure = style.new_figure(style.DOUBLE, 3.0 * len(conditions) + 0.3)
    panels = figure.subplots(len(conditions), len(models), squeeze=False, sharey="row")
    for row, condition in zip(panels, conditions, strict=True):
        for ax, model in zip(row, models, strict=True):
            plot_offsets(bands.get((condition, model)), ax=ax, legend=False)
            ax.set_title((f"{model}, {condition}" if condition else model).replace("$", r"\$"))
            ax.set_box_aspect(None)
            ax.set_ylabel("" if ax is not row[0] else "offset from the median [µm]")
    style.legend_under(figure, style.labelled(panels[0][0]))
    return figure
