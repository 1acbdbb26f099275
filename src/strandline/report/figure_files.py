"""The figures of a report: their places and captions, their files, and their pictures on the page."""

import base64
import io
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from PIL import Image

from strandline.report.html import said
from strandline.report.plots.style import DOTS_PER_INCH, DRAFT_DOTS_PER_INCH, mark_doubt, styled

PAGE_PIXELS_PER_INCH = 138
"""Pixels on the page per inch of a figure: two columns of a journal fill the page."""
OF_POSTERIOR = ("posterior", "uncertainty")
"""Sections whose figures show a posterior."""


@dataclass(frozen=True, eq=False)
class Captioned:
    """A figure of a report, or axes that fill it, with the name of its file, its section and what it shows."""

    name: str
    section: str
    caption: str
    drawing: Any

    @classmethod
    def of(cls, name: str, section: str, drawing: Any, *, of: str = "", **facts: Any) -> "Captioned":
        """Return a figure with its caption from the template; one of several has what it is `of` in its name too."""
        caption = said(name, **({"of": of} if of else {}), **facts)
        return cls(f"{name}_{of}" if of else name, section, caption, drawing)

    @property
    def figure(self) -> Figure:
        found: Figure = self.drawing.get_figure(root=True)
        return found


def marked(captioned: Captioned, doubt: str | None) -> Captioned:
    """Return the figure, with the doubt written on it if it shows a posterior."""
    if doubt is not None and (captioned.section in OF_POSTERIOR or captioned.name.startswith("predictive")):
        mark_doubt(captioned.figure, doubt)
    return captioned


def saved(captioned: Captioned, folder: Path, *, draft: bool = False) -> dict[str, str]:
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


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """Yield an empty folder that replaces `target` once it is filled, and is removed if that fails.

    Figures of the other pages beside `target`, such as what_if.png of what-if.html, stay.
    """
    partial = target.with_name(f".{target.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    try:
        yield partial
        for figure in of_other_pages(target):
            if not (partial / figure.name).exists():
                shutil.copy2(figure, partial)
        shutil.rmtree(target, ignore_errors=True)
        partial.rename(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def of_other_pages(figures: Path) -> set[Path]:
    """Return the figures in a study's folder of them that belong to pages beside the report."""
    pages = (page.stem.replace("-", "_") for page in figures.parent.glob("*.html"))
    return {figure for page in pages for figure in figures.glob(f"{page}*")}


def fitted(shown: Iterable[dict[str, str]], room: int) -> list[dict[str, str]]:
    """Return what the page needs of each figure, as `saved` returns it, with pictures of at most `room` characters.

    The largest ones have half their resolution, or all have, so that the page stays small enough to be sent.
    """
    out = list(shown)
    total = sum(len(item["data"]) for item in out)
    for i in sorted(range(len(out)), key=lambda i: -len(out[i]["data"])):
        if total <= room:
            break
        smaller = _halved(out[i]["data"])
        total -= len(out[i]["data"]) - len(smaller)
        out[i] = {**out[i], "data": smaller}
    return out


def _halved(data: str) -> str:
    """Return a picture, PNG as base64, with half of its pixels in each direction, unless that needs more bytes."""
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
        picture.reduce(2).save(buffer, format="png", optimize=True)
    return min(base64.b64encode(buffer.getvalue()).decode("ascii"), data, key=len)
