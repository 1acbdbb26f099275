"""Tables of a verification: as numbers, as Markdown, and in their place on a page."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

__all__ = ["Cell", "Table", "from_json", "observed_orders", "put_into_page"]

Cell = str | float | int | None


@dataclass(frozen=True)
class Table:
    """Rows of numbers.

    Args:
        name: Name on a page, where the table is between ``<!-- table: name -->`` and ``<!-- end -->``.
        title: Title, one line.
        columns: Headings with units.
        formats: Format specification of each column, ``s`` for text.
        rows: Raw values; None for a cell without a value.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    formats: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def markdown(self) -> str:
        """Return the table for a page."""
        lines = [self.columns, ["---"] * len(self.columns), *(self._cells(row) for row in self.rows)]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)

    def column(self, name: str) -> list[Cell]:
        """Return one column's raw values."""
        k = self.columns.index(name)
        return [row[k] for row in self.rows]

    def as_json(self) -> dict[str, Any]:
        """Return plain data that `from_json` reads."""
        return asdict(self)

    def _cells(self, row: Sequence[Cell]) -> list[str]:
        return ["" if x is None else format(x, form) for x, form in zip(row, self.formats, strict=True)]


def from_json(data: Mapping[str, Any]) -> Table:
    """Return the table that `Table.as_json` wrote."""
    rows = tuple(tuple(row) for row in data["rows"])
    return Table(data["name"], data["title"], tuple(data["columns"]), tuple(data["formats"]), rows)


def put_into_page(page: str, tables: Sequence[Table]) -> str:
    """Return the text of a page with each table in its place.

    Raises:
        ValueError: A table has no place, or more than one.
    """
    for table in tables:
        place = re.compile(rf"<!-- table: {table.name} -->\n.*?<!-- end -->", re.DOTALL)
        found = place.findall(page)
        if len(found) != 1:
            raise ValueError(f"the page has {len(found)} places for table {table.name!r}, not one")
        start, _, end = page.partition(found[0])
        page = f"{start}<!-- table: {table.name} -->\n{table.markdown()}\n<!-- end -->{end}"
    return page


def observed_orders(sizes: Sequence[float], errors: Sequence[float]) -> list[float | None]:
    """Return log(eₖ₋₁/eₖ)/log(hₖ₋₁/hₖ) for each mesh; None for the first."""
    contraction = np.log(np.abs(np.divide(errors[:-1], errors[1:])))
    return [None, *map(float, contraction / np.log(np.divide(sizes[:-1], sizes[1:])))]
