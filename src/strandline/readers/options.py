"""How to read a file: the options of `observation` and of a command's `result`."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Literal

from strandline.foundations import imported, is_finite, unfit

TO_MM = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "m": 1e3}
TEXT = "strandline.readers.tables:read_text"
ONE_TIME = {
    **dict.fromkeys((".csv", ".tsv"), TEXT),
    ".npy": "strandline.readers.tables:read_npy",
    **dict.fromkeys((".json", ".geojson"), "strandline.readers.tables:read_json"),
}
SERIES = {
    ".pvd": "strandline.readers.vtk_xml:read_pvd",
    **dict.fromkeys((".xdmf", ".xmf"), "strandline.readers.by_meshio:read_xdmf"),
    ".frd": "strandline.readers.calculix:read_frd",
}
MESHES = SERIES | {
    **dict.fromkeys((".vtu", ".vtp", ".pvtu", ".pvtp"), "strandline.readers.vtk_xml:read_vtk_xml"),
    **dict.fromkeys((".stl", ".ply"), "strandline.readers.by_meshio:read_by_meshio"),
    ".msh": "strandline.readers.by_meshio:read_msh",
    ".mesh": "strandline.readers.by_meshio:read_medit",
    ".vtk": "strandline.readers.by_meshio:read_legacy",
}
READERS: dict[str, str] = ONE_TIME | {".txt": TEXT, ".dat": TEXT} | MESHES
"""Suffixes of files → ``module:name`` of the function that reads them; others are read as text.

`ONE_TIME` are tables of a single time, other texts may be lists that a simulator prints. `MESHES` hold
cells, those of them in `SERIES` at several times.
"""
COMMON = {"file", "unit", "field", "select", "count", "reader"}
OF_COLUMNS = {"columns", "delimiter", "decimal", "sd", "field"}
"""Options of tables that say nothing about points in a format of their own."""
OF_TABLES = COMMON | OF_COLUMNS | {"closed", "hide", "keep", "near", "sort"}
OF_MESHES = COMMON | {"block", "cells", "points", "near", "keep", "start", "plane"}
PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


Column = str | int
Box = Mapping[str, tuple[float, float]]


def _time(found: object) -> Any:
    if found == "last":
        return found
    if isinstance(found, Mapping) and len(found) == 1:
        (name, value) = next(iter(found.items()))
        if (name == "index" and type(value) is int and value >= 0) or (name == "value" and is_finite(value)):
            return found
    raise unfit("", found, "last, {index: 0} or {value: 0.5}", "Correct it.")


def _data(found: object) -> Any:
    if isinstance(found, Mapping) and len(found) == 1:
        (name, value) = next(iter(found.items()))
        value = tuple(value) if isinstance(value, list | tuple) else value
        if is_finite(value) or (isinstance(value, tuple) and value and all(map(is_finite, value))):
            return {name: value}
    raise unfit("", found, "the name of data with a number, e.g. {region: 3}", "Correct it.")


def _box(found: object) -> dict[str, tuple[float, float]]:
    if not (isinstance(found, Mapping) and found and set(found) <= set("xyz")):
        raise unfit("", found, "intervals of x, y or z, e.g. {x: [0, 1]}", "Correct it.")
    for name, ends in found.items():
        if not (isinstance(ends, list | tuple) and len(ends) == 2 and all(map(is_finite, ends)) and ends[0] <= ends[1]):
            raise unfit(name, ends, "[low, high]")
    return {name: (float(low), float(high)) for name, (low, high) in found.items()}


def _boxes(found: object) -> tuple[Box, ...]:
    return tuple(map(_box, found)) if isinstance(found, list | tuple) else (_box(found),)


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
        select: Box, ``{x: [low, high], y: …}`` in mm, that limits what is read.
        hide: Boxes ``{x: [low, high], y: …}``, mm; points of a table inside one of them are left out, as parts of the
            interface that cannot be seen.
        near: Place ``[x, y]``, mm; of several pieces, the one nearest to it is read.
        keep: ``longest``: of several pieces, the longest is read; of a surface, the one of the largest area.
        start: Place ``[x, y]``, mm; an open polyline begins at its end nearest to it, a closed one at its nearest node.
        plane: The two coordinates of a polyline, ``xy``, ``xz`` or ``yz``.
        count: Required number of points.
        reader: Function that reads the file, ``module:name``; by default the suffix determines it.

    Raises:
        InvalidInput: An invalid option, or one that the format of the file does not take.
    """

    file: str
    unit: Literal["mm", "um", "µm", "m"]
    columns: tuple[Column, Column] | None = None
    delimiter: str | None = None
    decimal: Literal[".", ","] | None = None
    sd: Column | None = None
    closed: bool | None = None
    sort: Literal["x", "y"] | None = None
    field: str | tuple[Column, Column] | None = None
    time: str | Mapping[str, Any] | None = dataclasses.field(default=None, metadata={"read": _time})
    block: int | str | None = None
    cells: Mapping[str, Any] | None = dataclasses.field(default=None, metadata={"read": _data})
    points: Mapping[str, Any] | None = dataclasses.field(default=None, metadata={"read": _data})
    select: Box | None = dataclasses.field(default=None, metadata={"read": _box})
    hide: tuple[Box, ...] | None = dataclasses.field(default=None, metadata={"read": _boxes})
    near: tuple[float, ...] | None = None
    keep: Literal["longest"] | None = None
    start: tuple[float, ...] | None = None
    plane: Literal["xy", "xz", "yz"] = "xy"
    count: int | None = None
    reader: str | None = None

    def __post_init__(self) -> None:
        for name in ("columns", "sd", "field"):
            found = getattr(self, name)
            columns = found if isinstance(found, tuple) else (found,)
            if len(set(columns)) < len(columns) or any(isinstance(one, int) and one < 1 for one in columns):
                raise unfit(name, found, "columns, by name or by number from 1, e.g. [x, y] or [1, 2]")
        if self.delimiter is not None and (len(self.delimiter) != 1 or self.delimiter == self.decimal):
            raise unfit("delimiter", self.delimiter, "one character other than the decimal mark, e.g. ;")
        if self.count is not None and self.count < 2:
            raise unfit("count", self.count, "a number of points, at least 2")
        for name in ("near", "start"):
            if len(getattr(self, name) or (0, 0)) not in (2, 3):
                raise unfit(name, getattr(self, name), "2 or 3 numbers")
        if self.reader is not None and not callable(imported(self.reader, "reader")):
            raise unfit("reader", self.reader, "a function (path, reading, name) -> Contents")
        if self.near is not None and self.keep is not None:
            raise unfit("near and keep", "both", "one of the two")
        self._require_format()

    def _require_format(self) -> None:
        allowed = OF_TABLES if self.is_table else OF_MESHES
        if self.is_table and self.suffix not in ONE_TIME:
            allowed = allowed | {"plane", "time"}
        if self.suffix in (".json", ".geojson"):
            allowed = allowed - OF_COLUMNS
        if self.suffix in SERIES:
            allowed = allowed | {"time"}
        if self.reader is not None:
            allowed = OF_TABLES | OF_MESHES | {"time"}
        for name in self.given:
            if name not in allowed:
                raise unfit(name, self.given[name], f"no such option for a {self.suffix or 'nameless'} file")
        if self.field is not None and self.reader is None and isinstance(self.field, str) == self.is_table:
            expected = "two columns, e.g. [ux, uy]" if self.is_table else "the name of point data"
            raise unfit("field", self.field, expected)

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
