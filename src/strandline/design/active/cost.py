"""Cost of choosing a batch, in seconds to compare interfaces, estimated before any batch is chosen."""

import time
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from strandline.design.active.sampling import MANY_INPUTS_PARTICLES, PARTICLES, SAMPLING
from strandline.discrepancy import Discrepancy, squared_discrepancies
from strandline.discrepancy.normal_offset import WhitenedOffset
from strandline.interface import Interface, Observation
from strandline.likelihood import compared
from strandline.likelihood.field import DRAWS, noise_length
from strandline.likelihood.nearby import follows_offsets

__all__ = ["SLOW_BATCH", "seconds_of_a_batch"]

SLOW_BATCH = 30.0
"""Seconds from which a batch counts as slow."""
TEMPERING_STEPS = 20
"""Tempering steps from the prior to a much narrower posterior: 21 for a drop with five inputs."""
FROM_THE_PRIOR = 1 + TEMPERING_STEPS * SAMPLING.rejuvenation_steps + DRAWS
"""Comparisons of each particle that is sampled from the prior."""
NEARBY = 2 + SAMPLING.rejuvenation_steps
"""Comparisons of each particle that a likelihood nearby has led to the posterior."""
TRIED = 32, 1024
"""Interfaces compared to measure the cost of one; the larger number if the smaller takes less than `QUICK`."""
QUICK = 0.2
REPEATS = 3
"""The fastest comparison counts, because other work on the machine slows comparisons down."""

Clocks = tuple[Callable[[], float], ...]


def seconds_of_a_batch(
    observations: tuple[Observation, ...],
    discrepancy: Discrepancy,
    simulated: Mapping[str, Interface],
    dim: int,
    *,
    clocks: Clocks = (time.perf_counter, time.process_time),
) -> float:
    """Return the seconds that comparing interfaces takes in the choice of one batch, estimated by a trial.

    Args:
        observations: one for each observed condition.
        discrepancy: the measure that defines the posterior.
        simulated: an interface of each condition, as the simulator returns it.
        dim: number of inputs.
        clocks: functions that return seconds; the one counts by which a comparison takes least.
    """
    total = 0.0
    for seen in observations:
        template = simulated[seen.condition]
        measure, width = compared(seen, discrepancy, len(template.points)).measure, noise_length(seen, discrepancy)
        each = _seconds_of_one(seen, measure, template, width, clocks)
        total += each * (NEARBY if _has_nearby(measure, seen, len(template.points)) else FROM_THE_PRIOR)
    return total * PARTICLES.get(dim, MANY_INPUTS_PARTICLES)


def _has_nearby(measure: Discrepancy, seen: Observation, nodes: int) -> bool:
    return seen.interface.dim == 2 and (isinstance(measure, WhitenedOffset) or follows_offsets(measure, seen, nodes))


def _seconds_of_one(
    seen: Observation, measure: Discrepancy, simulated: Interface, width: float, clocks: Clocks
) -> float:
    """Return the seconds per comparison in a batch of interfaces that are at most `width`, mm, apart."""
    for number in TRIED:
        points = simulated.points + width * np.linspace(-1.0, 1.0, number)[:, None, None]
        squared_discrepancies(measure, points, simulated, seen.interface)  # compiles, and fills caches
        seconds = min(_seconds(seen, measure, simulated, points, clocks) for _ in range(REPEATS))
        if seconds > QUICK:
            break
    return seconds / number


def _seconds(
    seen: Observation,
    discrepancy: Discrepancy,
    simulated: Interface,
    points: Float[np.ndarray, "run point xyz"],
    clocks: Clocks,
) -> float:
    """Return the seconds to compare all interfaces once: wall-clock time, or processor time if that is less."""
    begun = [clock() for clock in clocks]
    squared_discrepancies(discrepancy, points, simulated, seen.interface)
    return min(clock() - start for clock, start in zip(clocks, begun, strict=True))
