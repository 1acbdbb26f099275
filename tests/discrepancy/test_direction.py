"""The direction of an observation, from the runs nearest to it."""

import numpy as np
import pytest

from strandline.discrepancy import oriented_like_runs
from strandline.interface import Interface

S = np.linspace(0.0, 1.0, 41)


def arch(height: float) -> Interface:
    return Interface.polyline(np.column_stack([S, height * S * (1 - S) * (1 + S)]))


RUNS = [arch(height) for height in np.linspace(0.1, 3.0, 30)]


@pytest.mark.parametrize("reverse", [False, True])
def test_an_observation_is_run_through_as_most_of_the_nearest_runs(reverse: bool) -> None:
    seen = arch(0.8).resampled(17)
    found = oriented_like_runs(seen.reversed() if reverse else seen, RUNS)
    assert found.flipped == reverse
    np.testing.assert_array_equal(found.interface.points, seen.points)


def test_a_flipped_run_near_the_observation_is_outvoted() -> None:
    runs = [arch(0.8).reversed(), *RUNS]
    assert not oriented_like_runs(arch(0.8), runs).flipped


def test_runs_far_away_do_not_vote() -> None:
    """They come first, and are more."""
    far = [arch(height).reversed() for height in np.linspace(5.0, 6.0, 40)]
    assert not oriented_like_runs(arch(0.8), [*far, *RUNS]).flipped
    assert oriented_like_runs(arch(5.5), [*RUNS, *far]).flipped


def test_runs_of_another_kind_and_far_beyond_numbers_do_not_count() -> None:
    ring = Interface.polyline(np.column_stack([np.cos(6 * S[:-1]), np.sin(6 * S[:-1])]), closed=True)
    huge = Interface.polyline(1e160 * RUNS[0].points)
    assert not oriented_like_runs(ring, [RUNS[0].reversed()]).flipped
    assert not oriented_like_runs(arch(0.8), [huge.reversed(), *RUNS]).flipped


@pytest.mark.parametrize("reverse", [False, True])
def test_an_arc_of_a_closed_outline_faces_the_same_side(reverse: bool) -> None:
    angle = np.linspace(0.0, 2 * np.pi, 90, endpoint=False)
    radius = 1 + 0.4 * np.cos(3 * angle)  # with hollows, in which an arc bends the other way
    ring = Interface.polyline(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]), closed=True)
    for first in (0, 12, 25, 40):
        arc = Interface.polyline(ring.points[first : first + 14] * 1.01)
        assert oriented_like_runs(arc.reversed() if reverse else arc, [ring]).flipped == reverse


@pytest.mark.parametrize("reverse", [False, True])
def test_closed_outlines_by_the_side_they_face(reverse: bool) -> None:
    angle = 2 * np.pi * S[:-1]
    rings = [Interface.polyline(r * np.column_stack([np.cos(angle), np.sin(angle)]), closed=True) for r in (1.0, 1.1)]
    assert oriented_like_runs(rings[0].reversed() if reverse else rings[0], rings).flipped == reverse


def test_closed_outlines_nearest_to_the_observation_vote() -> None:
    """More rings around the origin run the other way round."""
    angle = 2 * np.pi * S[:-1]
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    near = [Interface.polyline(r * ring + np.array([5.0, 0.0]), closed=True) for r in np.linspace(0.9, 1.1, 20)]
    far = [Interface.polyline(ring + np.array([200.0, k]), closed=True).reversed() for k in range(40)]
    assert not oriented_like_runs(near[3], [*far, *near]).flipped
    assert oriented_like_runs(far[3].reversed(), [*far, *near]).flipped
