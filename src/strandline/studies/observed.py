"""Observed interfaces from files of points."""

from pathlib import Path

import numpy as np

from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import Interface

__all__ = ["TO_MM", "read_points"]

TO_MM = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "m": 1e3}


def read_points(path: Path, unit: str) -> Interface:
    """Return the open polyline through the points of a text file, in mm.

    Each line holds x and y, separated by a comma or blanks; one line of column names and lines that begin with # are
    passed over. The points stand in order along the interface.

    Raises:
        InvalidStudy: the file is missing, empty or no table of numbers, or its points form no simple polyline.
    """
    rows = [line.strip() for line in _lines(path)]
    rows = [row for row in rows if row and not row.startswith("#")]
    if rows and not _is_number(rows[0].replace(",", " ").split()[0]):
        rows = rows[1:]
    if not rows:
        raise _refused(path, "holds no points", "empty", "two columns x, y with one point a line")
    points = np.array([_point(path, number, row) for number, row in enumerate(rows, 1)]) * TO_MM[unit]
    try:
        interface = Interface.polyline(points)
        interface.require_simple()
    except InvalidInput as error:
        raise InvalidStudy(
            f"observation {path.name}: {error.what}",
            value=error.value,
            expected=error.expected,
            remedy=error.remedy,
        ) from None
    return interface


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise _refused(path, "is missing", str(path), "a file with two columns x, y") from None
    except (OSError, UnicodeDecodeError) as error:
        raise _refused(path, "cannot be read", str(error), "a readable text file") from None


def _point(path: Path, number: int, row: str) -> tuple[float, float]:
    fields = row.replace(",", " ").replace(";", " ").split()
    if len(fields) != 2 or not all(_is_number(field) for field in fields):
        raise _refused(path, f"has no point in data line {number}", row, "two numbers x, y")
    return float(fields[0]), float(fields[1])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _refused(path: Path, problem: str, value: str, expected: str) -> InvalidStudy:
    return InvalidStudy(
        f"observation {path.name} {problem}",
        value=value,
        expected=expected,
        remedy="Correct observation.file or the file.",
    )
