"""Means of neighbouring observed points against sums over all of them."""

import numpy as np
import pytest

from strandline.discrepancy import normal_offset as module
from strandline.discrepancy.normal_offset import WhitenedOffset, signed_distances, weighted_sums
from strandline.discrepancy.search.local_means import local_means
from strandline.interface import Interface, PointErrors

ERRORS = PointErrors(0.0004, 0.004, shift=0.004, rotation=0.2, scale=0.003, offset=0.003)


def arch(points: int, height: float = 1.2) -> Interface:
    x = np.linspace(0.0, 1.0, points)
    return Interface.polyline(np.stack([x, height * x * (1 - x)], axis=1))


def observed(number: int = 1600) -> Interface:
    """Return a noisy arch with many points."""
    part = Interface.polyline(arch(number).points[number // 20 : -number // 20])
    return ERRORS.draw(part, np.random.default_rng(3))


SEEN = observed()
RUNS = np.stack([arch(161, 1.2 * (1 + h)).points for h in np.linspace(-0.02, 0.02, 40)])
"""Arches near the observed one: higher or lower by up to 2 %."""


def test_the_log_likelihood_is_that_of_all_points(monkeypatch: pytest.MonkeyPatch) -> None:
    assert local_means(SEEN.points, module.PLACES) is not None
    found = WhitenedOffset(ERRORS).many(RUNS, arch(161), SEEN)
    monkeypatch.setattr(module, "local_means", lambda seen, number: None)
    exact = WhitenedOffset(ERRORS).many(RUNS, arch(161), SEEN)
    near = exact < exact.min() + 30
    assert near.sum() > 5
    np.testing.assert_allclose((found - exact)[near], (found - exact)[near].mean(), atol=0.3)
    np.testing.assert_allclose(found, exact, rtol=0.02, atol=3.0)


def on_a_circle(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return how far places that stand for 1600 points are from the middle, and how far the points are off them."""
    angle = np.linspace(0.0, 6.0, 1600)
    found = local_means(np.stack([np.cos(angle), np.sin(angle)], axis=1), number)
    assert found is not None
    return np.linalg.norm(found.places, axis=1), found.off


def test_places_lie_on_the_course_of_the_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: plain means of points on a curve, which lie inside it."""
    np.testing.assert_allclose(on_a_circle(50)[0], 1.0, atol=1e-4)
    assert np.abs(on_a_circle(40)[1]).max() < 1e-3
    assert len(on_a_circle(10)[0]) >= 18  # more where the points turn sharply
    plain = np.polyfit
    monkeypatch.setattr(np, "polyfit", lambda u, v, degree: (0.0, *plain(u, v, 1)))
    assert np.median(on_a_circle(51)[0]) < 1 - 3e-4


def test_weights_and_features_that_differ_from_point_to_point() -> None:
    random = np.random.default_rng(5)
    weights, features = random.uniform(0.5, 1.5, len(SEEN.points)), random.normal(size=(len(SEEN.points), 2))
    squares, products = weighted_sums(SEEN.points, RUNS, arch(161), weights, features)
    each = np.array([signed_distances(SEEN.points, Interface(row, arch(161).cells)) for row in RUNS])
    np.testing.assert_allclose(squares, each**2 @ weights, rtol=1e-3)
    np.testing.assert_allclose(products, each @ features, atol=2e-3 * float(np.abs(each).sum(axis=1).max()))


def test_the_direction_of_the_observed_points_does_not_matter() -> None:
    ones = np.ones(len(SEEN.points))
    one, other = (weighted_sums(s.points, RUNS, arch(161), ones, ones[:, None]) for s in (SEEN, SEEN.reversed()))
    np.testing.assert_allclose(one[0], other[0], rtol=1e-4)
    np.testing.assert_allclose(one[1], other[1], rtol=1e-2, atol=1e-4)


def test_few_points_and_points_without_an_order_have_no_means() -> None:
    assert local_means(observed(300).points, 200) is None
    assert local_means(observed(1100).points, 200) is None  # four or five points a place would move posteriors
    assert local_means(np.random.default_rng(1).permutation(SEEN.points), 200) is None


def test_points_across_a_gap_are_not_averaged() -> None:
    found = local_means(np.concatenate([SEEN.points[:603], SEEN.points[900:]]), 50)
    assert found is not None
    assert 603 in found.first
