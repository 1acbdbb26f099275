"""Points in their order: text with two or more columns, NumPy arrays, and outlines of GeoJSON and labelme."""

import csv
import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from strandline.readers.contents import Contents, Unreadable, refused
from strandline.readers.options import Reading

Table = Float[np.ndarray, "point column"]
SD = "sd of each point"
"""Name of the point data that hold standard deviations, in the file's unit."""
AXES = (
    ("y", "x"),
    ("rows?|zeile|ligne|northing|ordinate", "col(umn)?s?|spalte|colonne|easting|abscissa"),
    ("(axis|dim|centroid)[-_: ]?0", "(axis|dim|centroid)[-_: ]?1"),
    ("points?[-_: ]1", "points?[-_: ]0"),
    ("vertical|lat(itude)?|top|elevation|height", "horizontal|lon(gitude)?|left|distance|width"),
)
"""Names of the vertical coordinate and of the horizontal one."""
UPRIGHT = ({("x", "y")}, {("x", "z")}, {("r", "z")}, {("c", "r")}, {("0", "1")}, {("1", "2")})
"""Letters or digits in which the names of x and y differ, if they differ in nothing else."""
DOWN = r"(?<![^\W_])(rows?|zeile|ligne|top)(?![^\W_])"
"""Names of the vertical coordinate of a picture, which counts downwards."""
ENDING = r"(\d+|pos\w*|coord\w*|index|mm|um|px)?"
"""What may follow such a name without a blank."""
COMMENT = re.compile(r"\s*(#(?!N/A|DIV/|VALUE!|REF!|NUM!|NAME\?|##+[\s,;]+([-+.\d]|##))|%|\*\s*$|\*+\s*([^\W\d]|\())")
"""Beginning of a comment; not errors of a spreadsheet, nor several # or *, which may be a number that overflowed."""
HEADING = re.compile(r"[ #%*]*(columns?\s*:)?\s*", re.IGNORECASE)
"""What may stand before the names of columns in a comment."""
MISSING = ("na", "n/a", "none", "null", "missing")
"""Words for a number that is missing."""
LABEL = re.compile(
    r"(contour|outline|curve|path|(poly)?line|segment|polygon|ring|shape|piece|part|group|set|object|particle|cell|roi|region"
    r"|layer|slice|image|sample|specimen|track|label|frame|step|time|t|id|no|nr|n|node|index|load|increment|iteration|cycle)s?(step|id|no|nr|number)?([\W_]|$)"
    r"|.*[\W_](id|no|nr|index|t|frame|step|time|number)$|$"
)
"""Name of a column that tells pieces or times apart."""
PAIRS = (("x", "y"), ("points:0", "points:1"), ("points_0", "points_1"), ("axis-1", "axis-0"))
"""Names of two columns x and y; of ParaView's and napari's as well."""
TOUCHING = re.compile(r"[+-]?(\d+|\d*\.\d*([eEdD][+-]?\d+)?)[+-]\d")
"""Two numbers without a blank between them."""
OTHER_MARKS = 'With decimal commas write semicolons between the numbers and give `decimal: ","`; else correct the line.'
CORRECT = "Correct the line, or what writes it."
NO_POINT = "If it holds no point, begin the line with #."
UNIT = re.compile(r"(?:[\W_]|^)(nm|[uµμ]m|mm|cm|m|px|pixels?|inch|(?<=\[)in|(?<=\()in)(?=[\W_]|$)", re.IGNORECASE)
"""Unit in the name of a column."""
DISPLACED = re.compile(r"(u|d|delta|disp\w*?)[-_: ]?[xy12]([\W_].*)?", re.IGNORECASE)
"""Name of a column of displacements."""
MOST_COORDINATES = 3
"""Most rows that may be coordinates instead of points."""
SHORTEST_PIECE = 3
"""Fewest points of each piece that a column of whole numbers tells apart."""
DrawnLine = tuple[Float[np.ndarray, "point 2"], bool]
CLOSED = {"polygon": True, "linestrip": False, "line": False}
CLOSED |= {"Polygon": True, "MultiPolygon": True, "LineString": False, "MultiLineString": False}
"""Shapes of labelme and geometries of GeoJSON → whether they are closed."""


