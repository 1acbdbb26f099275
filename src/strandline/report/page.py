"""A finished study as one self-contained HTML page, and its figures as files."""

import base64
import io
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from strandline.calibrate import Calibration
from strandline.report.figures import Captioned, draw_figures

__all__ = ["write_report"]

FILE_NAME = "report.html"


def write_report(
    calibration: Calibration,
    summary: Mapping[str, Any],
    *,
    study_text: str,
    truth: Mapping[str, float] | None,
    folder: Path,
) -> Path:
    """Write `folder`/figures (PNG and PDF) and `folder`/report.html; return the page's path.

    The page needs nothing from outside: pictures are inside it, there is no script and no link to load.

    Args:
        calibration: what was found.
        summary: the figures of summary.json.
        study_text: study.yaml, shown as it is.
        truth: the inputs of a synthetic observation.
        folder: the study's.
    """
    with _whole_folder(folder / "figures") as partial:
        shown = [_saved(captioned, partial) for captioned in draw_figures(calibration, truth)]
    page = _template().render(s=summary, figures=shown, study_text=study_text)
    unfinished = folder / f".{FILE_NAME}.partial"
    unfinished.write_text(page, encoding="utf-8")
    return unfinished.replace(folder / FILE_NAME)


@contextmanager
def _whole_folder(target: Path) -> Iterator[Path]:
    """Give an empty folder that replaces `target` once it is filled, and vanishes if it cannot be."""
    partial = target.with_name(f".{target.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    try:
        yield partial
        shutil.rmtree(target, ignore_errors=True)
        partial.rename(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _saved(captioned: Captioned, folder: Path) -> dict[str, str]:
    """Save one figure for print and return what the page needs of it."""
    captioned.figure.savefig(folder / f"{captioned.name}.pdf", metadata={"CreationDate": None})
    buffer = io.BytesIO()
    captioned.figure.savefig(buffer, format="png", dpi=160)
    (folder / f"{captioned.name}.png").write_bytes(buffer.getvalue())
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return {"name": captioned.name, "section": captioned.section, "caption": captioned.caption, "data": data}


def _template() -> Any:
    environment = Environment(
        loader=PackageLoader("strandline.report"),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["g"] = lambda value, digits=4: "–" if value is None else f"{value:.{digits}g}"
    environment.filters["percent"] = lambda value: f"{value:.1%}"
    return environment.get_template("report.html.j2")
