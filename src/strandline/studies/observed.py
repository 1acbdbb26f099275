"""Observed interfaces: from files of points, or synthetic ones with noise."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import Interface

__all__ = ["TO_MM", "SyntheticNoise", "noisy", "read_points", "require_plausible"]

TO_MM = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "m": 1e3}
LARGEST_RATIO = 10.0
"""An observed interface that differs from the undeformed one by more than this factor in size has another unit."""


@dataclass(frozen=True)
class SyntheticNoise:
    """Independent Gaussian noise on every node coordinate of a synthetic observation.

    Args:
        sd: its standard deviation, mm.
        seed: of its random numbers.
    """

    sd: float
    seed: int


def noisy(interfaces: Mapping[str, Interface], noise: SyntheticNoise | None) -> dict[str, Interface]:
    """Return synthetic observations by condition, Y = M + σ ε with ε ~ N(0, I) (Willmann et al. 2022, Eq. 16).

    The random numbers of a condition depend on its name and the seed alone. Without `noise` nothing changes.

    Raises:
        InvalidStudy: noise so large that an interface touches itself.
    """
    if noise is None:
        return dict(interfaces)
    return {condition: _disturbed(interface, condition, noise) for condition, interface in interfaces.items()}


def _disturbed(interface: Interface, condition: str, noise: SyntheticNoise) -> Interface:
    random = np.random.default_rng([noise.seed, *condition.encode()])
    moved = replace(interface, points=interface.points + noise.sd * random.standard_normal(interface.points.shape))
    try:
        moved.require_simple()
    except InvalidInput as error:
        raise InvalidStudy(
            f"observation.noise: with it, {error.what}",
            value=f"sd: {noise.sd:g}",
            expected=f"noise well below the distance of the nodes, {float(np.median(interface.lengths)):.2g} mm",
            remedy="Lower observation.noise.sd, which is in mm.",
        ) from None
    return moved


def read_points(path: Path, unit: str, *, what: str = "observation") -> Interface:
    """Return the open polyline through the points of a text file, in mm.

    Each line holds x and y, separated by a comma, a semicolon or blanks; a first line of column names and lines that
    begin with # are passed over. The points stand in order along the interface.

    Args:
        path: of the file.
        unit: of its numbers, a key of `TO_MM`.
        what: the points are, for messages.

    Raises:
        InvalidStudy: the file is missing, empty or no table of numbers, or its points form no simple polyline.
    """
    name = f"{what} {path.name}"
    rows = [(number, _fields(line)) for number, line in enumerate(_lines(path, name), 1)]
    rows = [(number, fields) for number, fields in rows if fields and not fields[0].startswith("#")]
    if rows and not any(_is_number(field) for field in rows[0][1]):
        rows = rows[1:]
    if not rows:
        raise _refused(name, "holds no points", None, "two columns x, y with one point a line")
    points = np.array([_point(name, number, fields) for number, fields in rows]) * TO_MM[unit]
    try:
        interface = Interface.polyline(points)
        interface.require_simple()
    except InvalidInput as error:
        raise InvalidStudy(
            f"{name}: {error.what}",
            value=error.value,
            expected=error.expected,
            remedy=error.remedy,
        ) from None
    return interface


def require_plausible(path: Path, observed: Interface, undeformed: Interface, *, unit: str) -> None:
    """Refuse an interface of quite another size than the model's: a wrong unit.

    Raises:
        InvalidStudy: with both sizes.
    """
    size, expected = (float(np.ptp(i.points, axis=0).max()) for i in (observed, undeformed))
    if not 1 / LARGEST_RATIO < size / expected < LARGEST_RATIO:
        raise InvalidStudy(
            f"size of the observation {path.name}, read in {unit}",
            value=f"{size:.3g} mm across",
            expected=f"about {expected:.3g} mm, the size of the model's interface",
            remedy="Correct observation.unit (mm, um or m) or the file.",
        )


def _lines(path: Path, name: str) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise _refused(name, "is missing", str(path), "a file with two columns x, y") from None
    except (OSError, UnicodeDecodeError) as error:
        raise _refused(name, "cannot be read", str(error), "a readable text file") from None


def _fields(line: str) -> list[str]:
    return line.replace(",", " ").replace(";", " ").split()


def _point(name: str, number: int, fields: list[str]) -> tuple[float, float]:
    if len(fields) != 2 or not all(_is_number(field) for field in fields):
        raise _refused(name, f"has no point in line {number}", " ".join(fields), "two numbers x, y")
    return float(fields[0]), float(fields[1])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _refused(name: str, problem: str, value: str | None, expected: str) -> InvalidStudy:
    return InvalidStudy(
        f"{name} {problem}",
        value=value,
        expected=expected,
        remedy="Correct the name of the file in study.yaml, or the file.",
    )
