"""Points in their order: text with two or more columns, and NumPy arrays."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from strandline.readers.contents import Contents
from strandline.readers.options import Reading
from strandline.readers.problems import Unreadable, refused

__all__ = ["SD", "missing", "read_npy", "read_text", "require_end"]

SD = "sd of each point"
"""Name of the point data that hold standard deviations, in the file's unit."""
Row = tuple[int, list[str]]
"""Number of a line and its fields."""


def read_text(path: Path, how: Reading, name: str) -> Contents:
    """Return the points of a text file, one per line.

    A line of column names and lines that begin with # are skipped. Without `columns` each line holds x and y.
    """
    lines = _lines(path, name)
    separator = _separator(lines, how, name)
    rows = [(number, _fields(line, separator)) for number, line in enumerate(lines, 1)]
    comments = [fields for _, fields in rows if fields and fields[0].startswith("#")]
    rows = [(number, fields) for number, fields in rows if any(fields) and not fields[0].startswith("#")]
    header = [[field.lstrip("# ") for field in fields if field != "#"] for fields in comments[-1:]]
    names = rows[0][1] if rows else []
    if how.decimal == ",":
        rows = _with_points(name, rows)
    if rows and not any(_is_number(field) for field in rows[0][1]):
        header, rows = [names], rows[1:]
    if not rows:
        raise refused(f"{name} holds no points", None, "two columns x, y with one point per line")
    titles = header[0] if header else []
    if how.columns is None and titles is names and [title.lower() for title in titles[:2]] == ["y", "x"]:
        raise refused(
            f"{name} names its columns {titles[0]}, {titles[1]}",
            " ".join(titles),
            "x before y, or `columns`",
            f"Give `columns: [{titles[1]}, {titles[0]}]`.",
        )
    if how.columns is None and how.field is None and how.sd is None:
        return Contents(np.array([_point(name, number, fields, titles) for number, fields in rows]))
    by_name = any(isinstance(column, str) for column in (*(how.columns or ()), *(how.field or ()), how.sd))
    _require_one_width(name, rows, titles if by_name or titles is names else ())
    points = _columns(name, rows, titles, how.columns or (1, 2))
    moved = None if how.field is None else _columns(name, rows, titles, tuple(how.field))
    data = {} if how.sd is None else {SD: _columns(name, rows, titles, (how.sd,))[:, 0]}
    return Contents(points, data=data, displacement=moved)


def read_npy(path: Path, how: Reading, name: str) -> Contents:
    """Return the points of an array of numbers (point, column); pickled objects are not read."""
    try:
        array = np.load(path, allow_pickle=False, mmap_mode=None)
    except (ValueError, EOFError, OSError, MemoryError) as error:
        raise refused(f"{name} cannot be read", str(error), "an array of numbers saved by numpy.save") from None
    if not (isinstance(array, np.ndarray) and array.ndim == 2 and array.dtype.kind in "fiu" and len(array)):
        found = f"{array.dtype} of the shape {array.shape}" if isinstance(array, np.ndarray) else "an archive"
        raise refused(f"{name} holds no points", found, "an array of numbers (point, 2)")
    if how.columns is None and array.shape[1] != 2 and how.field is None and how.sd is None:
        remedy = _say_columns([], array.shape[1])
        raise refused(f"{name} holds no points", f"the shape {array.shape}", "two columns x, y", remedy)
    points = _of_array(name, array.astype(float), how.columns or (1, 2))
    moved = None if how.field is None else _of_array(name, array.astype(float), tuple(how.field))
    data = {} if how.sd is None else {SD: _of_array(name, array.astype(float), (how.sd,))[:, 0]}
    return Contents(points, data=data, displacement=moved)


def _of_array(
    name: str, array: Float[np.ndarray, "point column"], columns: Sequence[str | int]
) -> Float[np.ndarray, "point chosen"]:
    for column in columns:
        if isinstance(column, str) or column > array.shape[1]:
            found, remedy = f"{array.shape[1]} columns", _say_columns([], array.shape[1])
            raise refused(f"{name} has no column {column}", found, "columns by number from 1", remedy)
    return np.ascontiguousarray(array[:, [int(column) - 1 for column in columns]])


def _columns(
    name: str, rows: Sequence[Row], titles: Sequence[str], columns: Sequence[str | int]
) -> Float[np.ndarray, "point column"]:
    """Return columns of a table."""
    chosen = [_place(name, column, titles, rows[0][1], pair=len(columns) > 1) for column in columns]
    for number, fields in rows:
        if len(fields) <= max(chosen) or not all(_is_number(fields[k]) for k in chosen):
            raise refused(
                f"{name} has no point in line {number}",
                " ".join(fields),
                f"numbers in the columns {', '.join(map(str, columns))}",
            )
    return np.array([[float(fields[k]) for k in chosen] for _, fields in rows])


