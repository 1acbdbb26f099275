"""Directions, sizes and distances of two interfaces, whatever the measure."""

import math
from collections.abc import Sequence

import numpy as np

from strandline.discrepancy.nearest import squared_distances
from strandline.discrepancy.protocol import CountsDistances, Discrepancy, independent_terms
from strandline.foundations import InvalidInput
from strandline.interface import Interface, Oriented

NEAREST = 5  # number of runs that decide, those nearest to the observation: a distant run's direction means little
SHARES = 33
LARGEST = 1e100
LARGEST_RATIO = 10.0
"""An observed interface this many times larger or smaller than the model's is taken to have another unit."""
FAR_SHARE, NEARER = 0.1, 0.5
"""Other axes are suggested for an observation further away than this share of its extent if they halve the distance."""
_FACTORS = {1: ("mm", "cm"), 3: ("µm", "mm"), 6: ("µm", "m")}
"""Decimal logarithm of a factor → two units that differ by this factor."""


def oriented_like_runs(observed: Interface, runs: Sequence[Interface]) -> Oriented:
    """Return `observed` in the direction of most of its nearest runs, and whether it had to be turned round.

    A simulated surface is ignored if the observation is a polyline, and so on, and an open run if it is closed.
    """
    alike = [one.dim == observed.dim and (one.closed or not observed.closed) for one in runs]
    finite = [float(np.abs(one.points).max()) < LARGEST for one in runs]  # so are the squares of its coordinates
    apart = [(_distance(observed, run), k) for k, run in enumerate(runs) if alike[k] and finite[k]]
    votes = [observed.runs_against(runs[k]) for _, k in sorted(apart)[:NEAREST]]
    against = 2 * sum(votes) > len(votes)
    return Oriented(observed.reversed() if against else observed, against)


def _distance(observed: Interface, run: Interface) -> float:
    """Return how far a run is from the observation, whatever its direction; used only for sorting."""
    if observed.dim == 3 or run.closed:
        return float(np.linalg.norm(observed.points.mean(axis=0) - run.points.mean(axis=0)))
    mine, theirs = observed.resampled(SHARES).points, run.resampled(SHARES).points
    return min(float(np.sum((mine - other) ** 2)) for other in (theirs, theirs[::-1]))


def extent(interface: Interface) -> float:
    """Return the largest side of the box around an interface, mm."""
    return float(np.ptp(interface.points, axis=0).max())


def extent_ratio(observed: Interface, simulated: Interface) -> float:
    """Return the extent of the observed interface divided by that of the simulated one."""
    return extent(observed) / extent(simulated)


def unit_mistake(ratio: float) -> str:
    """Return a clause, "perhaps …", on the unit that was probably mistaken; empty if the extents are similar."""
    power = abs(math.log10(ratio))
    if power < math.log10(LARGEST_RATIO) * (1 - 1e-9):
        return ""
    nearest = min(_FACTORS, key=lambda k: abs(k - power))
    small, large = _FACTORS[nearest]
    observed, simulated = (small, large) if ratio > 1 else (large, small)
    factor = f"{small} and {large} differ by a factor of {10**nearest:g}"
    way = "or the model's output the other way round"
    return f"perhaps the observation is in {observed} and was read in {simulated}, {way} ({factor})"


def require_plausible(name: str, observed: Interface, simulated: Interface, *, unit: str = "") -> None:
    """Refuse an interface ten times larger or smaller than the model's, deformed or not: a wrong unit."""
    ratio = extent_ratio(observed, simulated)
    mistake = unit_mistake(ratio)
    if mistake:
        told = not unit or f"read in {unit.replace('um', 'µm')}," in mistake
        guess = f"P{mistake[1:]}. " if told else ""  # not that a file was read in another unit than the study states
        raise InvalidInput(
            f"size of the {name}{f', read in {unit}' if unit else ''}",
            value=f"{extent(observed):.4g} mm across, {ratio:.3g} times the model's interface",
            expected=f"about {extent(simulated):.4g} mm, the size of the model's interface",
            remedy=f"{guess}Correct the unit of the observation or of its pixels, the file, or the size of the model.",
        )


def count_of_distances(measure: Discrepancy, simulated: Interface, observed: Interface) -> float | None:
    """Return how many distances d² sums, so that √(d²/count) is their root mean square.

    If the measure does not count its distances, its independent terms count. None if d² is not a sum of squared
    distances: then σ_N is not a distance either.
    """
    if isinstance(measure, CountsDistances):
        return float(measure.distances(simulated, observed))
    count = independent_terms(measure, observed)
    return None if count is None else float(count)


def noise_units(square: float, variance: float, count: float | None) -> float:
    """Return a residual in σ_N: the root mean square of its `count` distances, or √d² if it is not a sum of these."""
    return math.sqrt(square / (variance * (count or 1.0)))


def apart(one: Interface, other: Interface) -> tuple[float, float]:
    """Return the distance between two interfaces, mm: root mean square and largest.

    It is measured from the nodes of each to the closest points of the other; the larger of the two directions counts.
    """
    squares = [squared_distances(a.points, b) for a, b in ((one, other), (other, one))]
    return math.sqrt(max(float(s.mean()) for s in squares)), math.sqrt(max(float(np.max(s)) for s in squares))


def axes_mistake(observed: Interface, simulated: Interface) -> str:
    """Return a question about the axes of an observed polyline that is far away if others would help; else nothing."""
    if observed.dim == 3 or simulated.dim == 3 or (now := apart(observed, simulated)[0]) < FAR_SHARE * extent(observed):
        return ""
    x, y = observed.points.T
    others = {"x and y exchanged": (y, x), "y turned over": (x, -y), "x turned over": (-x, y)}
    found = {how: apart(Interface(np.stack(xy, axis=1), observed.cells), simulated)[0] for how, xy in others.items()}
    how = min(found, key=lambda one: found[one])
    if found[how] > NEARER * now:
        return ""
    return f"With {how} it would lie {found[how]:.3g} mm away, not {now:.3g} mm: are its axes those of the model?"
