"""Sums of squared distances of very many runs at once against trying every segment."""

import numpy as np
import pytest
from tests.unit.discrepancy.curves import one_by_one, runs

from strandline.discrepancy import ClosestPoint, MeasurementLines, measurement_lines
from strandline.discrepancy.closest_point import DIRECTIONS, WEIGHTINGS, node_weights
from strandline.discrepancy.search import blocks, many_distances
from strandline.discrepancy.search.many_distances import BLOCK, FEWEST, sums_of_squares
from strandline.discrepancy.search.nearest import brute_force
from strandline.interface import Interface


def expected(points: np.ndarray, template: Interface, seen: Interface, direction: str) -> np.ndarray:
    there = [brute_force(row, seen).squares.sum() for row in points]
    back = [brute_force(seen.points, Interface(row, template.cells)).squares.sum() for row in points]
    return np.array(there if direction == "to_observed" else back)


def found(points: np.ndarray, template: Interface, seen: Interface, direction: str) -> np.ndarray:
    ones = np.ones((1, len(template.points) if direction == "to_observed" else len(seen.points)))
    if direction == "to_observed":
        sums = sums_of_squares(points, seen.points[None], seen.cells, ones)
    else:
        sums = sums_of_squares(seen.points[None], points, template.cells, ones)
    assert sums is not None
    return sums


@pytest.mark.parametrize("direction", DIRECTIONS[:2])
def test_no_closest_segment_is_left_out(direction: str) -> None:
    for kind, noise in (("open", 1e-6), ("open", 1e-3), ("closed", 0.05), ("open", 1.0), ("closed", 1.0)):
        points, template, seen = runs(kind, 40, noise=noise)
        expect = expected(points, template, seen, direction)
        np.testing.assert_allclose(found(points, template, seen, direction), expect, rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("direction", DIRECTIONS[:2])
def test_bounds_that_are_too_tight_show(direction: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: nodes are taken to move half as far as they do."""
    points, template, seen = runs("open", 80, noise=0.2)
    expect = expected(points, template, seen, direction)

    def halved(array: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        middle, _ = blocks.motion(array)
        return middle, 0.5 * np.linalg.norm(array - middle, axis=-1).max(axis=0)

    monkeypatch.setattr(many_distances, "motion", halved)
    assert np.abs(found(points, template, seen, direction) / expect - 1).max() > 1e-6


def test_blocks_come_back_in_their_order() -> None:
    for number, noise in ((FEWEST, 1e-3), (BLOCK, 1.0), (BLOCK + 1, 1.0), (3 * BLOCK + 5, 1e-3), (3 * BLOCK + 5, 1.0)):
        points, template, seen = runs("open", number, noise=noise)
        some = np.arange(0, number, 53)
        expect = expected(points[some], template, seen, "to_simulated")
        np.testing.assert_allclose(found(points, template, seen, "to_simulated")[some], expect, rtol=1e-10, atol=1e-14)


def test_all_polylines_of_a_batch_are_done_together_but_few_runs_are_not_worth_it() -> None:
    points, template, seen = runs("open", FEWEST)
    for direction in DIRECTIONS:
        for weighting in WEIGHTINGS:
            assert ClosestPoint(direction=direction, weighting=weighting).many(points, template, seen) is not None
    ones = np.ones((1, points.shape[1]))
    assert sums_of_squares(points[1:], seen.points[None], seen.cells, ones) is None


@pytest.mark.parametrize("kind", ["open", "closed"])
def test_weights_of_many_are_those_of_each(kind: str) -> None:
    points, template, _ = runs(kind, 20)
    weights = ClosestPoint(weighting="length")._weights(points, template)
    each = np.array([node_weights(Interface(row, template.cells)) for row in points])
    np.testing.assert_allclose(weights, each / each.sum(axis=1, keepdims=True), rtol=1e-13)


def test_lines_look_at_all_segments_that_they_may_cross(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: nodes are taken to move a tenth as far as they do."""
    measure = MeasurementLines(9, reach=0.2)

    def tenth(array: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        middle, moved = blocks.motion(array)
        return middle, 0.1 * moved

    for noise in (1e-3, 0.05, 1.0):
        points, template, seen = runs("open", 300, noise=noise)
        expect = one_by_one(measure, points, template, seen)
        np.testing.assert_allclose(measure.many(points, template, seen), expect, rtol=1e-12)
    monkeypatch.setattr(measurement_lines, "motion", tenth)
    assert not np.allclose(measure.many(points, template, seen), expect, rtol=1e-6)