def _place(name: str, column: str | int, titles: Sequence[str], fields: Sequence[str], *, pair: bool) -> int:
    if isinstance(column, int):
        return column - 1
    if list(titles).count(column) != 1:
        shown = ", ".join(titles) or "no line of column names"
        remedy = _say_columns(titles, len(fields)) if pair else "Name the column in `sd`, or give its number from 1."
        raise refused(f"{name} has no column {column}", shown, f"one column called {column}", remedy)
    return titles.index(column)


def _with_points(name: str, rows: Sequence[Row]) -> list[Row]:
    """Return rows with decimal commas replaced by decimal points."""
    for number, fields in rows:
        odd = next((field for field in fields if _is_number(field) and "." in field), None)
        if odd is not None:
            expected = 'decimal commas, as `decimal: ","` says'
            raise refused(f"{name} has a decimal point in line {number}", odd, expected, "Remove one of the two.")
    return [(number, [field.replace(",", ".") for field in fields]) for number, fields in rows]


def _require_one_width(name: str, rows: Sequence[Row], titles: Sequence[str]) -> None:
    """Refuse rows with more fields than there are column names, or than most rows have, and a last row with fewer."""
    counts = [len(fields) - (not fields[-1]) for _, fields in rows]  # a separator may end the line
    usual = max(set(counts), key=counts.count)
    most = len(titles) or usual
    for (number, fields), count in zip(rows, counts, strict=True):
        if count > most:
            raise refused(
                f"{name} has too many fields in line {number}",
                f"{count}: {' '.join(fields)}",
                f"{most}, as there are {'column names' if titles else 'in most lines'}",
                'With decimal commas give `decimal: ","`; else correct the line, or give `delimiter`.',
            )
    if counts[-1] < usual:
        number, fields = rows[-1]
        raise refused(f"{name} has too few fields in its last line, {number}", " ".join(fields), f"{usual}, as before")


def _separator(lines: Sequence[str], how: Reading, name: str) -> str:
    """Return the characters that separate fields: one, or several of which any one separates.

    Raises:
        Unreadable: a line has semicolons and commas, and no option says which are decimal.
    """
    if how.delimiter is not None:
        return how.delimiter
    if how.decimal == ",":
        return "; \t"
    for number, line in enumerate(lines, 1):
        if ";" in line and "," in line and not line.lstrip().startswith("#"):
            raise refused(
                f"{name} has semicolons and commas in line {number}",
                line.strip(),
                "one of them between the fields",
                'With decimal commas give `decimal: ","`; else say what separates the fields, e.g. `delimiter: ";"`.',
            )
    return ",; \t"


def _lines(path: Path, name: str) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise missing(path, name) from None
    except (OSError, UnicodeDecodeError) as error:
        raise refused(f"{name} cannot be read", str(error), "a readable text file") from None


def missing(path: Path, name: str) -> Unreadable:
    """Return the error for a missing file."""
    return refused(f"{name} is missing", str(path), "a file with two columns x, y", kind="result_missing")


def require_end(path: Path, name: str) -> None:
    """Refuse a program's result whose last line has no line break: its last number may be cut off.

    Raises:
        Unreadable: There is no line break; the message shows the last line.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise refused(f"{name} cannot be read", str(error), "a readable text file") from None
    if content.strip() and not content.endswith((b"\n", b"\r")):
        raise refused(
            f"{name} ends within a line",
            content.splitlines()[-1][-80:].decode("utf-8", "replace"),
            "a line break at the end; without it the last number may be cut off",
            "Have the program end the last line, or give `count`, the number of points.",
        )


def _fields(line: str, separator: str) -> list[str]:
    if len(separator) == 1:
        return [field.strip().strip('"') for field in line.split(separator)] if line.strip() else []
    for character in separator:
        line = line.replace(character, " ")
    return line.split()


def _point(name: str, number: int, fields: list[str], titles: Sequence[str]) -> tuple[float, float]:
    if len(fields) != 2 or not all(_is_number(field) for field in fields):
        remedy = _say_columns(titles, len(fields)) if len(fields) > 2 else "Correct the line, or what writes it."
        raise refused(f"{name} has no point in line {number}", " ".join(fields), "two numbers x, y", remedy)
    return float(fields[0]), float(fields[1])


def _say_columns(titles: Sequence[str], number: int) -> str:
    """Return the remedy for a table whose columns x and y must be named, with an example."""
    named = {title.lower(): title for title in titles if len(titles) == number and titles.count(title) == 1}
    pair = f"{named['x']}, {named['y']}" if {"x", "y"} <= named.keys() else "1, 2"
    return f"Say which of the {number} columns to take, by name or by number from 1, e.g. `columns: [{pair}]`."


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text.isascii() and "_" not in text
