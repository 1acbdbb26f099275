"""A finished study as one self-contained HTML page, and its figures as files."""

import base64
import io
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from strandline.calibration import Calibration
from strandline.report.captioned import Captioned
from strandline.report.check import draw_check
from strandline.report.comparison import draw_comparison
from strandline.report.coverage import draw_coverage
from strandline.report.explore import Explore, explore
from strandline.report.figures import figure_groups
from strandline.report.lighter import fitted
from strandline.report.methods import BIBTEX, methods_paragraph
from strandline.report.next import draw_next
from strandline.report.plots.style import DOTS_PER_INCH, DRAFT_DOTS_PER_INCH, mark_doubt, styled
from strandline.report.specimens import draw_specimens
from strandline.report.warnings import reason_to_doubt, small_share
from strandline.report.what_if import draw_what_if
from strandline.text import with_sd
from strandline.typeset import RAISED, html_text, unit_text

__all__ = [
    "FIGURES",
    "PAGE_PIXELS_PER_INCH",
    "add_check",
    "remove_report",
    "template",
    "write_comparison",
    "write_coverage",
    "write_next",
    "write_report",
    "write_specimens",
    "write_what_if",
]

FILE_NAME = "report.html"
FIGURES = "figures"
PAGE_PIXELS_PER_INCH = 138
"""Pixels on the page per inch of a figure: two columns of a journal fill the page."""
MOST_CHARACTERS, TEXT = 5_000_000, 200_000
"""Size of a report above which its largest pictures get half their resolution; the part of it that is for text."""
ANSWERS = ("coverage_*", "next_*", "specimens_*", "what_if*")
"""Figures that other commands draw; a new report leaves them in place."""
OF_POSTERIOR = ("posterior", "uncertainty")
"""Sections whose figures show a posterior."""
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
    it is the same but for the section that they make.

    Args:
        calibration: Result of the calibration.
        summary: Content of summary.json.
        study_text: Text of study.yaml, shown as it is.
        truth: Inputs of a synthetic observation.
        folder: Folder of the study.
        check: Content of check.json if it belongs to this posterior.
        pictures: Pictures behind the interfaces by condition, with size, place and address.
        on_failure: Function called with the name and the error of figures that cannot be drawn or saved; the page is
            then written without them. By default, the first such error is raised and the old report stays.
    """
    doubt = reason_to_doubt(calibration, check)
    groups: dict[str, Iterator[Captioned]] = {
        name: (_marked(captioned, doubt) for captioned in figures)
        for name, figures in figure_groups(calibration, truth).items()
    }
    if check is not None:
        groups["check"] = _check(check)
    failed: list[str] = []

    def note(name: str, error: Exception) -> None:
        if on_failure is None:
            raise error
        failed.append(f"{name} could not be written: {type(error).__name__}: {error}")
        on_failure(name, error)

    section = _explored(calibration, truth, pictures, note)
    shown = _all_saved(groups, folder / FIGURES, note, draft=calibration.settings.draft)
    shown = _fitted(shown, MOST_CHARACTERS - TEXT - (section.size if section else 0))
    picture = next((item for item in shown if item["name"] == "check"), None)
    page = template("report.html.j2").render(
        s={**summary, "warnings": [*failed, *summary["warnings"]]},
        figures=[item for item in shown if item is not picture],
        study_text=study_text,
        methods=methods_paragraph(summary),
        bibtex=BIBTEX.format(version=summary["version"]),
        fit=calibration.settings.fit,
        check=check,
        picture=picture,
        explore=section,
    )
    return _replaced(folder, page)


def _explored(
    calibration: Calibration,
    truth: Mapping[str, float] | None,
    pictures: Mapping[str, Mapping[str, Any]] | None,
    note: Callable[[str, Exception], None],
) -> Explore | None:
    """Return the section that scripts make; an error costs the page no more than this section."""
    try:
        return explore(calibration, truth, pictures)
    except Exception as error:
        note("the section Explore", error)
        return None


def _all_saved(
    groups: Mapping[str, Iterable[Captioned]], target: Path, note: Callable[[str, Exception], None], *, draft: bool
) -> list[dict[str, str]]:
    """Save the figures and return what the page needs of each; an error ends its group but not the others."""
    shown: list[dict[str, str]] = []
    try:
        with _whole_folder(target) as partial:
            for name, figures in groups.items():
                try:
                    shown += (_saved(captioned, partial, draft=draft) for captioned in figures)
                except Exception as error:
                    note(f"{FIGURES} ({name})", error)
    except OSError as error:
        note(FIGURES, error)
    return shown


def _fitted(shown: list[dict[str, str]], room: int) -> list[dict[str, str]]:
    """Return what the page needs of each figure, with pictures that fit into so many characters."""
    data = fitted([item["data"] for item in shown], room)
    return [{**item, "data": one} for item, one in zip(shown, data, strict=True)]


def _check(check: Mapping[str, Any]) -> Iterator[Captioned]:
    yield draw_check(check)


def remove_report(folder: Path) -> None:
    """Remove `folder`/report.html and the figures of an earlier result; those that other commands drew stay."""
    (folder / FILE_NAME).unlink(missing_ok=True)
    if (folder / FIGURES).is_dir():
        with _whole_folder(folder / FIGURES):
            pass


def add_check(check: Mapping[str, Any], folder: Path, *, draft: bool = False) -> None:
    """Write figures/check.png and .pdf of `folder`, and put the section of the check into its report, if there is one.

    Args:
        check: Content of check.json.
        folder: Folder of the study.
        draft: Whether a coarse PNG is enough.
    """
    figures, report = folder / FIGURES, folder / FILE_NAME
    figures.mkdir(exist_ok=True)
    picture = _saved(draw_check(check), figures, draft=draft)
    page = report.read_text(encoding="utf-8") if report.is_file() else ""
    before, begin, rest = page.partition(MARKS[0])
    _, end, after = rest.partition(MARKS[1])
    if begin and end:
        section = template("check.html.j2").render(check=check, picture=picture)
        _replaced(folder, f"{before}{begin}{section}{end}{after}")


def write_coverage(content: Mapping[str, Any], folder: Path, *, draft: bool = False) -> Path:
    """Write the figures of repeated experiments, and a self-contained page about them; return the page's path.

    Args:
        content: Content of coverage.json.
        folder: Folder of the study.
        draft: Whether coarse PNGs are enough.
    """
    return _write_answer("coverage", content, draw_coverage(content), folder, draft=draft)


def write_next(content: Mapping[str, Any], folder: Path, *, draft: bool = False) -> Path:
    """Write the figures of candidates for the next experiment, and a page about them; return the page's path.

    Args:
        content: Content of next.json.
        folder: Folder of the study.
        draft: Whether coarse PNGs are enough.
    """
    return _write_answer("next", content, draw_next(content), folder, draft=draft)


def write_what_if(content: Mapping[str, Any], folder: Path, *, draft: bool = False) -> Path:
    """Write the figure of other assumptions, and a self-contained page about them; return the page's path.

    Args:
        content: Content of what-if.json.
        folder: Folder of the study.
        draft: Whether coarse PNGs are enough.
    """
    return _write_answer("what-if", content, [draw_what_if(content)], folder, draft=draft)


def write_comparison(content: Mapping[str, Any], folder: Path, *, draft: bool = False) -> Path:
    """Write the figures of a comparison of models, and a self-contained page about it; return the page's path.

    Args:
        content: Content of compare.json.
        folder: Folder of the result.
        draft: Whether coarse PNGs are enough.
    """
    return _write_answer("compare", content, draw_comparison(content), folder, draft=draft)


def _write_answer(
    name: str, content: Mapping[str, Any], drawn: Iterable[Captioned], folder: Path, *, draft: bool
) -> Path:
    """Write figures into `folder`/figures, and a self-contained page with them; return the page's path."""
    figures = folder / FIGURES
    figures.mkdir(exist_ok=True)
    pictures = [_saved(captioned, figures, draft=draft) for captioned in drawn]
    return _replaced(folder, template(f"{name}.html.j2").render(c=content, figures=pictures), f"{name}.html")


