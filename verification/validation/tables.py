"""Tables of a verification: as numbers, as Markdown, in their place on a page; and how its scripts begin and end."""

import argparse
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

ROOT = Path(__file__).parents[2]
DOCS, EXAMPLES, STUDIES = ROOT / "docs", ROOT / "examples", ROOT / "studies"
OUTPUT = Path(__file__).parent / "output"
Cell = str | float | int | None


@dataclass(frozen=True)
class Table:
    """Rows of raw values, None for a cell without one, and the format of each column, ``s`` for text.

    On a page, the table is between ``<!-- table: name -->`` and ``<!-- end -->``.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    formats: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def markdown(self) -> str:
        lines = [self.columns, ["---"] * len(self.columns), *(self.cells(row) for row in self.rows)]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)

    def column(self, name: str) -> list[Cell]:
        k = self.columns.index(name)
        return [row[k] for row in self.rows]

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    def cells(self, row: Sequence[Cell]) -> list[str]:
        return ["" if x is None else format(x, form) for x, form in zip(row, self.formats, strict=True)]


def table(name: str, title: str, heading: str, rows: Iterable[Sequence[Any]], *, live: bool = False) -> Table:
    """Return a table, each row printed as soon as it is known if it is `live`.

    The heading has columns with their formats: ``mesh | elements {d} | error, % {.2f}``; without a format: text.
    """
    parts = [re.fullmatch(r"\s*(.*?)(?: \{(.+)\})?\s*", part) for part in heading.split("|")]
    columns, formats = (tuple(part[k] or "s" for part in parts if part) for k in (1, 2))
    made, found = Table(name, title, columns, formats, ()), []
    for row in rows:
        found.append(tuple(row))
        if live:
            print(*made.cells(found[-1]), sep="  ", flush=True)
    return Table(name, title, columns, formats, tuple(found))


def put_into_page(page: str, tables: Sequence[Table]) -> str:
    """Return the text of a page with each table in its place, of which it must have exactly one."""
    for one in tables:
        place = re.compile(rf"<!-- table: {one.name} -->\n.*?<!-- end -->", re.DOTALL)
        found = place.findall(page)
        if len(found) != 1:
            raise ValueError(f"the page has {len(found)} places for table {one.name!r}, not one")
        start, _, end = page.partition(found[0])
        page = f"{start}<!-- table: {one.name} -->\n{one.markdown()}\n<!-- end -->{end}"
    return page


def show(tables: Sequence[Table], *, page: Path | None = None, numbers: str = "", content: object = None) -> None:
    """Print the tables; put them into a page if one is given, and their numbers, or `content`, into a file beside it.

    Without a page, the numbers go into a file of this name in `OUTPUT`.
    """
    for one in tables:
        print(f"\n{one.title}\n\n{one.markdown()}", flush=True)
    if page is not None:
        page.write_text(put_into_page(page.read_text("utf-8"), tables), "utf-8")
    if numbers:
        OUTPUT.mkdir(exist_ok=True)
        (page or OUTPUT / "page").with_name(numbers).write_text(as_text(content or tables), "utf-8")


def write_study(folder: Path, content: Mapping[str, Any]) -> Path:
    """Write study.yaml into a folder, which is made if it does not exist, and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "study.yaml").write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), "utf-8")
    return folder


def as_text(content: object) -> str:
    """Return the text of a JSON file; of tables, by their names."""
    if isinstance(content, Sequence) and all(isinstance(one, Table) for one in content):
        content = {one.name: one.as_json() for one in content}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def arguments(doc: str | None, *, words: Any = None, **defaults: Any) -> argparse.Namespace:
    """Return the options of a script from their defaults: False is a flag, `Path` a path that is None by default.

    `words` says what words without an option stand for, or is a collection of those that are allowed.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    allowed = () if isinstance(words, str | None) else tuple(words)
    if words is not None:
        said = {"metavar": "WORD", "help": ", ".join(allowed).replace("%", "%%")} if allowed else {"metavar": words}
        parser.add_argument("words", nargs="*", default=[], **said)
    for name, default in defaults.items():
        if default is False:
            parser.add_argument(f"--{name}", action="store_true")
        elif default is Path:
            parser.add_argument(f"--{name}", type=Path)
        else:
            parser.add_argument(f"--{name}", type=type(default), default=default)
    found = parser.parse_args()
    if allowed and not set(found.words) <= set(allowed):
        parser.error(f"expected some of {', '.join(allowed)}, got {', '.join(found.words)}")
    return found


@contextmanager
def kept_or_scratch(folder: Path | None) -> Iterator[Path]:
    """Give a folder that is kept, or a new one that is removed at the end."""
    with TemporaryDirectory(prefix="strandline-") as scratch:
        chosen = folder or Path(scratch)
        chosen.mkdir(parents=True, exist_ok=True)
        yield chosen


def finish(missed: Iterable[str]) -> None:
    """Exit with 1 if aims are missed, and say which."""
    sys.exit("\n".join(missed) or 0)


def observed_orders(sizes: Sequence[float], errors: Sequence[float]) -> list[float | None]:
    """Return log(eₖ₋₁/eₖ)/log(hₖ₋₁/hₖ) for each mesh; None for the first."""
    contraction = np.log(np.abs(np.divide(errors[:-1], errors[1:])))
    return [None, *map(float, contraction / np.log(np.divide(sizes[:-1], sizes[1:])))]