@dataclass(frozen=True)
class TableRow:
    """A line of a table: its number in the file, from 1; its fields, without blanks and quotes around them; and whether
    a blank line or a comment stands between it and the row before.
    """

    number: int
    fields: tuple[str, ...]
    after_gap: bool = False

    def __str__(self) -> str:
        return " ".join(self.fields)


def read_text(path: Path, how: Reading, name: str) -> Contents:
    """Return the points of a text file, one per line.

    A line of column names and lines that begin with # or * are skipped. Without `columns` each line holds x and y.
    """
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    separator = _separator(lines, how, name)
    rows, comments = _rows(lines, separator)
    titles = rows[0].fields if rows and _is_header(rows[0]) else ()
    rows = rows[1:] if titles else rows
    if how.decimal == ",":
        rows = _with_points(name, rows)
    if not rows:
        raise refused(f"{name} holds no points", None, "two columns x, y with one point per line")
    by_name = any(isinstance(column, str) for column in (*(how.columns or ()), *(how.field or ()), how.sd))
    comment = _fields(comments[-1], separator) if comments else ()
    titles = titles or (comment if len(comment) == len(rows[0].fields) or by_name else ())
    _require_no_empty_end(name, lines, rows)
    _require_one_width(name, rows, titles)
    words = titles is comment and not by_name and not (len(titles) == 2 and _are_names(comment, separator))
    if how.columns is None:
        if len(rows[0].fields) == 2:
            _require_x_before_y(name, () if words else titles, comments)
        if len(rows[0].fields) != 2 and how.field is None and how.sd is None:
            raise _no_point(name, rows[0], titles)
    if not titles:
        _require_upright(name, len(rows), len(rows[0].fields))
    columns = how.columns or (1, 2)
    _require_whole_numbers_apart(name, rows, separator)
    points = _columns(name, rows, titles, columns)
    chosen = [_place(name, column, titles, rows[0], pair=True) for column in columns]
    _require_no_count(name, rows, chosen)
    if titles and not words:
        _require_places(name, [titles[k] for k in chosen], how)
    moved = None if how.field is None else _columns(name, rows, titles, tuple(how.field))
    data = {} if how.sd is None else {SD: _columns(name, rows, titles, (how.sd,))[:, 0]}
    pieces, numbers = _pieces(rows, titles, chosen, how), [row.number for row in rows]
    return Contents(points, data=data, displacement=moved, pieces=pieces, lines=numbers)


def read_npy(path: Path, how: Reading, name: str) -> Contents:
    """Return the points of an array of numbers (point, column); pickled objects are not read."""
    array = np.load(path, allow_pickle=False)
    if isinstance(array, np.ndarray) and array.ndim == 3 and array.shape[1] == 1:
        array = array[:, 0]  # as OpenCV finds contours
    if not (isinstance(array, np.ndarray) and array.ndim == 2 and array.dtype.kind in "fiu" and len(array)):
        found = f"{array.dtype} of the shape {array.shape}" if isinstance(array, np.ndarray) else "an archive"
        raise refused(f"{name} holds no points", found, "an array of numbers (point, 2)")
    if how.columns is None:
        remedy = "Give `columns: [1, 2]` for x, y; `columns: [2, 1]` for (row, column), as scikit-image finds contours."
        remedy = _say_columns((), array.shape[1]) if array.shape[1] != 2 else remedy
        raise refused(f"{name} does not say which column is x", f"the shape {array.shape}", "`columns`", remedy)
    points = _of_array(name, array.astype(float), how.columns)
    _require_upright(name, *array.shape)
    moved = None if how.field is None else _of_array(name, array.astype(float), tuple(how.field))
    data = {} if how.sd is None else {SD: _of_array(name, array.astype(float), (how.sd,))[:, 0]}
    return Contents(points, data=data, displacement=moved)


def _of_array(name: str, array: Table, columns: Sequence[str | int]) -> Float[np.ndarray, "point chosen"]:
    for column in columns:
        if isinstance(column, str) or column > array.shape[1]:
            found, remedy = f"{array.shape[1]} columns", _say_columns((), array.shape[1])
            raise refused(f"{name} has no column {column}", found, "columns by number from 1", remedy)
    return np.ascontiguousarray(array[:, [int(column) - 1 for column in columns]])


