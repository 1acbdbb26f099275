"""Whitened normal offsets against plain geometry, one by one, and over all points instead of means of neighbours."""

import numpy as np
import pytest
from scipy.optimize import minimize
from tests.unit.discrepancy.curves import arch, level, line, one_by_one, runs
from tests.unit.discrepancy.surfaces import sheet

from strandline.discrepancy import WhitenedOffset
from strandline.discrepancy import normal_offset as module
from strandline.discrepancy.many_distances import FEWEST, signed_sums
from strandline.discrepancy.normal_offset import NormalOffset, local_means, signed_distances, weighted_sums
from strandline.interface import Interface, PointErrors

LINE = level(0.0)


def whitened(**errors: float) -> WhitenedOffset:
    return WhitenedOffset(PointErrors(**errors))


def test_distances_are_positive_on_the_side_of_the_normals_and_at_a_corner_of_its_nearest_side():
    points = np.array([[0.35, 0.2], [0.5, -0.1], [1.35, 0.4], [1.04, 0.01], [-0.04, -0.02]])
    np.testing.assert_allclose(signed_distances(points, LINE), [0.2, -0.1, 0.5, 0.01, -0.02], rtol=1e-12)
    assert (LINE.normals[:, 1] > 0).all()
    beside = np.array([[0.9, 0.3], [1.2, 0.3], [1.3, -0.4]])
    np.testing.assert_allclose(signed_distances(beside, line((0, 0), (1, 0), (1, 1))), [0.1, -0.2, -0.5])


def test_independent_points_are_a_sum_of_squares_and_a_common_offset_costs_as_one_error():
    assert NormalOffset()(LINE, level(0.03)) == pytest.approx(11 * 0.03**2)
    assert whitened(sd=0.01)(LINE, level(0.03)) == pytest.approx(11 * 9.0)
    assert whitened(sd=0.01).terms(LINE) == NormalOffset().terms(LINE) == 11
    part = Interface.polyline(level(0.01).points[3:7])
    assert whitened(sd=0.01)(LINE, part) == pytest.approx(4.0)
    assert whitened(sd=0.001, offset=0.02)(LINE, level(0.02)) == pytest.approx(1.0, rel=1e-3)


def test_surfaces_have_signed_distances_too():
    lower, upper = sheet(6), sheet(6, height=0.1)
    np.testing.assert_allclose(signed_distances(upper.points, lower), 0.1, atol=1e-12)
    np.testing.assert_allclose(signed_distances(lower.points, upper), -0.1, atol=1e-12)
    assert whitened(sd=0.001, offset=0.1)(lower, upper) == pytest.approx(1.0, rel=1e-3)
    found = NormalOffset().many(np.stack([lower.points] * 3), lower, upper)
    np.testing.assert_allclose(found, 36 * 0.1**2)


@pytest.mark.parametrize("kind", ["open", "closed"])
def test_many_are_as_one_by_one(kind):
    points, template, seen = runs(kind, 40)
    every = PointErrors(0.01, 0.05, 0.02, 1.0, 0.01, 0.01)
    for measure in (WhitenedOffset(PointErrors(0.01, 0.05)), WhitenedOffset(every)):
        found = measure.many(points, template, seen)
        np.testing.assert_allclose(found, one_by_one(measure, points, template, seen), rtol=1e-9)
    plain, some, few = NormalOffset(), np.ones(len(seen.points)), points[: FEWEST - 1]
    assert signed_sums(seen.points[None], few, template.cells, some[None], some[:, None]) is None
    np.testing.assert_allclose(plain.many(few, template, seen), one_by_one(plain, few, template, seen))


def test_a_large_shift_and_rotation_are_found_although_the_outline_is_curved():
    """Against a minimisation over the global errors; linear ones are off by t²/(2R)."""
    outline, errors = arch(nodes=201), PointErrors(0.001, 0.0, shift=0.03, rotation=1.0, scale=0.01, offset=0.01)
    part = Interface.polyline(outline.points[30:-30])
    seen = errors.moved(errors.draw(part, np.random.default_rng(8)), np.array([1.3, -1.2, 1.5, -1.0, 0.8]))
    model, middle = errors.model(seen), seen.points.mean(axis=0)

    def cost(g):
        moved = errors.followed(outline.points[None], outline, g[None], middle=middle)[0]
        residuals = signed_distances(seen.points, Interface(moved, outline.cells))
        return float((residuals**2 / model.local).sum() + g @ g)

    best = minimize(cost, np.zeros(5), method="BFGS", options={"gtol": 1e-2}).fun
    linear = float(model.square(signed_distances(seen.points, outline)))
    assert WhitenedOffset(errors)(outline, seen) == pytest.approx(best, rel=0.03)
    assert linear > best + 20


