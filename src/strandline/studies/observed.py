"""Observed interfaces: from files of points, or synthetic ones with noise."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import extent, extent_ratio, unit_mistake
from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import Interface
from strandline.readers import Reading, read_interface, read_point_sds
from strandline.readers.options import TO_MM
from strandline.studies.chosen import refused_at

__all__ = ["TO_MM", "SyntheticNoise", "noisy", "read_points", "read_sds", "require_plausible"]


@dataclass(frozen=True)
class SyntheticNoise:
    """Independent Gaussian noise on every node coordinate of a synthetic observation.

    Args:
        sd: Standard deviation of the noise, mm.
        seed: Seed of its random numbers.
    """

    sd: float
    seed: int


def noisy(interfaces: Mapping[str, Interface], noise: SyntheticNoise | None) -> dict[str, Interface]:
    """Return synthetic observations by condition, Y = M + σ ε with ε ~ N(0, I) (Willmann et al. 2022, Eq. 16).

    The random numbers of a condition depend on its name and the seed alone. Without `noise` nothing changes.

    Raises:
        InvalidStudy: The noise is so large that an interface touches itself.
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


def read_points(
    path: Path, unit: str, *, what: str = "observation", options: Mapping[str, Any] | None = None
) -> Interface:
    """Return the interface in a file, in mm; for a text file without `options`, the open polyline of its points.

    Each line of such a file holds x and y, separated by a comma, a semicolon or blanks; a first line of column names
    and lines that begin with # are skipped. The points are in order along the interface.

    Args:
        path: Path of the file.
        unit: Unit of the numbers in the file, a key of `TO_MM`.
        what: Name of the points in messages.
        options: How to read the file, see `strandline.readers.Reading`.

    Raises:
        InvalidStudy: The file is missing, empty or damaged, or holds no simple interface.
    """
    try:
        reading = Reading.from_options({**(options or {}), "file": path.name, "unit": unit}, what)
        return read_interface(path, reading, name=f"{what} {path.name}")
    except InvalidInput as error:
        raise InvalidStudy(
            error.what,
            value=error.value,
            expected=error.expected,
            remedy=error.remedy,
        ) from None


def read_sds(path: Path, unit: str, *, options: Mapping[str, Any]) -> Float[np.ndarray, " point"] | None:
    """Return the standard deviations of observed points, mm; None if `options` name no column with them.

    Raises:
        InvalidStudy: One is not above 0.
    """
    if options.get("sd") is None:
        return None
    reading = Reading.from_options({**options, "file": path.name, "unit": unit}, "observation")
    with refused_at():
        return read_point_sds(path, reading, name=f"observation {path.name}")


def require_plausible(name: str, observed: Interface, simulated: Interface, *, unit: str = "") -> None:
    """Refuse an interface ten times larger or smaller than the model's: a wrong unit.

    Args:
        name: Name of the observation in messages.
        observed: The observed interface, mm.
        simulated: The model's interface, deformed or not, mm.
        unit: The unit in which the observation was read, if known.

    Raises:
        InvalidStudy: The extents differ by a factor of 10 or more; the message has both, and the likely mistake.
    """
    ratio = extent_ratio(observed, simulated)
    mistake = unit_mistake(ratio)
    if mistake:
        raise InvalidStudy(
            f"size of the {name}{f', read in {unit}' if unit else ''}",
            value=f"{extent(observed):.4g} mm across, {ratio:.3g} times the model's interface",
            expected=f"about {extent(simulated):.4g} mm, the size of the model's interface",
            remedy=f"P{mistake[1:]}. Correct the unit of the observation or of its pixels, the file or the model.",
        )