def _require_upright(name: str, rows: int, columns: int) -> None:
    """Refuse a table without names that has a row of x and a row of y."""
    if rows <= MOST_COORDINATES < columns:
        found, remedy = f"{rows} rows of {columns} numbers", "Save it transposed, as by `array.T`."
        raise refused(f"{name} seems to hold a row for each coordinate", found, "a row for each point", remedy)


def _rows(lines: Sequence[str], separator: str) -> tuple[list[TableRow], list[str]]:
    """Return the rows, and the comments before the first one."""
    rows: list[TableRow] = []
    comments: list[str] = []
    gap = False
    for number, line in enumerate(lines, 1):
        if not line.strip(" \t,;") or COMMENT.match(line):
            gap = bool(rows)
            comments += [HEADING.sub("", line, 1)] if line.strip(" #%*") and not rows else []
            continue
        rows.append(TableRow(number, _fields(line, separator), gap))
        gap = False
    return rows, comments


def _fields(line: str, separator: str) -> tuple[str, ...]:
    """Return the fields of a line, of which one in quotes may hold the separator; one may end the line."""
    text = " ".join(line.split()) if separator == " " else line
    found = tuple(field.strip() for field in next(csv.reader([text], delimiter=separator, skipinitialspace=True)))
    return found[:-1] if len(found) > 1 and not found[-1] else found


def _is_header(row: TableRow) -> bool:
    """Return whether a first row holds names: letters first, and none of what programs write for numbers."""
    bare = [field.strip("()[]<>%'") for field in row.fields]
    return all(re.match(r"[^\W\d]|$", one) and not _is_number(one) and one.lower() not in MISSING for one in bare)


def _columns(name: str, rows: Sequence[TableRow], titles: Sequence[str], columns: Sequence[str | int]) -> Table:
    chosen = [_place(name, column, titles, rows[0], pair=len(columns) > 1) for column in columns]
    for row in rows:
        if len(row.fields) <= max(chosen) or not all(_is_number(row.fields[k]) for k in chosen):
            raise _no_point(name, row, titles, columns)
    return np.array([[float(row.fields[k]) for k in chosen] for row in rows])


def _place(name: str, column: str | int, titles: Sequence[str], row: TableRow, *, pair: bool) -> int:
    if isinstance(column, int):
        return column - 1
    if list(titles).count(column) != 1:
        shown = ", ".join(titles) or "no line of column names"
        of_sd = "Name the column in `sd`, or give its number from 1."
        remedy = _say_columns(titles, len(row.fields)) if pair else of_sd
        raise refused(f"{name} has no column {column}", shown, f"one column called {column}", remedy)
    return list(titles).index(column)


def _with_points(name: str, rows: Sequence[TableRow]) -> list[TableRow]:
    for row in rows:
        odd = next((field for field in row.fields if _is_number(field) and "." in field), None)
        if odd is not None:
            expected = 'decimal commas, as `decimal: ","` says'
            raise refused(f"{name} has a decimal point in line {row.number}", odd, expected, "Remove one of the two.")
    return [TableRow(row.number, tuple(field.replace(",", ".") for field in row.fields), row.after_gap) for row in rows]


def _are_names(comment: Sequence[str], separator: str) -> bool:
    """Return whether a comment of two fields holds names of columns: of coordinates, or separated as numbers are."""
    named = [*map(_axes, comment)] in (["x", "y"], ["y", "x"])
    return named or separator != " " or all(len(word) == 1 for word in comment)


def _require_one_width(name: str, rows: Sequence[TableRow], titles: Sequence[str]) -> None:
    """Refuse rows with more or fewer fields than there are column names, or than most rows have."""
    counts = [len(row.fields) for row in rows]
    usual = len(titles) or max(set(counts), key=counts.count)
    for row, count in zip(rows, counts, strict=True):
        if count != usual:
            _require_no_count(name, rows, range(len(rows[-1].fields)))
            what = f"{name} has too {'many' if count > usual else 'few'} fields in line {row.number}"
            expected = f"{usual}, as there are {'column names' if titles else 'in most lines'}"
            otherwise = OTHER_MARKS if count > usual else CORRECT
            remedy = (NO_POINT if row is rows[0] and not titles else _way_out(row)) or otherwise
            raise refused(what, f"{count}: {row}", expected, remedy)


