"""What figures share: colours that colour-blind readers can distinguish, type sizes, new axes, captions, saved files.

Figures are made without pyplot, so no global registry keeps them alive and none needs closing.
"""

import base64
import io
import shutil
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.legend import Legend
from numpy.typing import ArrayLike
from PIL import Image

from strandline.report.html import said

BLACK, GREY = "#000000", "#8c8c8c"
ORANGE, SKY, GREEN, BLUE, RED, PURPLE = "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7"
CYCLE = (BLUE, RED, PURPLE, SKY, ORANGE)
"""Okabe and Ito's palette; green is reserved for observations."""
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
"""Line styles that go with CYCLE, for print without colour."""

SINGLE, DOUBLE = 88 / 25.4, 180 / 25.4
"""Widths of figures in inches: one column of a journal, and two."""
DOTS_PER_INCH, DRAFT_DOTS_PER_INCH, NOTEBOOK_DOTS_PER_INCH = 300, 60, 150
MARK_SIZE = 7.5
TO_MICROMETRES = 1e3

_STYLE: Any = {
    "font.size": 8.0, "axes.titlesize": 8.0, "axes.labelsize": 8.0, "lines.linewidth": 1.2,
    "legend.fontsize": 7.0, "xtick.labelsize": 7.0, "ytick.labelsize": 7.0,
    "legend.frameon": False, "axes.spines.top": False, "axes.spines.right": False,
    "pdf.fonttype": 42, "ps.fonttype": 42,  # TrueType: publishers refuse Type 3
}  # fmt: skip


class ShownFigure(Figure):
    """A figure that a notebook shows below the cell whose last line returns it."""

    def _repr_png_(self) -> bytes:
        with io.BytesIO() as file:
            self.savefig(file, format="png", dpi=NOTEBOOK_DOTS_PER_INCH)
            return file.getvalue()


class ShownAxes(Axes):
    """Axes that a notebook shows, with their whole figure, below the cell whose last line returns them."""

    def _repr_png_(self) -> bytes:
        figure: Any = self.figure.figure
        return ShownFigure._repr_png_(figure)


def styled() -> AbstractContextManager[None]:
    """Return the context in which figures are drawn."""
    return mpl.rc_context(_STYLE)


NEW: Any = None
"""Default of the `ax` of a function that is `drawn`: new ones."""
P = ParamSpec("P")
R = TypeVar("R")


def drawn(*size: float) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator: the function draws in this style, and without `ax` in new axes of this size, inches."""

    def decorated(draw: Callable[P, R]) -> Callable[P, R]:
        @wraps(draw)
        def in_style(*args: P.args, **kwargs: P.kwargs) -> R:
            with styled():
                if size and kwargs.get("ax") is None:
                    kwargs["ax"] = new_axes(*size)
                return draw(*args, **kwargs)

        return in_style

    return decorated


def new_axes(width: float, height: float) -> Axes:
    """Return the axes of a new figure; its size is in inches."""
    return new_figure(width, height).add_subplot(axes_class=ShownAxes)


def new_figure(width: float, height: float) -> Figure:
    """Return a new figure whose parts are laid out so that nothing overlaps; its size is in inches."""
    return ShownFigure(figsize=(width, height), layout="constrained")


def mark(ax: Axes, point: ArrayLike, colour: str, label: str, *, marker: str = "x", size: float = 8.0) -> None:
    """Draw one cross (or another marker) with a white rim, above everything else."""
    rim = [patheffects.withStroke(linewidth=3.6, foreground="white")]
    look: Any = {"color": colour, "markersize": size, "markeredgewidth": 2.0, "linestyle": "none", "fillstyle": "none"}
    ax.plot(*np.asarray(point, float)[:, None], marker=marker, label=label, zorder=10, path_effects=rim, **look)


def below(ax: Axes, *, columns: int = 3, **options: Any) -> None:
    """Put the legend of `ax`, if it has entries, under its x axis in as many columns as fit, at most `columns`."""
    if not ax.get_legend_handles_labels()[0]:
        return
    place = ax.get_subplotspec()
    beside = 1 if place is None else place.get_gridspec().ncols
    look: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.2), **options}
    _fitting(lambda ncols: ax.legend(ncols=ncols, **look), columns, ax.figure.bbox.width / beside)


def panel_grid(
    number: int, height: float, *, columns: int = 3, margin: float = 0.5, single: float = SINGLE, **options: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels, and the panels, in rows of at most `columns`.

    `height` of a row, `margin`, added to that of all rows, and the width of a figure with a `single` column are in
    inches; `options` are those of `Figure.subplots`.
    """
    columns = min(columns, number)
    rows = -(-number // columns)
    figure = new_figure(single if columns == 1 else DOUBLE, height * rows + margin)
    panels: list[Axes] = figure.subplots(rows, columns, squeeze=False, **options).ravel().tolist()
    for ax in panels[number:]:
        ax.remove()
    return figure, panels[:number]


def labelled(*axes: Axes) -> dict[str, Any]:
    """Return what the legends of axes would show: handles by label."""
    return {label: handle for ax in axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}


def legend_under(figure: Figure | SubFigure, entries: Mapping[str, Any], *, columns: int = 4) -> None:
    """Put a legend of `entries`, handles by label, under all panels in as many columns as fit, at most `columns`."""

    def legend(ncols: int) -> Legend:
        return figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=ncols)

    if entries:
        _fitting(legend, min(columns, len(entries)), figure.bbox.width)


