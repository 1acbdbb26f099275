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


def observed(number: int = 1600, *, backwards: bool = False) -> Interface:
    """Return a noisy arch with many points."""
    true = arch(number)
    seen = Interface.polyline(true.points[number // 20 : -number // 20])
    noisy = ERRORS.draw(seen, np.random.default_rng(3))
    return noisy.reversed() if backwards else noisy


def interfaces(number: int = 40) -> np.ndarray:
    """Return arches near the observed one: higher or lower by up to 2 %."""
    return np.stack([arch(161, 1.2 * (1 + h)).points for h in np.linspace(-0.02, 0.02, number)])


def differences(monkeypatch: pytest.MonkeyPatch, seen: Interface) -> tuple[np.ndarray, np.ndarray]:
    """Return d² by means, and by all points."""
    measure, points = WhitenedOffset(ERRORS), interfaces()
    assert local_means(seen.points, module.PLACES) is not None
    found = measure.many(points, arch(161), seen)
    with monkeypatch.context() as patch:
        patch.setattr(module, "local_means", lambda seen, number: None)
        return found, measure.many(points, arch(161), seen)


def test_the_log_likelihood_is_that_of_all_points(monkeypatch: pytest.MonkeyPatch) -> None:
    found, exact = differences(monkeypatch, observed())
    near = exact < exact.min() + 30
    assert near.sum() > 5
    np.testing.assert_allclose((found - exact)[near], (found - exact)[near].mean(), atol=0.3)
    np.testing.assert_allclose(found, exact, rtol=0.02, atol=3.0)


def on_a_circle(number: int) -> np.ndarray:
    """Return the distances from the middle of the places that stand for 1600 points on a circle of radius 1."""
    angle = np.linspace(0.0, 6.0, 1600)
    found = local_means(np.stack([np.cos(angle), np.sin(angle)], axis=1), number)
    assert found is not None
    return np.asarray(np.linalg.norm(found.places, axis=1))


def test_places_lie_on_the_course_of_the_points() -> None:
    np.testing.assert_allclose(on_a_circle(50), 1.0, atol=1e-4)
    assert len(on_a_circle(10)) >= 18  # more where the points turn sharply


def test_means_that_forget_the_curvature_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plain means of points on a curve lie inside it."""
    plain = np.polyfit
    monkeypatch.setattr(np, "polyfit", lambda u, v, degree: (0.0, *plain(u, v, 1)))
    assert np.median(on_a_circle(51)) < 1 - 3e-4


def test_weights_and_features_that_differ_from_point_to_point() -> None:
    seen, points, random = observed(), interfaces(), np.random.default_rng(5)
    weights, features = random.uniform(0.5, 1.5, len(seen.points)), random.normal(size=(len(seen.points), 2))
    assert local_means(seen.points, module.PLACES) is not None
    squares, products = weighted_sums(seen.points, points, arch(161), weights, features)
    each = np.array([signed_distances(seen.points, Interface(row, arch(161).cells)) for row in points])
    np.testing.assert_allclose(squares, each**2 @ weights, rtol=1e-3)
    np.testing.assert_allclose(products, each @ features, atol=2e-3 * float(np.abs(each).sum(axis=1).max()))


def test_the_direction_of_the_observed_points_does_not_matter() -> None:
    points, ones = interfaces(), np.ones(len(observed().points))
    one, other = (
        weighted_sums(seen.points, points, arch(161), ones, ones[:, None])
        for seen in (observed(), observed(backwards=True))
    )
    np.testing.assert_allclose(one[0], other[0], rtol=1e-4)
    np.testing.assert_allclose(one[1], other[1], rtol=1e-2, atol=1e-4)


def test_few_points_and_points_without_an_order_have_no_means() -> None:
    assert local_means(observed(300).points, 200) is None
    assert local_means(observed(1100).points, 200) is None  # four or five points a place would move posteriors
    shuffled = np.random.default_rng(1).permutation(observed().points)
    assert local_means(shuffled, 200) is None


def test_points_across_a_gap_are_not_averaged() -> None:
    points = observed().points
    parts = np.concatenate([points[:603], points[900:]])
    found = local_means(parts, 50)
    assert found is not None
    assert 603 in found.first


def test_points_on_a_circle_lie_on_their_course() -> None:
    angle = np.linspace(0.0, 6.0, 1600)
    found = local_means(np.stack([np.cos(angle), np.sin(angle)], axis=1), 40)
    assert found is not None
    assert np.abs(found.off).max() < 1e-3