def _require_x_before_y(name: str, titles: Sequence[str], comments: Sequence[str]) -> None:
    """Refuse columns whose names, or else the last comment that names both, do not say that x comes first."""
    down = re.search(DOWN, " ".join(titles), re.IGNORECASE)
    if titles and (down or not _in_order(*titles)):
        turned, pair = _in_order(*titles[::-1]), [*map(_quoted, titles)] if len({*titles}) > 1 else ["1", "2"]
        first = ", ".join(pair[::-1] if turned else pair)
        remedy = f"Give `columns: [{first}]`{'' if turned or down else ', or the other way round, with x first'}."
        remedy += " Rows of a picture count downwards: write y upwards." if down else ""
        what, expected = f"{name} names its columns {titles[0]}, {titles[1]}", "x before y, or `columns`"
        raise refused(what, " ".join(titles), expected, remedy)
    orders = [(_axes(comment), comment) for comment in (*comments[::-1], " ".join(comments))]
    order, comment = next((found for found in orders if len(found[0]) > 1), ("", ""))
    if order == "yx" and not titles:
        remedy = "Give `columns: [2, 1]`, or `columns: [1, 2]` if x is the first column."
        raise refused(f"{name} has a comment that names y before x", comment, "x before y, or `columns`", remedy)


def _require_places(name: str, titles: Sequence[str], how: Reading) -> None:
    """Refuse columns whose names say that they are displacements, or in another unit than the study's."""
    moved = next((title for title in titles if DISPLACED.fullmatch(title)), None)
    if moved is not None and how.columns is None:
        remedy = f"Give `columns` with the places, or `columns: [{', '.join(map(_quoted, titles))}]` if these are."
        raise refused(f"{name} seems to hold displacements", moved, "columns x, y of the places of points", remedy)
    for title in titles:
        found = UNIT.search(title)
        unit = "" if found is None else found[1].lower().replace("µ", "u").replace("μ", "u")
        if unit and unit != how.unit.replace("µ", "u"):
            known = unit in ("um", "mm", "m")
            remedy = f"Give `unit: {unit}`, or correct the name." if known else "Convert the numbers, and the name."
            raise refused(f"{name} names its column {title}", f"`unit: {how.unit}`", "the same unit in both", remedy)


def _require_whole_numbers_apart(name: str, rows: Sequence[TableRow], separator: str) -> None:
    """Refuse a table whose numbers seem to have decimal commas between commas: 1,50,2,05 for 1.5 and 2.05."""
    after = [*zip(*(row.fields[1::2] for row in rows), strict=False)]
    if separator != "," or len(rows[0].fields) % 2 or len(after) < 2 or not all(map(str.isdecimal, sum(after, ()))):
        return
    digits = [{*map(len, column)} for column in after]
    if all(len(k) == 1 and k != {1} for k in digits) and any(one[0] == "0" for one in sum(after, ())):
        remedy = 'Write points, or semicolons between the numbers and `decimal: ","`.'
        raise refused(f"{name} seems to have decimal commas between commas", str(rows[0]), "one number a field", remedy)


def _in_order(one: str, other: str) -> bool:
    """Return whether the names of two columns say that the first is x and the second y."""
    axes = [_axes(re.split(r"[\[({/]", title)[0] or title)[-1:] for title in (one, other)]
    pairs = {pair for pair in zip(one.lower(), other.lower(), strict=False) if pair[0] != pair[1]}
    return axes == ["x", "y"] or (pairs in UPRIGHT and axes[0] != "y")


def _axes(text: str) -> str:
    """Return the coordinates that a text names, ``x``, ``y``, ``xy`` or ``yx``, in their order."""
    given = text.lower()
    return max((_named(re.sub(r"\bcolumns?\b(?=\s+\w)", "", given)), _named(given)), key=len)


