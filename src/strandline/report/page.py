"""Pages of one HTML file that loads nothing: a study, with its figures as files; an answer; a picture to mark."""

import base64
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from jaxtyping import Float
from markupsafe import Markup
from PIL import Image

from strandline.calibration import Calibration
from strandline.design import KINDS
from strandline.foundations import unfit
from strandline.imaging import Clicks, as_json
from strandline.report import plots
from strandline.report.explore import explore
from strandline.report.figures import figure_groups
from strandline.report.html import embedded, one_line, save_page, script_hash, template
from strandline.report.plots.style import Captioned, fitted, marked, saved, whole_folder
from strandline.report.savers import Savers
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
        if calibration.problem.space.scalars:
            section = explore(calibration, truth, pictures)
    except Exception as error:
        note("the section Explore", error)
    shown = _all_saved(groups, folder / FIGURES, note, draft=calibration.settings.draft)
    shown = fitted(shown, MOST_CHARACTERS - TEXT - (section["size"] if section else 0))
    picture = next((item for item in shown if item["name"] == "check"), None)
    content = _without_bad_comparison({**summary, "warnings": [*failed, *summary["warnings"]]})
    texts = {"study_text": study_text, "methods": methods_paragraph(summary), "batch_kinds": KINDS}
    parts = {"figures": [item for item in shown if item is not picture], "picture": picture, "explore": section}
    page = template("report.html.j2").render(s=content, **texts, **parts, fit=calibration.settings.fit, check=check)
    return save_page(folder / FILE_NAME, page)


def methods_paragraph(summary: Mapping[str, Any]) -> str:
    """Return a paragraph for the methods section of a paper, from summary.json; it says what speaks against it, too."""
    return one_line(template("methods.txt.j2").render(s=summary))


def _without_bad_comparison(summary: Mapping[str, Any]) -> Mapping[str, Any]:
    """Leave out the second posterior, from a surrogate of the log-likelihood, if this is bad near the mode."""
    error = next((one["loo_rms_near_mode"] for one in summary["measures"].values()), 0.0)
    return {**summary, "comparison": None} if error > LOO_LIMIT else summary


def _all_saved(
    groups: Mapping[str, Iterable[Captioned]], target: Path, note: Callable[[str, Exception], None], *, draft: bool
) -> list[dict[str, str]]:
    """Save the figures and return what the page needs of each; an error ends its group but not the others."""
    shown: list[dict[str, str]] = []
    try:
        with whole_folder(target) as folder, Savers(folder, draft=draft) as savers:
            saving: list[tuple[str, Future[dict[str, str]]]] = []
            for name, figures in groups.items():
                try:
                    saving += ((name, savers.save(captioned)) for captioned in figures)
                except Exception as error:
                    note(f"{FIGURES} ({name})", error)
            for name, one in saving:
                try:
                    shown.append(one.result())
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
        section = template("parts.html.j2").module.check(check, picture)
        save_page(report, f"{before}{begin}{section}{end}{after}")


def write_answer(answer: Any, *, draft: bool = False) -> None:
    """Write the page of an `Answer`, and its figures into the folder of the page."""
    figures = answer.page.parent / FIGURES
    figures.mkdir(exist_ok=True)
    pictures = [saved(captioned, figures, draft=draft) for captioned in answer.drawn(answer.content)]
    save_page(answer.page, template("answer.html.j2").render(a=answer, figures=pictures))


SCRIPTS = ("marks.js", "editing.js")
MOST_PIXELS, LONGEST_SIDE = 6_000_000, 8192
"""Largest picture that is shown as it is, in pixels."""
ENDS = (0.2, 99.8)
"""Percentiles of the values that become black and white."""
SAMPLED = 1_000_000
"""Number of values from which percentiles are taken."""
DARK = 0.1
"""Median below which a picture is brightened, as intensities of coherent light need it."""
BRIGHTEST_POWER = 0.25


def click_page(
    values: Float[np.ndarray, "row column"],
    *,
    name: str,
    sha256: str,
    clicks: Clicks | None = None,
    pixel_mm: tuple[float, float] | None = None,
    most_pixels: int = MOST_PIXELS,
) -> str:
    """Return the page for one picture of grey values, with a checksum of its file in hexadecimal, as HTML.

    The page saves a file that `strandline.imaging.clicks.read_clicks` reads, and nothing that it would refuse. `clicks`
    are what was marked before in the same picture. With width and height of a pixel, mm, the page shows the picture in
    its true shape; one of more than `most_pixels` is reduced.
    """
    height, width = values.shape
    if clicks is not None:
        clicks.require_picture(sha256, (width, height))
    png, factor = for_screen(values, most_pixels=most_pixels)
    given = {
        "name": name,
        "sha256": sha256.lower(),
        "size": [width, height],
        "factor": factor,
        "pixel_mm": pixel_mm,
        "file": f"{PurePath(name).stem}.path.json",
        "clicks": None if clicks is None else as_json(clicks),
        "picture": f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}",
    }
    folder = Path(__file__).parent / "templates" / "clicks"
    script = '\n"use strict";\n' + "\n".join((folder / part).read_text(encoding="utf-8") for part in SCRIPTS)
    own = {"given": embedded(given), "script": Markup(script), "policy": Markup(f"'{script_hash(script)}'")}
    return str(template("clicks.html.j2").render(**given, **own))


def for_screen(values: Float[np.ndarray, "row column"], *, most_pixels: int = MOST_PIXELS) -> tuple[bytes, int]:
    """Return a picture as PNG, and how many pixels each of its own stands for; values that are not finite are black."""
    height, width = values.shape
    factor = max(1, math.ceil(max(height, width) / LONGEST_SIDE))
    while math.ceil(height / factor) * math.ceil(width / factor) > most_pixels:
        factor += 1
    means = np.asarray(Image.fromarray(255 * _shaded(values)).reduce(factor))
    buffer = io.BytesIO()
    Image.fromarray(np.round(means).astype(np.uint8)).save(buffer, format="png")
    return buffer.getvalue(), factor


def _shaded(values: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
    """Return brightness from 0 to 1, single precision."""
    step = max(1, math.isqrt(values.size // SAMPLED))
    sample = values[::step, ::step]
    finite = sample[np.isfinite(sample)]
    if finite.size == 0:
        found = f"{values.shape[1]} × {values.shape[0]} px without a finite value"
        raise unfit("values of the picture", found, "numbers", "Look at the picture, its page and its scale.")
    low, middle, high = np.percentile(finite, [ENDS[0], 50, ENDS[1]])
    if not high > low:
        low, high = float(finite.min()), float(finite.max())
    reach = (high - low) or 1.0
    brightness, median = np.clip((values - low) / reach, 0.0, 1.0).astype(np.float32), (middle - low) / reach
    if 0 < median < DARK:
        brightness **= max(BRIGHTEST_POWER, math.log(3 * DARK) / math.log(median))
    return np.asarray(np.nan_to_num(brightness, copy=False))
