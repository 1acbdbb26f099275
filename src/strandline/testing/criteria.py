"""Conformance suite for criteria of active designs: what any `strandline.design.active.Criterion` must do.

The state is that of a bent line with two inputs after ten runs.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from strandline.design import Criterion, State, learn, sobol
from strandline.discrepancy import TrackedPoints
from strandline.interface import Interface, Observation
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.runs import RunRecord
from strandline.testing import checks_of

SPACE = ParameterSpace((Parameter("a", Uniform(-1.0, 1.0)), Parameter("b", Uniform(-1.0, 1.0))))
RUNS = SPACE.to_physical(sobol(10, 2))
CANDIDATES = SPACE.to_physical(sobol(30, 2, scramble=1))
UNKNOWN = SPACE.to_physical(sobol(10, 2, scramble=2))
TARGETS = SPACE.to_physical(sobol(40, 2, scramble=3)) * 0.5
PICKED = 6


def line(x: Float[np.ndarray, " dim"]) -> Interface:
    """Return a line that is bent by the first input and lifted by the second."""
    s = np.linspace(0.0, 1.0, 9)
    return Interface.polyline(np.stack([s, 0.1 * (x[0] * s + np.sin(2 * x[0] + x[1]) * s**2 + 0.5 * x[1])], axis=1))


@lru_cache(maxsize=1)
def state() -> State:
    """Return the posterior after ten runs, as particles of equal weight."""
    records = [RunRecord(str(k), SPACE.as_mapping(x), "ok", {"": line(x)}) for k, x in enumerate(RUNS)]
    observation = Observation(line(np.array([0.2, 0.1])), 4e-4)
    knowledge = learn(RUNS, records, SPACE, (observation,), TrackedPoints())
    equal = np.full(len(TARGETS), -np.log(len(TARGETS)))
    values = knowledge.plug_in(TARGETS)
    return State(knowledge, TARGETS, equal, equal, equal, values, values)


def picked(criterion: Criterion) -> list[Float[np.ndarray, " dim"]]:
    """Return the picks; every third one explores."""
    pick = criterion(state(), CANDIDATES.copy(), UNKNOWN.copy(), TARGETS.copy())
    return [np.asarray(pick(k % 3 == 2)) for k in range(PICKED)]


def check_it_picks_from_what_it_is_given(criterion: Criterion) -> None:
    """A pick is a candidate, or one of the points to explore if it is to explore."""
    for k, x in enumerate(picked(criterion)):
        pool = UNKNOWN if k % 3 == 2 else CANDIDATES
        assert x.shape == (2,), f"a pick has the shape {x.shape}, not (dim,)"
        assert (pool == x).all(axis=1).any(), f"pick {k + 1} is none of the points that it was given"


def check_it_picks_each_point_once(criterion: Criterion) -> None:
    """A chosen run is not chosen again: a batch is chosen as if the runs before it had been made."""
    found = picked(criterion)
    assert len({x.tobytes() for x in found}) == len(found), "a point is picked twice"


def check_it_repeats_itself(criterion: Criterion) -> None:
    """The same state gives the same picks, so a resumed study makes the same runs."""
    first, second = picked(criterion), picked(criterion)
    assert np.array_equal(first, second), "a second call picks other points"


CHECKS: dict[str, Callable[[Criterion], None]] = checks_of(globals())