def _named(text: str) -> str:
    for names in AXES:
        matches = [re.search(rf"(?<![^\W_])({name}){ENDING}(?![^\W_])", text) for name in names]
        found = sorted((match.start(), axis) for match, axis in zip(matches, "yx", strict=True) if match)
        if found:
            return "".join(axis for _, axis in found)
    return ""


def _require_no_empty_end(name: str, lines: Sequence[str], rows: Sequence[TableRow]) -> None:
    """Refuse a row without any number before the first point or after the last: a point may be missing."""
    for number, line in enumerate(lines, 1):
        empty = line.strip() and not line.strip(" \t,;")
        if empty and not rows[0].number < number < rows[-1].number:
            raise refused(f"{name} has an empty row in line {number}", line, "a point in each row", "Remove the line.")


def _require_no_count(name: str, rows: Sequence[TableRow], chosen: Sequence[int]) -> None:
    """Refuse rows that count the points after them, and a first row that numbers the columns."""
    heads, names, at = [], [], 0
    while at < len(rows):
        if all(map(str.isdecimal, rows[at].fields)):
            heads.append(at)
            at += int(rows[at].fields[0])
        elif _is_header(rows[at]):
            names.append(at)
        else:
            break
        at += 1
    skipped = {*names, *(heads or [0])}
    rest = [row.fields for number, row in enumerate(rows) if number not in skipped]
    decimals = bool(rest) and all("." in fields[k] for fields in rest for k in chosen if k < len(fields))
    widths = bool(rest) and all(rows[head].fields[1:] in ((), (str(len(rest[-1])),)) for head in heads)
    counts = at == len(rows) and bool(heads) and (decimals or widths)
    first = [rows[0].fields[k] for k in chosen if k < len(rows[0].fields)]
    numbers = False
    if heads in ([], [0]) and decimals and len(first) == len(chosen) and all(map(str.isdecimal, first)):
        counts = counts or str(len(rows) - 1) in first
        numbers = {int(field) - k for field, k in zip(first, chosen, strict=True)} in ({-1}, {0}, {1})
    if counts or numbers:
        line = rows[heads[0] if heads else 0]
        what = f"{name} {'counts its points' if counts else 'numbers its columns'} in line {line.number}"
        remedy = "Remove this line, and a name before it; if it is a point, write it with decimals."
        raise refused(what, str(line), "points alone", remedy)


def _pieces(
    rows: Sequence[TableRow], titles: Sequence[str], chosen: Sequence[int], how: Reading
) -> Int[np.ndarray, " point"] | None:
    """Return the number of each point's piece, if a blank line, a comment or a column tells several pieces apart.

    A column other than x and y does if it holds whole numbers, or words, each in a single run of at least three rows,
    and has no name; or if its name says so and values repeat, decimals at least twice on average. Points that are
    sorted may have gaps.
    """
    for k in set(range(len(rows[0].fields))) - set(chosen):
        if titles and not LABEL.match(titles[k].lower()):
            continue
        values = [row.fields[k] for row in rows]
        runs = np.cumsum([0, *(one != other for one, other in zip(values[1:], values, strict=False))])
        lengths, different = np.bincount(runs), len(set(values))
        whole = all(not _is_number(one) or (math.isfinite(float(one)) and float(one).is_integer()) for one in values)
        if titles:
            most = len(values) - (values[0] == values[-1]) - 1 if whole else len(values) / 2
            apart = different <= most
        else:
            apart = whole and different == len(lengths) and lengths.min() >= SHORTEST_PIECE
        if different > 1 and apart:
            return np.asarray(runs)
    gaps = np.cumsum([row.after_gap for row in rows])
    return gaps if gaps[-1] and how.sort is None else None