def write_specimens(content: Mapping[str, Any], folder: Path, *, draft: bool = False) -> Path:
    """Write the figures of many specimens, and a self-contained page about them; return the page's path.

    Args:
        content: Content of specimens.json.
        folder: Folder of the study.
        draft: Whether coarse PNGs are enough.
    """
    return _write_answer("specimens", content, draw_specimens(content), folder, draft=draft)


def _replaced(folder: Path, page: str, name: str = FILE_NAME) -> Path:
    """Write the page whole or not at all."""
    unfinished = folder / f".{name}.partial"
    unfinished.write_text(page, encoding="utf-8")
    return unfinished.replace(folder / name)


@contextmanager
def _whole_folder(target: Path) -> Iterator[Path]:
    """Yield an empty folder that replaces `target` once it is filled, and is removed if that fails."""
    partial = target.with_name(f".{target.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    try:
        yield partial
        for pattern in ANSWERS:
            for other in target.glob(pattern):
                shutil.copy2(other, partial)
        shutil.rmtree(target, ignore_errors=True)
        partial.rename(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _marked(captioned: Captioned, doubt: str | None) -> Captioned:
    """Return the figure, with the doubt written on it if it shows a posterior."""
    if doubt is not None and (captioned.section in OF_POSTERIOR or captioned.name.startswith("predictive")):
        mark_doubt(captioned.figure, doubt)
    return captioned


def _saved(captioned: Captioned, folder: Path, *, draft: bool = False) -> dict[str, str]:
    """Save one figure, for print unless it is a draft, and return what the page needs of it.

    The layout is computed once for both files; otherwise `savefig` would compute it for each and draw twice.
    """
    figure, dots = captioned.figure, DRAFT_DOTS_PER_INCH if draft else DOTS_PER_INCH
    figure.set_dpi(dots)
    buffer = io.BytesIO()
    with styled():  # sets the kind of embedded font, and the size of tick labels, which decides their number
        if (layout := figure.get_layout_engine()) is not None:
            layout.execute(figure)
            figure.set_layout_engine(None)
        pdf = folder / f"{captioned.name}.pdf"
        if draft:
            pdf.unlink(missing_ok=True)  # one of an earlier result
        else:
            figure.savefig(pdf, metadata={"CreationDate": None})
        figure.savefig(buffer, format="png", dpi=dots)
    (folder / f"{captioned.name}.png").write_bytes(buffer.getvalue())
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    width = f"{PAGE_PIXELS_PER_INCH * figure.get_figwidth():.0f}"
    shown = {"caption": captioned.caption, "data": data, "width": width}
    return {"name": captioned.name, "section": captioned.section, **shown}


def template(name: str, *, package: str = "strandline.report") -> Any:
    """Return a template of a package; it may include those of reports, such as their style."""
    return _environment(package).get_template(name)


@lru_cache(maxsize=4)
def _environment(package: str) -> Environment:
    """Return the environment that caches the compiled templates of a package."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("strandline.report")]),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["g"] = _figures
    environment.filters["unit"] = lambda unit: unit_text(unit) or "–"
    environment.filters["with_sd"] = lambda item: with_sd(item["mean"], item["sd"])
    environment.filters["symbol"] = lambda symbol: Markup(html_text(symbol))
    environment.filters["percent"] = lambda value: f"{value:.1%}"
    environment.filters["small_share"] = small_share
    return environment


def _figures(value: float | list[float] | None, digits: int = 4) -> str:
    """Return a number, or several, as text with this many digits."""
    if isinstance(value, list):
        return ", ".join(_figures(item, digits) for item in value)
    return "–" if value is None else _unbroken(f"{value:.{digits}g}")


def _unbroken(number: str) -> str:
    """Return a number that no line break splits: a proper minus, and a power of ten instead of ``e-05``."""
    mantissa, _, power = number.partition("e")
    raised = f"\u00a0·\u00a010{str(int(power)).translate(RAISED)}" if power else ""
    return mantissa.replace("-", "−") + raised