def _fitting(legend: Callable[[int], Legend], columns: int, width: float) -> None:
    """Make a legend with as many columns as fit `width`, in pixels."""
    for ncols in range(columns, 0, -1):
        made = legend(ncols)
        if ncols == 1 or made.get_window_extent().width <= width:
            return
        made.remove()


def mark_doubt(figure: Figure, why: str) -> None:
    """Write across the top of a figure that what it shows is unreliable, and why."""
    wide = max(30, int(13 * figure.get_figwidth()))
    text = "\n".join(textwrap.wrap(f"DO NOT TRUST THIS POSTERIOR: {why}", wide))
    frame = {"boxstyle": "square,pad=0.35", "facecolor": "#fff1e8", "edgecolor": RED}
    with styled():
        figure.suptitle(text, color="#a03c00", fontsize=MARK_SIZE, fontweight="bold", bbox=frame)


def root_scale(top: float) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Return a scale for log densities and its inverse: signed square roots of the distance from `top`.

    Under a normal density it is linear in the number of standard deviations from the mode, so that the neighbourhood
    of the mode stays visible even if the log density falls by thousands elsewhere.
    """
    return partial(_root, top=top), partial(_root_inverse, top=top)


def _root(value: Any, *, top: float) -> Any:
    return np.sign(value - top) * np.sqrt(np.abs(value - top))


def _root_inverse(root: Any, *, top: float) -> Any:
    return top + root * np.abs(root)


def root_ticks(low: float, top: float, *, number: int = 4) -> tuple[list[float], list[str]]:
    """Return places and labels of ticks about equally spaced on the `root_scale`: `top` itself and round values."""
    drops = (top - low) * (np.arange(1, number + 1) / number) ** 2
    decades = 10.0 ** np.floor(np.log10(drops))
    steps = np.where(drops < 5.0 * decades, 0.2, 1.0) * decades
    places = [top, *(np.ceil((top - drops) / steps) * steps).tolist()]
    return places, [f"{place:g}".replace("-", "−") for place in (round(top, 2) + 0.0, *places[1:])]


def percent(fractions: Sequence[float]) -> str:
    """Return fractions as text: ``10, 50, 90 %``."""
    return ", ".join(f"{100 * p:g}" for p in fractions) + " %"


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
    of_posterior = captioned.section in OF_POSTERIOR or captioned.name.startswith(("predictive", "random_field"))
    if doubt is not None and of_posterior:
        mark_doubt(captioned.figure, doubt)
    return captioned


def saved(captioned: Captioned, folder: Path, *, draft: bool = False) -> dict[str, str]:
    """Save one figure, for print unless it is a draft, and return what the page needs of it."""
    figure, dots = captioned.figure, DRAFT_DOTS_PER_INCH if draft else DOTS_PER_INCH
    figure.set_dpi(dots)
    buffer = io.BytesIO()
    with styled():  # sets the kind of embedded font, and the size of tick labels, which decides their number
        if (layout := figure.get_layout_engine()) is not None:  # computed once: `savefig` would do it for each file
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
    known = {"name": captioned.name, "section": captioned.section, "caption": captioned.caption}
    return {**known, "data": data, "width": width}


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """Yield an empty folder that replaces `target` once it is filled; figures of other pages, as what_if.png, stay."""
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
    """Return figures as `saved` does, with `room` characters at most: the largest ones get half their resolution."""
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
