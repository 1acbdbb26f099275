"""How to read a file: the options of `observation` and of a command's `result`."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from strandline.readers.checked import is_finite, keys_of, numbers, unfit, word
from strandline.registry import imported

TO_MM = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "m": 1e3}
MESHES = (".vtu", ".vtp", ".pvtu", ".pvtp", ".pvd", ".xdmf", ".xmf", ".stl", ".ply", ".vtk", ".msh", ".mesh", ".frd")
"""Suffixes of files that hold cells; any other file is a table of points in their order."""
SERIES = (".pvd", ".xdmf", ".xmf", ".frd")
"""Suffixes of files that hold several times."""
COMMON = {"file", "unit", "field", "select", "count", "reader"}
OF_TABLES = COMMON | {"closed", "columns", "delimiter", "decimal", "hide", "keep", "near", "sd", "sort"}
ONE_TIME = (".csv", ".tsv", ".npy", ".json", ".geojson")
"""Suffixes of tables of a single time; others may be lists that a simulator prints."""
OF_MESHES = COMMON | {"block", "cells", "points", "near", "keep", "start", "plane"}
PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


@dataclass(frozen=True)
class Reading:
    """A file and how to read it; places in mm, before `field` is added.

    Args:
        file: Name of the file; its suffix determines the format.
        unit: Unit of lengths in the file, a key of `TO_MM`.
        columns: Columns of a table: two names, or two numbers from 1.
        delimiter: Delimiter of a text table; by default commas, semicolons and blanks.
        decimal: Decimal mark of a text table, ``.`` or ``,``; with commas the fields are separated by semicolons or
            blanks.
        sd: Column of a table, by name or number from 1, that holds the standard deviation of each point, in `unit`.
        closed: Whether the last point of a table is joined to the first; needed if its ends nearly meet.
        sort: Coordinate, ``x`` or ``y``, that sorts the points of a table if they are not in order along the interface.
        field: Displacement to add: the name of point data of a mesh, or ``none``; or two columns of a table.
        time: Time of a series: ``last``, ``{index: 3}`` or ``{value: 0.5}``.
        block: Block of cells, by number from 0 or by kind.
        cells: Cell data, ``{name: value}``, of the cells that are read.
        points: Point data, ``{name: value}``, of all points of the cells that are read.
        select: Box, ``{x: [low, high], y: …}``, that limits what is read.
        hide: Boxes ``{x: [low, high], y: …}``; points of a table inside one of them are left out, as parts of the
            interface that cannot be seen.
        near: Place; of several pieces, the one nearest to it is read.
        keep: ``longest``: of several pieces, the longest is read; of a surface, the one of the largest area.
        start: Place; an open polyline begins at its end nearest to it, a closed one at its nearest node.
        plane: The two coordinates of a polyline, ``xy``, ``xz`` or ``yz``.
        count: Required number of points.
        reader: Function that reads the file, ``module:name``; by default the suffix determines it.

    Raises:
        InvalidInput: An invalid option, or one that the format of the file does not take.
    """

    file: str
    unit: str
    columns: tuple[str | int, ...] | None = None
    delimiter: str | None = None
    decimal: str | None = None
    sd: str | int | None = None
    closed: bool | None = None
    sort: str | None = None
    field: str | tuple[str | int, ...] | None = None
    time: str | Mapping[str, Any] | None = None
    block: int | str | None = None
    cells: Mapping[str, Any] | None = None
    points: Mapping[str, Any] | None = None
    select: Mapping[str, tuple[float, float]] | None = None
    hide: tuple[Mapping[str, tuple[float, float]], ...] | None = None
    near: tuple[float, ...] | None = None
    keep: str | None = None
    start: tuple[float, ...] | None = None
    plane: str = "xy"
    count: int | None = None
    reader: str | None = None

    @classmethod
    def from_options(cls, options: object, place: str) -> "Reading":
        """Return the reading that a study file asks for at `place`."""
        known = [f.name for f in dataclasses.fields(cls)]
        given = keys_of(options, known, place, "{file: interface.csv, unit: mm}")
        values = {name: _frozen(value) for name, value in given.items() if value is not None}
        for name in ("file", "unit"):
            if name not in values:
                raise unfit(f"{place}.{name}", None, "this option", f"Add `{name}: …` to {place}.")
        reading = _checked_types(values, place)
        reading.require_sound(place)
        return reading

    @property
    def suffix(self) -> str:
        """Suffix of the file, in lower case."""
        return PurePosixPath(self.file).suffix.lower()

    @property
    def is_table(self) -> bool:
        """Whether the suffix stands for a table."""
        return self.suffix not in MESHES

    @property
    def axes(self) -> tuple[int, int]:
        """Indices of the two coordinates of a polyline."""
        return PLANES[self.plane]

    @property
    def factor(self) -> float:
        """Unit of the file in mm."""
        return TO_MM[self.unit]

    @property
    def given(self) -> dict[str, Any]:
        """The options that differ from their defaults, as plain data."""
        return {f.name: v for f in dataclasses.fields(self) if (v := getattr(self, f.name)) != f.default}

    def require_sound(self, place: str) -> None:
        """Refuse options that do not fit the format."""
        word(self.unit, TO_MM, f"{place}.unit")
        word(self.plane, PLANES, f"{place}.plane")
        if self.reader is not None and not callable(imported(self.reader, f"{place}.reader")):
            raise unfit(f"{place}.reader", self.reader, "a function (path, reading, name) -> Contents")
        if self.decimal == "," == self.delimiter:
            raise unfit(f"{place}.delimiter", ",", "another one than the decimal comma, e.g. ;")
        if self.near is not None and self.keep is not None:
            raise unfit(place, "near and keep", "one of the two")
        allowed = OF_TABLES if self.is_table else OF_MESHES
        if self.is_table and self.suffix not in ONE_TIME:
            allowed = allowed | {"plane", "time"}
        if self.suffix in SERIES:
            allowed = allowed | {"time"}
        if self.reader is not None:
            allowed = OF_TABLES | OF_MESHES | {"time"}
        for name in self.given:
            if name not in allowed:
                raise unfit(
                    f"{place}.{name}", self.given[name], f"no such option for a {self.suffix or 'nameless'} file"
                )
        if self.field is not None and self.reader is None and isinstance(self.field, str) == self.is_table:
            raise unfit(
                f"{place}.field",
                self.field,
                "two columns, e.g. [ux, uy]" if self.is_table else "the name of point data",
            )


def _checked_types(values: dict[str, Any], place: str) -> Reading:
    """Return the reading after a check of the type of each option."""
    for name in ("file", "unit", "delimiter", "plane", "reader"):
        if not isinstance(values.get(name, ""), str):
            raise unfit(f"{place}.{name}", values[name], "a text")
    for name, words in (("sort", ("x", "y")), ("keep", ("longest",)), ("decimal", (".", ","))):
        if name in values and values[name] not in words:
            raise unfit(f"{place}.{name}", values[name], " or ".join(words))
    if not isinstance(values.get("closed", True), bool):
        raise unfit(f"{place}.closed", values["closed"], "true or false")
    if "sd" in values and not _is_column(values["sd"]):
        raise unfit(f"{place}.sd", values["sd"], "a column, by name or by number from 1")
    if "delimiter" in values and len(values["delimiter"]) != 1:
        raise unfit(f"{place}.delimiter", values["delimiter"], "one character")
    _check_columns(values, "columns", place)
    if not isinstance(values.get("field", ""), str):
        _check_columns(values, "field", place)
    for name in ("near", "start"):
        if name in values:
            size = 3 if isinstance(values[name], tuple) and len(values[name]) == 3 else 2
            values[name] = numbers(values[name], size, f"{place}.{name}", "2 or 3 numbers")
    for name in ("cells", "points"):
        found = values.get(name, {"": 0})
        if not (isinstance(found, Mapping) and len(found) == 1 and all(_is_value(v) for v in found.values())):
            raise unfit(f"{place}.{name}", found, "the name of data with a number, e.g. {region: 3}")
    if not (isinstance(values.get("block", 0), int | str) and not isinstance(values.get("block"), bool)):
        raise unfit(f"{place}.block", values["block"], "a number from 0, or a kind of cells such as line")
    if not (type(values.get("count", 2)) is int and values.get("count", 2) >= 2):
        raise unfit(f"{place}.count", values["count"], "a number of points, at least 2")
    if "select" in values:
        values["select"] = _box(values["select"], f"{place}.select")
    if "hide" in values:
        boxes = values["hide"] if isinstance(values["hide"], tuple) else (values["hide"],)
        values["hide"] = tuple(_box(box, f"{place}.hide") for box in boxes)
    if "time" in values:
        _check_time(values["time"], f"{place}.time")
    return Reading(**values)


def _check_columns(values: Mapping[str, Any], name: str, place: str) -> None:
    found = values.get(name, (1, 2))
    fits = isinstance(found, tuple) and len(found) == 2 and found[0] != found[1]
    if not fits or not all(map(_is_column, found)):
        raise unfit(f"{place}.{name}", found, "two columns, by name or by number from 1, e.g. [x, y] or [1, 2]")


def _is_column(found: object) -> bool:
    return isinstance(found, str) or (type(found) is int and found >= 1)


def _check_time(found: object, place: str) -> None:
    if found == "last":
        return
    if isinstance(found, Mapping) and len(found) == 1:
        (name, value) = next(iter(found.items()))
        if (name == "index" and type(value) is int and value >= 0) or (name == "value" and is_finite(value)):
            return
    raise unfit(place, found, "last, {index: 0} or {value: 0.5}")


def _box(found: object, place: str) -> dict[str, tuple[float, float]]:
    if not (isinstance(found, Mapping) and found and set(found) <= set("xyz")):
        raise unfit(place, found, "intervals of x, y or z, e.g. {x: [0, 1]}")
    box = {name: numbers(interval, 2, f"{place}.{name}", "2 numbers") for name, interval in found.items()}
    for name, (low, high) in box.items():
        if not low <= high:
            raise unfit(f"{place}.{name}", [low, high], "[low, high]")
    return {name: (low, high) for name, (low, high) in box.items()}


def _is_value(value: object) -> bool:
    return is_finite(value) or (isinstance(value, tuple) and bool(value) and all(is_finite(v) for v in value))


def _frozen(value: object) -> Any:
    """Return lists as tuples."""
    if isinstance(value, list | tuple):
        return tuple(_frozen(item) for item in value)
    return {k: _frozen(v) for k, v in value.items()} if isinstance(value, Mapping) else value