def _separator(lines: Sequence[str], how: Reading, name: str) -> str:
    """Return the character that separates fields; a blank stands for any number of them."""
    if how.delimiter is not None:
        return how.delimiter
    marks = ";\t" if how.decimal == "," else ",;\t"
    for number, line in enumerate(lines, 1):
        bare = re.sub(r'"[^"]*"', "", line)
        found = [mark for mark in marks if mark in bare.strip()]
        if COMMENT.match(line) or not any(character.isdigit() for character in bare):
            continue
        if "," in found and len(found) > 1:
            what = f"{name} has {'semicolons' if ';' in found else 'tabs'} and commas in line {number}"
            remedy = 'With decimal commas give `decimal: ","`; else say what separates the fields in `delimiter`.'
            raise refused(what, line.strip(), "one of them between the fields", remedy)
        return found[0] if found else " "
    return "," if any("," in line for line in lines) and how.decimal != "," else " "


def require_end(path: Path, name: str) -> None:
    """Refuse a program's result whose last line has no line break: its last number may be cut off."""
    content = path.read_bytes()
    if content.strip() and not content.endswith((b"\n", b"\r")):
        what, found = f"{name} ends within a line", content.splitlines()[-1][-80:].decode("utf-8", "replace")
        remedy = "Have the program end the last line, or give `count`, the number of points."
        raise refused(what, found, "a line break at the end; without it the last number may be cut off", remedy)


def _no_point(name: str, row: TableRow, titles: Sequence[str], columns: Sequence[str | int] = ()) -> Unreadable:
    expected = f"numbers in the columns {', '.join(map(str, columns))}" if columns else "two numbers x, y"
    remedy = CORRECT if columns or len(row.fields) <= 2 else _say_columns(titles, len(row.fields))
    return refused(f"{name} has no point in line {row.number}", str(row), expected, _way_out(row) or remedy)


def _way_out(row: TableRow) -> str | None:
    """Return the remedy for a row that holds no point, if its fields tell one."""
    if any(TOUCHING.match(field) for field in row.fields):
        return "Numbers touch: let the program write blanks between them, or give a `reader` of your own."
    if any(_is_number(re.sub("[dD]", "e", field)) and not _is_number(field) for field in row.fields):
        return "Write exponents with E."
    if any(_is_number(field.replace(",", ".")) and not _is_number(field) for field in row.fields):
        return OTHER_MARKS
    if not row.fields[0]:
        return "Save it without an index and with names x, y; pandas: `to_csv(index=False)`."
    return NO_POINT if _is_header(row) else None


def _say_columns(titles: Sequence[str], number: int) -> str:
    """Return the remedy for a table whose columns x and y must be named, with an example."""
    named = {title.lower(): title for title in titles if len(titles) == number and titles.count(title) == 1}
    known = next((pair for pair in PAIRS if named.keys() >= set(pair)), None)
    pair = ", ".join(_quoted(named[one]) for one in known) if known else "1, 2"
    return f"Say which of the {number} columns to take, by name or by number from 1, e.g. `columns: [{pair}]`."


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text.isascii() and "_" not in text


def _quoted(title: str) -> str:
    """Return the name of a column as study.yaml holds it."""
    return title if re.fullmatch(r"[^\W\d][\w-]*", title) else f'"{title}"'


def read_json(path: Path, how: Reading, name: str) -> Contents:
    """Return the outlines of a GeoJSON file, each a piece of its own."""
    found = [points for points, _ in outlines(path.read_bytes())]
    if not found:
        raise ValueError("no LineString or Polygon of GeoJSON in it")
    return Contents(np.concatenate(found), pieces=np.repeat(np.arange(len(found)), [len(points) for points in found]))


def outlines(content: bytes) -> list[DrawnLine]:
    """Return points of each outline in a GeoJSON or labelme file, holes as well, and whether it is closed."""
    return list(_drawn(json.loads(content)))


def _drawn(found: Any) -> Iterator[DrawnLine]:
    inner = [one for key in ("features", "geometries", "shapes") for one in found.get(key, ())]
    for one in filter(None, [*inner, found.get("geometry")]):
        yield from _drawn(one)
    closed = CLOSED.get(found.get("shape_type", found.get("type")))
    if closed is not None:
        lines = [found["points"] if "points" in found else found["coordinates"]]
        while not isinstance(lines[0][0][0], int | float):
            lines = [line for outer in lines for line in outer]
        yield from ((np.array([row[:2] for row in line], dtype=float), closed) for line in lines)
