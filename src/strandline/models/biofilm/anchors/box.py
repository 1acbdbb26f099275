"""The box of inputs in which anchors are placed, and its coordinates."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.models.biofilm.inflow import DROP, RATE
from strandline.models.protocol import ModelInput

__all__ = ["Box", "Ranges", "as_ranges", "check_ranges"]

Ranges = tuple[tuple[str, float, float], ...]
"""Lowest and highest value of each input, by name."""

POINTS_PER_INPUT = 12
"""Points of Sobol's sequence for each input that varies."""
MOST_CORNERS = 8
"""Up to this number, the corners of the box are points too."""
OPTION = "anchors of the biofilm model"
DRIVES = (RATE.name, DROP.name)
EXAMPLE = "e.g. {E: [100, 800], nu: [0.1, 0.45], V_in: 100}"


@dataclass(frozen=True)
class Axis:
    """One input that varies in the box.

    Args:
        name: Name of the input.
        low: Lowest value.
        high: Highest value.
        length: Length of the range when nearness of factorised Jacobians is judged; see `Box.distances`.
    """

    name: str
    low: float
    high: float
    length: float

    @property
    def is_logarithmic(self) -> bool:
        """Whether the coordinate is the logarithm of the input."""
        return self.low > 0 and self.high > 2 * self.low

    def coordinate(self, value: float) -> float:
        """Return the coordinate, from 0 to 1 in the range."""
        if self.is_logarithmic:
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)

    def value(self, coordinate: float) -> float:
        """Return the input at a coordinate; the bounds are exact."""
        if coordinate in (0.0, 1.0):
            return self.high if coordinate else self.low
        if self.is_logarithmic:
            return float(self.low * (self.high / self.low) ** coordinate)
        return self.low + coordinate * (self.high - self.low)

    @classmethod
    def of(cls, name: str, low: float, high: float) -> "Axis":
        """Return the axis of a range.

        Jacobians are rescaled to the shear modulus of a run, see `factors`: what Young's modulus changes is mostly made
        good, what Poisson's ratio changes is not. So the latter counts as it is, an e-fold of another input 0.3, and
        the whole range of one whose ends have a ratio below 2 likewise 0.6.
        """
        if name.rstrip("0123456789") == "nu":
            return cls(name, low, high, high - low)
        axis = cls(name, low, high, 0.6)
        return cls(name, low, high, 0.3 * float(np.log(high / low))) if axis.is_logarithmic else axis


@dataclass(frozen=True)
class Box:
    """Ranges of inputs; those whose ends are equal have one value and no coordinate."""

    ranges: Ranges

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Inputs that vary."""
        return tuple(Axis.of(*entry) for entry in self.ranges if entry[1] < entry[2])

    def holds(self, inputs: Mapping[str, float]) -> bool:
        """Return whether inputs lie in the box, its bounds included."""
        return all(low <= inputs[name] <= high for name, low, high in self.ranges)

    def coordinates(self, inputs: Mapping[str, float]) -> Float[np.ndarray, " axis"]:
        """Return coordinates of inputs, from 0 to 1 in the box."""
        return np.array([axis.coordinate(inputs[axis.name]) for axis in self.axes])

    def inputs(self, coordinates: Sequence[float]) -> dict[str, float]:
        """Return the inputs at coordinates."""
        at = {axis.name: axis.value(c) for axis, c in zip(self.axes, coordinates, strict=True)}
        return {name: at.get(name, low) for name, low, _ in self.ranges}

    def points(self) -> Iterator[tuple[float, ...]]:
        """Yield coordinates of the points to solve: corners if they are few, then Sobol's without its first."""
        from scipy.stats import qmc  # slow to import, and needed only where anchors are not on disk

        count = len(self.axes)
        if 2**count <= MOST_CORNERS:
            yield from product((0.0, 1.0), repeat=count)
        sequence = qmc.Sobol(count, scramble=False)
        sequence.fast_forward(1)
        for row in sequence.random(POINTS_PER_INPUT * count):
            yield tuple(float(c) for c in row)

    def distances(
        self, coordinates: Float[np.ndarray, "point axis"], at: Float[np.ndarray, " axis"]
    ) -> Float[np.ndarray, " point"]:
        """Return how far the factorised Jacobians of points are from that at a point."""
        lengths = np.array([axis.length for axis in self.axes])
        return np.asarray(np.linalg.norm((coordinates - at) * lengths, axis=1))


def as_ranges(given: Any) -> Ranges:
    """Return a mapping of inputs to numbers or pairs [lowest, highest] as ranges.

    Raises:
        InvalidInput: It is none, or empty.
    """
    if not isinstance(given, Mapping) or not given:
        raise InvalidInput(
            OPTION,
            value=given,
            expected=f"lowest and highest value of each input of the model, {EXAMPLE}",
            remedy="Correct them.",
        )
    return tuple((str(name), *_ends(name, entry)) for name, entry in given.items())


def check_ranges(ranges: Ranges, inputs: Sequence[ModelInput], *, steady: bool) -> None:
    """Refuse ranges of other inputs than the model's, or outside what these admit, and anchors of runs through time.

    Without inflow nothing bends, and logarithms of strains have no value: a range of the inflow lies above 0.
    """
    if not ranges:
        return
    if not steady:
        raise InvalidInput(
            OPTION,
            value="anchors with a course",
            expected="no course: a run through time does not start from anchors",
            remedy="Remove one of the two.",
        )
    known, given = {item.name: item for item in inputs}, [name for name, _, _ in ranges]
    for name in [*given, *known]:
        if name not in known or name not in given:
            raise InvalidInput(
                OPTION,
                value=f"{name}, which is no input" if name not in known else f"no {name}",
                expected=f"lowest and highest value of {', '.join(known)}; one number where an input is the same in all"
                f" runs",
                remedy=f"Remove {name}." if name not in known else f"Add {name}.",
            )
    for name, low, high in ranges:
        item = replace(known[name], low_included=known[name].low_included and name not in DRIVES)
        if not (low <= high and item.admits(low) and item.admits(high)):
            raise InvalidInput(
                f"{name} in the {OPTION}",
                value=low if low == high else [low, high],
                expected=f"the lowest value, then the highest, both in {item.range_text()}",
                remedy=f"Correct the range of {name}.",
            )
    if all(low == high for _, low, high in ranges):
        raise InvalidInput(
            OPTION, value="no range", expected=f"at least one input that varies, {EXAMPLE}", remedy="Give one a range."
        )


def _ends(name: object, entry: Any) -> tuple[float, float]:
    ends = entry if isinstance(entry, list | tuple) else [entry, entry]
    if len(ends) != 2 or not all(_is_finite(end) for end in ends):
        raise InvalidInput(
            f"{name} in the {OPTION}",
            value=entry,
            expected="a number, or lowest and highest value as [100, 800]",
            remedy=f"Correct the range of {name}.",
        )
    return float(ends[0]), float(ends[1])


def _is_finite(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max
