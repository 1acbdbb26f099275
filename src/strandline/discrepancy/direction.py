"""The direction of an observed interface, taken from forward runs."""

from collections.abc import Sequence

import numpy as np

from strandline.interface import Interface, Oriented

__all__ = ["oriented_like_runs"]

NEAREST = 5
"""Number of runs that decide, those nearest to the observation: a distant run's direction means little."""
SHARES = 33
LARGEST = 1e100


def oriented_like_runs(observed: Interface, runs: Sequence[Interface]) -> Oriented:
    """Return `observed` in the direction of most of its nearest runs, and whether it had to be turned round.

    Args:
        observed: The observed interface.
        runs: Simulated interfaces; a surface is ignored if the observation is a polyline, and so on, and an open run if
            the observation is closed.
    """
    apart = [(_distance(observed, run), k) for k, run in enumerate(runs) if _alike(observed, run)]
    votes = [observed.runs_against(runs[k]) for _, k in sorted(apart)[:NEAREST]]
    against = 2 * sum(votes) > len(votes)
    return Oriented(observed.reversed() if against else observed, against)


def _alike(observed: Interface, run: Interface) -> bool:
    """Return whether a run can be compared: it is of the same kind and the squares of its coordinates are finite."""
    same = run.dim == observed.dim and (run.closed or not observed.closed)
    return same and float(np.abs(run.points).max()) < LARGEST


def _distance(observed: Interface, run: Interface) -> float:
    """Return how far a run is from the observation, whatever its direction; used only for sorting."""
    if observed.dim == 3 or run.closed:
        return float(np.linalg.norm(observed.points.mean(axis=0) - run.points.mean(axis=0)))
    mine, theirs = observed.resampled(SHARES).points, run.resampled(SHARES).points
    return min(float(np.sum((mine - other) ** 2)) for other in (theirs, theirs[::-1]))
