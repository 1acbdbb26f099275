"""How far interfaces are apart, in units of the noise and in mm."""

import numpy as np
import pytest

from strandline.discrepancy import ClosestPoint, Currents, apart, count_of_distances, noise_units
from strandline.interface import Interface


def level(y: float, *, length: float = 1.0, nodes: int = 11) -> Interface:
    x = np.linspace(0.0, length, nodes)
    return Interface.polyline(np.stack([x, np.full(nodes, y)], axis=1))


def test_a_sum_of_distances_counts_by_their_root_mean_square() -> None:
    """Eleven nodes are 0.3 mm off, under noise of 0.1 mm."""
    simulated, observed, measure = level(0.3), level(0.0, nodes=5), ClosestPoint()
    count = count_of_distances(measure, simulated, observed)
    assert count == 11
    assert noise_units(measure(simulated, observed), 0.1**2, count) == pytest.approx(3.0)


def test_what_is_no_sum_counts_whole() -> None:
    assert count_of_distances(Currents(0.1), level(0.3), level(0.0)) is None
    assert noise_units(0.09, 0.01, None) == pytest.approx(3.0)


def test_the_worse_direction_tells_how_far_interfaces_are_apart() -> None:
    """The end of the longer one is (0.3, 0.4) mm from that of the shorter one, whose nodes are all 0.3 mm from it."""
    short, long = level(0.0), Interface.polyline(np.array([[0.0, 0.3], [1.0, 0.3], [1.4, 0.3]]))
    for one, other in ((short, long), (long, short)):
        rms, largest = apart(one, other)
        assert largest == pytest.approx(0.5)
        assert rms == pytest.approx(np.sqrt((0.3**2 + 0.3**2 + 0.5**2) / 3))
