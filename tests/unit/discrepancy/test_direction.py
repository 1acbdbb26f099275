"""The direction of an observation, from the runs nearest to it."""

import numpy as np
import pytest
from tests.unit.discrepancy.curves import ring

from strandline.discrepancy import oriented_like_runs
from strandline.interface import Interface

S = np.linspace(0.0, 1.0, 41)


def arch(height: float) -> Interface:
    return Interface.polyline(np.column_stack([S, height * S * (1 - S) * (1 + S)]))


RUNS = [arch(height) for height in np.linspace(0.1, 3.0, 30)]


def moved(interface: Interface, x: float, y: float = 0.0) -> Interface:
    return Interface(interface.points + np.array([x, y]), interface.cells)


@pytest.mark.parametrize("reverse", [False, True])
def test_an_observation_is_run_through_as_most_of_the_nearest_runs(reverse: bool) -> None:
    """An arch; a ring; arcs of a closed outline with hollows, in which an arc bends the other way."""
    angle = np.linspace(0.0, 2 * np.pi, 90, endpoint=False)
    radius = 1 + 0.4 * np.cos(3 * angle)
    whole = Interface.polyline(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]), closed=True)
    arcs = [Interface.polyline(whole.points[first : first + 14] * 1.01) for first in (0, 12, 25, 40)]
    cases = [(arch(0.8).resampled(17), RUNS), (ring(40), [ring(40), ring(40, 1.1)]), *((arc, [whole]) for arc in arcs)]
    for seen, runs in cases:
        found = oriented_like_runs(seen.reversed() if reverse else seen, runs)
        assert found.flipped == reverse
        np.testing.assert_array_equal(found.interface.points, seen.points)


def test_a_flipped_run_near_the_observation_is_outvoted() -> None:
    assert not oriented_like_runs(arch(0.8), [arch(0.8).reversed(), *RUNS]).flipped


def test_runs_far_away_do_not_vote() -> None:
    """They come first, and are more; also rings."""
    far = [arch(height).reversed() for height in np.linspace(5.0, 6.0, 40)]
    assert not oriented_like_runs(arch(0.8), [*far, *RUNS]).flipped
    assert oriented_like_runs(arch(5.5), [*RUNS, *far]).flipped
    near = [moved(ring(40, r), 5.0) for r in np.linspace(0.9, 1.1, 20)]
    away = [moved(ring(40), 200.0, k).reversed() for k in range(40)]
    assert not oriented_like_runs(near[3], [*away, *near]).flipped
    assert oriented_like_runs(away[3].reversed(), [*away, *near]).flipped


def test_runs_of_another_kind_and_far_beyond_numbers_do_not_count() -> None:
    huge = Interface.polyline(1e160 * RUNS[0].points)
    assert not oriented_like_runs(ring(40), [RUNS[0].reversed()]).flipped
    assert not oriented_like_runs(arch(0.8), [huge.reversed(), *RUNS]).flipped
