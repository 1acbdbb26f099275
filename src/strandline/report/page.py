"""A finished study as one self-contained HTML page, and its figures as files; the pages of answers."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from strandline.calibration import Calibration
from strandline.design import KINDS
from strandline.report import plots
from strandline.report.explore import explore
from strandline.report.figure_files import Captioned, fitted, marked, saved, whole_folder
from strandline.report.figures import figure_groups
from strandline.report.html import one_line, template, write_page
from strandline.report.warnings import LOO_LIMIT, reason_to_doubt


def draw_check(check: Mapping[str, Any]) -> Captioned:
    """Return the figure of a check of the posterior, check.json."""
    true, surrogate = (np.array(check["particles"][name], float) for name in ("true", "surrogate"))
    bands = {item["condition"]: plots.OffsetBand.of(item["offset"]) for item in check["interfaces"]}
    return Captioned.of("check", "check", plots.plot_check(true, surrogate, bands))


FILE_NAME = "report.html"
FIGURES = "figures"
MOST_CHARACTERS, TEXT = 5_000_000, 200_000
"""Size of a report above which its largest pictures get half their resolution; the part of it that is for text."""
MARKS = ("<!-- check of the posterior -->\n", "<!-- end of the check -->\n")
"""Comments on the page that enclose the section of a check."""


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
    doubt = reason_to_doubt(calibration, check, far=bool(summary["nearest"]["message"]))
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
        fit=calibration.settings.fit,
        check=check,
        picture=picture,
        explore=section,
        batch_kinds=KINDS,
    )
    return write_page(folder / FILE_NAME, page)


def methods_paragraph(summary: Mapping[str, Any]) -> str:
    """Return a paragraph for the methods section of a paper, with the numbers of a study, from the content of
    summary.json.

    It also says what speaks against the result: runs that failed, a design that did not converge, a model that does not
    explain the observation.
    """
    return one_line(template("methods.txt.j2").render(s=summary))


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


def write_answer(answer: Any, *, draft: bool = False) -> None:
    """Write the page of an `Answer`, and its figures into the folder of the page."""
    figures = answer.page.parent / FIGURES
    figures.mkdir(exist_ok=True)
    pictures = [saved(captioned, figures, draft=draft) for captioned in answer.drawn(answer.content)]
    write_page(answer.page, template("answer.html.j2").render(a=answer, figures=pictures))
