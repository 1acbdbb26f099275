"""Conformance suite for discrepancies: what any `strandline.discrepancy.Discrepancy` must do."""

import itertools
import math
import pickle
from collections.abc import Callable

import numpy as np

from strandline import discrepancy
from strandline.interface import Interface
from strandline.testing import checks_of


def arch(height: float, nodes: int = 41) -> Interface:
    """Return an arch of 1 mm span and a height in mm."""
    x = np.linspace(0.0, 1.0, nodes)
    return Interface.polyline(np.stack([x, height * np.sin(np.pi * x)], axis=1))


def check_it_is_a_squared_distance(measure: discrepancy.Discrepancy) -> None:
    """It is finite and not negative."""
    value = measure(arch(0.3), arch(0.2))
    assert isinstance(value, float), f"d² is a {type(value).__name__}, not a float"
    assert math.isfinite(value), f"d² is {value}"
    assert value >= 0, f"d² is {value}"


def check_an_interface_is_no_distance_from_itself(measure: discrepancy.Discrepancy) -> None:
    """d² between an interface and itself is zero except for rounding."""
    far = measure(arch(0.4), arch(0.2))
    assert measure(arch(0.2), arch(0.2)) <= 1e-10 * far, "an interface differs from itself"


def check_it_grows_with_the_distance(measure: discrepancy.Discrepancy) -> None:
    """A larger difference between the interfaces gives a larger d²."""
    values = [measure(arch(height), arch(0.2)) for height in (0.21, 0.22, 0.24, 0.28)]
    assert all(less < more for less, more in itertools.pairwise(values)), "d² does not grow"


def check_it_changes_nothing(measure: discrepancy.Discrepancy) -> None:
    """The interfaces stay as they are, and a second call gives the same number."""
    simulated, observed = arch(0.3), arch(0.2)
    before = simulated.points.copy(), observed.points.copy()
    assert measure(simulated, observed) == measure(simulated, observed), "a second call gives another number"
    assert np.array_equal(simulated.points, before[0]), "it changes the simulated interface"
    assert np.array_equal(observed.points, before[1]), "it changes the observed interface"


def check_many_are_as_one_by_one(measure: discrepancy.Discrepancy) -> None:
    """A batch gives the same values as its members, to 1 %."""
    heights, template, observed = np.linspace(0.15, 0.3, 40), arch(0.2), arch(0.2)
    points = np.stack([arch(height).points for height in heights])
    together = discrepancy.squared_discrepancies(measure, points, template, observed)
    alone = np.array([measure(arch(height), observed) for height in heights])
    assert np.allclose(together, alone, rtol=1e-2, atol=1e-4 * alone.max()), "a batch gives other numbers"


def check_it_follows_offsets(measure: discrepancy.Discrepancy) -> None:
    """If it offers d² from signed distances, this is within 10 % of d² for interfaces that are close to each other."""
    if not isinstance(measure, discrepancy.FollowsOffsets):
        return
    observed, heights = arch(0.2), np.array([0.198, 0.199, 0.2, 0.201, 0.202])
    offsets = np.array([discrepancy.signed_distances(observed.points, arch(height)) for height in heights])
    found = measure.of_offsets(offsets, observed, len(observed.points))
    if found is not None:
        exact = np.array([measure(arch(height), observed) for height in heights])
        assert np.allclose(found, exact, rtol=0.1, atol=0.02 * exact.max()), "d² from signed distances is another one"


def check_it_can_be_sent(measure: discrepancy.Discrepancy) -> None:
    """A pickled copy, as worker processes get it, gives the same number."""
    copy = pickle.loads(pickle.dumps(measure))
    assert copy(arch(0.3), arch(0.2)) == measure(arch(0.3), arch(0.2)), "a pickled copy gives another number"


def check_unit_and_terms(measure: discrepancy.Discrepancy) -> None:
    """The unit is a string; the number of independent residuals is unknown or above 0."""
    assert isinstance(discrepancy.unit_of(measure), str), "the unit is not a string"
    terms = discrepancy.independent_terms(measure, arch(0.2))
    assert terms is None or terms > 0, "the number of independent residuals is not above 0"


CHECKS: dict[str, Callable[[discrepancy.Discrepancy], None]] = checks_of(globals())