ERRORS = PointErrors(0.0004, 0.004, shift=0.004, rotation=0.2, scale=0.003, offset=0.003)


def observed(number: int) -> Interface:
    """Return a noisy arch with many points."""
    part = Interface.polyline(arch(nodes=number).points[number // 20 : -number // 20])
    return ERRORS.draw(part, np.random.default_rng(3))


SEEN, NEAR = observed(1600), arch(nodes=161)
RUNS = np.stack([arch(0.3 * (1 + h), 161).points for h in np.linspace(-0.02, 0.02, 40)])
"""Arches near the observed one: higher or lower by up to 2 %."""


@pytest.mark.parametrize("means", [False, True])
def test_signed_sums_are_those_of_the_distances_with_weights_and_features_that_differ(means):
    """In an outline of many points, means of neighbours stand for them."""
    points, template, seen = (RUNS, NEAR, SEEN) if means else runs("open", 40)
    random, (off_squares, off_products) = np.random.default_rng(5), (1e-3, 2e-3) if means else (1e-10, 1e-13)
    weights, features = random.uniform(0.5, 1.5, len(seen.points)), random.normal(size=(len(seen.points), 2))
    squares, products = weighted_sums(seen.points, points, template, weights, features)
    each = np.array([signed_distances(seen.points, Interface(row, template.cells)) for row in points])
    np.testing.assert_allclose(squares, each**2 @ weights, rtol=off_squares)
    np.testing.assert_allclose(products, each @ features, atol=off_products * np.abs(each).sum(axis=1).max())


def test_the_log_likelihood_is_that_of_all_points(monkeypatch):
    assert local_means(SEEN.points, module.PLACES) is not None
    found = WhitenedOffset(ERRORS).many(RUNS, NEAR, SEEN)
    monkeypatch.setattr(module, "local_means", lambda seen, number: None)
    exact = WhitenedOffset(ERRORS).many(RUNS, NEAR, SEEN)
    near = exact < exact.min() + 30
    assert near.sum() > 5
    np.testing.assert_allclose((found - exact)[near], (found - exact)[near].mean(), atol=0.3)
    np.testing.assert_allclose(found, exact, rtol=0.02, atol=3.0)


def on_a_circle(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return how far places that stand for 1600 points are from the middle, and how far the points are off them."""
    angle = np.linspace(0.0, 6.0, 1600)
    found = local_means(np.stack([np.cos(angle), np.sin(angle)], axis=1), number)
    return np.linalg.norm(found.places, axis=1), found.off


def test_places_lie_on_the_course_of_the_points(monkeypatch):
    """Planted: plain means of points on a curve, which lie inside it."""
    np.testing.assert_allclose(on_a_circle(50)[0], 1.0, atol=1e-4)
    assert np.abs(on_a_circle(40)[1]).max() < 1e-3
    assert len(on_a_circle(10)[0]) >= 18  # more where the points turn sharply
    plain = np.polyfit
    monkeypatch.setattr(np, "polyfit", lambda u, v, degree: (0.0, *plain(u, v, 1)))
    assert np.median(on_a_circle(51)[0]) < 1 - 3e-4


def test_the_direction_of_the_observed_points_does_not_matter():
    ones = np.ones(len(SEEN.points))
    one, other = (weighted_sums(s.points, RUNS, NEAR, ones, ones[:, None]) for s in (SEEN, SEEN.reversed()))
    np.testing.assert_allclose(one[0], other[0], rtol=1e-4)
    np.testing.assert_allclose(one[1], other[1], rtol=1e-2, atol=1e-4)


def test_few_points_points_without_an_order_and_those_across_a_gap_have_no_means():
    for points in (observed(1100).points, np.random.default_rng(1).permutation(SEEN.points)):
        assert local_means(points, 200) is None
    assert 603 in local_means(np.concatenate([SEEN.points[:603], SEEN.points[900:]]), 50).first
