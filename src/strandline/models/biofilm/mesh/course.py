"""How the inflow changes with time, and when interfaces are observed."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from strandline.foundations import InvalidInput, unfit
from strandline.interface import is_condition
from strandline.models.biofilm.mesh.outline import Pairs, finite

QUASI_STATIC, TRANSIENT = "quasi_static", "transient"
MOTIONS = (QUASI_STATIC, TRANSIENT)
PLACE = "course of the biofilm model"

Times = tuple[tuple[str, float], ...]


def _named(value: Any) -> Times:
    """Return times of a study file with their names; those in a list are called t1, t2, …."""
    given = value if isinstance(value, Mapping) else {}
    if isinstance(value, list | tuple):
        given = {f"t{k}": time for k, time in enumerate(value, 1)}
    times = finite(list(given.values()))
    if times.shape != (len(given),):
        raise _refused("times in the", value, "times in s by the name of the condition, e.g. {early: 0.1, late: 2}")
    return tuple(zip(given, times.tolist(), strict=True))


def _refused(what: str, value: object, expected: str) -> InvalidInput:
    return unfit(f"{what} {PLACE}", value, expected, "Correct the course.")


@dataclass(frozen=True)
class Course:
    """An experiment in which the inflow changes with time.

    Args:
        inflow: Pairs (time, share), s and a share of V_in or of the pressure drop, linear between; a run starts at the
            first time, in the steady state of its share. Two pairs of the same time are a jump, if quasi-static.
        times: Times, s, at which the interface is observed, by the name of the condition.
        motion: ``quasi_static``: the steady state of each moment's inflow; ``transient``: with inertia of fluid and
            solid, on a moving mesh.
        solid_density: Density of the undeformed solid, kg/m³; counts in transient runs only.
        tolerance: Transient: largest local error of a step in velocity and displacement, as a share of the largest
            value so far. Of a solid that creeps: largest error in time of the interface, as a share of its largest
            displacement so far. Else it does not count.

    Raises:
        InvalidInput: Times that do not increase, or lie outside the course; a share below 0; a number out of range.
    """

    inflow: Pairs
    times: Times = field(metadata={"read": _named})
    motion: str = QUASI_STATIC
    solid_density: float = 1e3
    tolerance: float = 1e-3

    def __post_init__(self) -> None:
        if self.motion not in MOTIONS:
            raise _refused("motion in the", self.motion, f"one of {', '.join(MOTIONS)}")
        if len(self.inflow) < 2:
            raise _refused("inflow in the", self.inflow, "a table of at least two pairs [time in s, share of V_in]")
        _require_increasing("times of the inflow in the", self._moments())
        for time, share in self.inflow:
            if share < 0:
                raise _refused("inflow in the", f"share {share:g} at {time:g} s", "shares of V_in, 0 or above")
        if not self.times:
            raise _refused("times in the", "none", "at least one time, in s, at which the interface is observed")
        _require_increasing("times in the", [time for _, time in self.times])
        begin, end = self.inflow[0][0], self.inflow[-1][0]
        for name, time in self.times:
            if not is_condition(name) or not name:
                raise _refused("times in the", f"the name {name!r}", "names of conditions, e.g. {early: 0.1, late: 2}")
            if not begin <= time <= end:
                raise _refused("times in the", f"{time:g} s", f"times inside the course, from {begin:g} to {end:g} s")
        if not 0 < self.solid_density < np.inf:
            raise _refused("solid_density in the", self.solid_density, "a density in kg/m^3 above 0")
        if not 0 < self.tolerance <= 0.1:
            raise _refused("tolerance in the", self.tolerance, "a share above 0, at most 0.1")

    @property
    def is_transient(self) -> bool:
        return self.motion == TRANSIENT

    @property
    def start(self) -> float:
        """Time of the start, s."""
        return self.inflow[0][0]

    def share(self, time: float) -> float:
        """Return the share of the inflow at a time, s; where it jumps, that after the jump."""
        times, shares = np.array(self.inflow).T
        k = int(np.searchsorted(times, time, side="right"))
        if k == len(times):
            return float(shares[-1])
        return float(np.interp(time, times[k - 1 : k + 1], shares[k - 1 : k + 1]))

    def _moments(self) -> list[float]:
        """Return the times of the inflow; without the second one of each jump unless inertia counts."""
        times = [time for time, _ in self.inflow]
        if self.is_transient:
            return times
        jumps = [k for k in range(1, len(times)) if times[k] == times[k - 1] and (k < 2 or times[k - 2] < times[k])]
        return [time for k, time in enumerate(times) if k not in jumps]

    def shares(self) -> dict[str, float]:
        """Return the share of the inflow at each time observed, by the name of the condition."""
        return {name: self.share(time) for name, time in self.times}


def _require_increasing(what: str, times: list[float]) -> None:
    for before, time in pairwise(times):
        if not time > before:
            raise _refused(what, f"{time:g} s after {before:g} s", "times that increase")


@dataclass(frozen=True)
class Piece:
    """A stretch of time, s, in which the share of the full inflow changes linearly, or a sudden change of it."""

    begin: float
    end: float
    from_share: float
    to_share: float

    @property
    def is_sudden(self) -> bool:
        return self.begin == self.end

    def share(self, time: float) -> float:
        """Return the share of the full inflow at a time between beginning and end."""
        if time >= self.end:
            return self.to_share
        return self.from_share + (self.to_share - self.from_share) * (time - self.begin) / (self.end - self.begin)


def pieces(course: Course) -> Iterator[Piece]:
    """Yield the pieces of a course until the last time observed, divided at all times observed."""
    observed = [time for _, time in course.times]
    end = observed[-1]
    for (begin, first), (until, second) in pairwise(course.inflow):
        whole = Piece(begin, until, first, second)
        if begin > end or (begin == end and not whole.is_sudden):
            return
        if whole.is_sudden:
            yield whole
            continue
        marks = [begin, *(time for time in observed if begin < time < until), until]
        for a, b in pairwise(time for time in marks if time <= end):
            yield Piece(a, b, whole.share(a), whole.share(b))
