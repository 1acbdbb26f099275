"""A finished study as one self-contained HTML page, and its figures as files; the pages and figures of answers."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from strandline.calibration import Calibration
from strandline.design.active import KINDS
from strandline.posterior.rank_tests import Band
from strandline.report import plots
from strandline.report.explore import explore
from strandline.report.figure_files import Captioned, fitted, marked, saved, whole_folder
from strandline.report.figures import figure_groups
from strandline.report.html import template, write_page
from strandline.report.methods import BIBTEX, methods_paragraph
from strandline.report.plots.answers import axis_label
from strandline.report.warnings import LOO_LIMIT, reason_to_doubt
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


FILE_NAME = "report.html"
FIGURES = "figures"
MOST_CHARACTERS, TEXT = 5_000_000, 200_000
"""Size of a report above which its largest pictures get half their resolution; the part of it that is for text."""
MARKS = ("<!-- check of the posterior -->\n", "<!-- end of the check -->\n")
"""Comments on the page that enclose the section of a check."""
ANSWERS: dict[str, Callable[[Mapping[str, Any]], Iterable[Captioned]]] = {
    "compare": draw_comparison,
    "coverage": draw_coverage,
    "next": draw_next,
    "specimens": draw_specimens,
    "what-if": draw_what_if,
}
"""What draws the figures of the answer to a question, if it has any."""


def write_report(
    calibration: Calibration,
    summary: Mapping[str, Any],
    *,
    study_text: str,
    truth: Mapping[str, float] | None,
    folder: Path,
    check: Mapping[str, Any] | None = None,
    pictures: Mapping[str, Mapping[str, Any]] | None = None,
    on_failure: Callable[[str, Exception], None] | None = None,
) -> Path:
    """Write `folder`/figures (PNG and PDF; coarse PNG for a draft) and `folder`/report.html; return the page's path.

    The page is self-contained: pictures and scripts are embedded, and it loads nothing. Without scripts, and on paper,
    it is the same but for the section that they make. `summary` is the content of summary.json, `truth` the inputs of a
    synthetic observation, `check` the content of check.json if it belongs to this posterior, `pictures` those behind
    the interfaces by condition, with size, place and address. `on_failure` gets the name and the error of figures that
    cannot be drawn or saved, and the page is written without them; by default, the first such error is raised and the
    old report stays.
    """
    doubt = reason_to_doubt(calibration, check)
    groups: dict[str, Iterator[Captioned]] = {
        name: map(partial(marked, doubt=doubt), figures) for name, figures in figure_groups(calibration, truth).items()
    }
    if check is not None:
        groups["check"] = map(draw_check, [check])
    failed: list[str] = []

    def note(name: str, error: Exception) -> None:
        if on_failure is None:
            raise error
        failed.append(f"{name} could not be written: {type(error).__name__}: {error}")
        on_failure(name, error)

    section: dict[str, Any] | None = None
    try:
        section = explore(calibration, truth, pictures)
    except Exception as error:
        note("the section Explore", error)
    shown = _all_saved(groups, folder / FIGURES, note, draft=calibration.settings.draft)
    shown = fitted(shown, MOST_CHARACTERS - TEXT - (section["size"] if section else 0))
    picture = next((item for item in shown if item["name"] == "check"), None)
    page = template("report.html.j2").render(
        s=_without_bad_comparison({**summary, "warnings": [*failed, *summary["warnings"]]}),
        figures=[item for item in shown if item is not picture],
        study_text=study_text,
        methods=methods_paragraph(summary),
        bibtex=BIBTEX.format(version=summary["version"]),
        fit=calibration.settings.fit,
        check=check,
        picture=picture,
        explore=section,
        batch_kinds=KINDS,
    )
    return write_page(folder / FILE_NAME, page)


def _without_bad_comparison(summary: Mapping[str, Any]) -> Mapping[str, Any]:
    """Leave out the second posterior, from a surrogate of the log-likelihood, if this is bad near the mode."""
    errors = [one["loo_rms_near_mode"] for one in summary["measures"].values()]
    return {**summary, "comparison": None} if errors and errors[0] > LOO_LIMIT else summary


def _all_saved(
    groups: Mapping[str, Iterable[Captioned]], target: Path, note: Callable[[str, Exception], None], *, draft: bool
) -> list[dict[str, str]]:
    """Save the figures and return what the page needs of each; an error ends its group but not the others."""
    shown: list[dict[str, str]] = []
    try:
        with whole_folder(target) as folder:
            for name, figures in groups.items():
                try:
                    shown += (saved(captioned, folder, draft=draft) for captioned in figures)
                except Exception as error:
                    note(f"{FIGURES} ({name})", error)
    except OSError as error:
        note(FIGURES, error)
    return shown


def remove_report(folder: Path) -> None:
    """Remove `folder`/report.html and the figures of an earlier result; those that other commands drew stay."""
    (folder / FILE_NAME).unlink(missing_ok=True)
    if (folder / FIGURES).is_dir():
        with whole_folder(folder / FIGURES):
            pass


def add_check(check: Mapping[str, Any], folder: Path, *, draft: bool = False) -> None:
    """Write the figure of a check into the folder's figures, and the section of it into its report, if there is one."""
    figures, report = folder / FIGURES, folder / FILE_NAME
    figures.mkdir(exist_ok=True)
    picture = saved(draw_check(check), figures, draft=draft)
    page = report.read_text(encoding="utf-8") if report.is_file() else ""
    before, begin, rest = page.partition(MARKS[0])
    _, end, after = rest.partition(MARKS[1])
    if begin and end:
        section = template("check.html.j2").render(check=check, picture=picture)
        write_page(report, f"{before}{begin}{section}{end}{after}")


def answer_figures(question: str, content: Mapping[str, Any]) -> Iterable[Captioned]:
    """Return the figures of an answer, as its page shows them; `content` is that of its JSON file."""
    return ANSWERS[question](content) if question in ANSWERS else ()


def write_answer(answer: Any, question: str, content: Mapping[str, Any], page: Path, *, draft: bool = False) -> None:
    """Write the page of an `Answer`, and its figures into its folder; `content` is that of its JSON file."""
    figures = page.parent / FIGURES
    figures.mkdir(exist_ok=True)
    pictures = [saved(captioned, figures, draft=draft) for captioned in answer_figures(question, content)]
    write_page(page, template("answer.html.j2").render(a=answer, figures=pictures))
