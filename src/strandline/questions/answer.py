"""Answers to questions about a study: one form for the page, the notebook and the terminal, and their files."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from filelock import FileLock, Timeout
from markupsafe import escape
from matplotlib.figure import Figure

from strandline.calibration import FieldQuality
from strandline.foundations import InvalidStudy, html_table, html_text, unit_text, write_json
from strandline.posterior import Weighted
from strandline.report import Captioned, said, write_answer
from strandline.studies import told_if_unwritable

__all__ = ["Answer", "Part", "Symbol", "Table"]

TO_MICROMETRES = 1e3
MOST_ROWS = 20  # rows of a table that a terminal shows

Found = TypeVar("Found")


class Symbol(str):
    """The name of an input; on a page, the part after an underscore is a subscript."""

    def __html__(self) -> str:
        return html_text(str(self))


@dataclass(frozen=True)
class Table:
    """A table of text; in a short row, the last cell takes the place of all that are missing."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def __str__(self) -> str:
        number = len(self.head)
        shown = [self.head, *self.rows[:MOST_ROWS]]
        whole = [row if len(row) == number else [*row[:-1], *[""] * (number - len(row) + 1)] for row in shown]
        first, *widths = [max(map(len, column)) for column in zip(*whole, strict=True)]
        lines = [
            "  ".join([row[0].ljust(first), *(cell.rjust(width) for cell, width in zip(row[1:], widths, strict=False))])
            for row in shown
        ]
        more = len(self.rows) - MOST_ROWS
        return "\n".join([*(line.rstrip() for line in lines), *([f"{more} more on the page"] if more > 0 else [])])


@dataclass(frozen=True)
class Part:
    """A part of an answer: its table, sentences, each on a line of its own, and the name of its notes.

    The notes are on the page alone, from notes.html.j2.
    """

    heading: str
    table: Table | None = None
    lines: Sequence[str] = ()
    notes: str = ""


@dataclass(frozen=True, eq=False)
class Answer(Generic[Found]):
    """An answer to a question about a finished study, or about several.

    `lead` is what was asked, `sentence` the answer in one, `good` whether it is as one would wish. The most important
    one of its parts comes first. `content` is that of its JSON file (docs/reference/files.md), `found` the arrays
    behind it, `page` the path of its page, which its JSON file lies beside; `drawn` draws figures of the content.
    """

    title: str
    lead: str
    sentence: str
    remarks: Sequence[str]
    good: bool
    parts: Sequence[Part]
    content: dict[str, Any]
    found: Found
    page: Path
    drawn: Callable[[Mapping[str, Any]], Iterable[Captioned]]

    def __repr__(self) -> str:
        return f"<{self.title}: {self.sentence}>"

    def __str__(self) -> str:
        lines = ["", self.title, self.lead, self.sentence, *self.remarks]
        for part in self.parts:
            if part.table is not None or part.lines:
                lines += ["", part.heading, *([str(part.table)] if part.table is not None else []), *part.lines]
        return "\n".join([*lines, "", f"page: {self.page}"])

    def _repr_html_(self) -> str:
        rows = ([str(escape(cell)) for cell in row] for row in self.table.rows)
        return f"<p>{escape(self.sentence)}</p>{html_table(self.table.head, rows)}"

    @property
    def table(self) -> Table:
        """The most important table; without rows if there is none."""
        return next((part.table for part in self.parts if part.table is not None), Table((), ()))

    @property
    def figures(self) -> dict[str, Figure]:
        return {one.name: one.figure for one in self.drawn(self.content)}

    def written(self, *, draft: bool) -> "Answer[Found]":
        """Write the page, its figures and the JSON file into the page's folder, and return the answer.

        Raises:
            InvalidStudy: The folder cannot be written to.
        """
        folder = self.page.parent
        with told_if_unwritable(folder):
            folder.mkdir(parents=True, exist_ok=True)
            write_answer(self, draft=draft)
            write_json(self.page.with_suffix(".json"), self.content)
        return self


remark = partial(said, page="remarks.txt.j2")


def digits(value: float, number: int = 4) -> str:
    """Return a value with so many digits, and a power of ten only below 0.0001 and from a million."""
    return f"{float(f'{value:.{number}g}'):.{max(number, 6)}g}"


def label_and_unit(item: Mapping[str, Any]) -> tuple[Symbol, str]:
    """Return an input's label, and its unit."""
    return Symbol(item["label"]), unit_text(item["unit"]) or "–"


def moments(draws: Weighted, i: int, quantiles: Mapping[str, float]) -> dict[str, float]:
    """Return mean, standard deviation and quantiles, probabilities by name, of an input."""
    found = np.quantile(draws.draws[:, i], [*quantiles.values()], weights=draws.weights, method="inverted_cdf")
    values = dict(zip(quantiles, found.tolist(), strict=True))
    return {"mean": float(draws.mean[i]), "sd": float(draws.sd[i]), **values}


def facts_of_surrogate(runs: int, quality: FieldQuality) -> dict[str, Any]:
    """Return how good the surrogate of the interface is, in µm."""
    return {
        "runs": runs,
        "hidden_um": TO_MICROMETRES * quality.hidden,
        "error_um": {"median": TO_MICROMETRES * quality.median, "q95": TO_MICROMETRES * quality.q95},
        "beyond": quality.beyond,
    }


@dataclass(frozen=True)
class LineFile:
    """A file with one JSON object in each line; it need not exist."""

    path: Path

    def entries(self) -> list[dict[str, Any]]:
        """Return the objects in their order; remove a last line that was not written to its end."""
        if not self.path.is_file():
            return []
        content = self.path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            with self.path.open("r+b") as file:
                file.truncate(len(whole))
        return [_parsed(line) for line in whole.splitlines()]

    def append(self, entry: Mapping[str, Any]) -> None:
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    @contextmanager
    def held(self, command: str, results: str) -> Iterator[None]:
        """Keep others from writing to the file, one by `command`, e.g. `strandline coverage`, with these `results`.

        Raises:
            InvalidStudy: Another command holds the file, or its folder cannot be written to.
        """
        lock = FileLock(self.path.with_suffix(f"{self.path.suffix}.lock"))
        with told_if_unwritable(self.path.parent):
            try:
                lock.acquire(timeout=0)
            except Timeout:
                what, value = f"{self.path} is in use", f"another `{command}` of this study"
                remedy = f"Wait for the other one to end, or stop it; its {results} are kept."
                raise InvalidStudy(what, value=value, expected="one at a time", remedy=remedy) from None
        try:
            yield
        finally:
            lock.release()


def _parsed(line: bytes) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
