"""Whitened normal offsets against plain geometry and one by one."""

import numpy as np
import pytest
from scipy.optimize import minimize
from tests.unit.discrepancy.curves import level, line, one_by_one, runs
from tests.unit.discrepancy.surfaces import sheet

from strandline.discrepancy import squared_discrepancies
from strandline.discrepancy.normal_offset import NormalOffset, WhitenedOffset, signed_distances, weighted_sums
from strandline.discrepancy.search.signed_sums import FEWEST, signed_sums
from strandline.interface import Interface, PointErrors

LINE = level(0.0)


def whitened(**errors: float) -> WhitenedOffset:
    return NormalOffset().whitened(PointErrors(**errors))


def test_distances_are_positive_on_the_side_of_the_normals() -> None:
    points = np.array([[0.35, 0.2], [0.5, -0.1], [1.35, 0.4], [1.04, 0.01], [-0.04, -0.02]])
    np.testing.assert_allclose(signed_distances(points, LINE), [0.2, -0.1, 0.5, 0.01, -0.02], rtol=1e-12)
    assert (LINE.normals[:, 1] > 0).all()


def test_independent_points_are_a_sum_of_squares_of_what_was_seen() -> None:
    assert NormalOffset()(LINE, level(0.03)) == pytest.approx(11 * 0.03**2)
    assert whitened(sd=0.01)(LINE, level(0.03)) == pytest.approx(11 * 9.0)
    assert whitened(sd=0.01).terms(LINE) == NormalOffset().terms(LINE) == 11
    part = Interface.polyline(level(0.01).points[3:7])
    assert whitened(sd=0.01)(LINE, part) == pytest.approx(4.0)


def test_a_common_offset_costs_as_one_error() -> None:
    assert whitened(sd=0.001, offset=0.02)(LINE, level(0.02)) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("kind", ["open", "closed"])
def test_many_are_as_one_by_one(kind: str) -> None:
    points, template, seen = runs(kind, 40)
    every = PointErrors(0.01, 0.05, 0.02, 1.0, 0.01, 0.01)
    for measure in (NormalOffset(), WhitenedOffset(PointErrors(0.01, 0.05)), WhitenedOffset(every)):
        found = measure.many(points, template, seen)
        assert found is not None
        np.testing.assert_allclose(found, one_by_one(measure, points, template, seen), rtol=1e-9)


def test_a_large_shift_and_rotation_are_found_although_the_outline_is_curved() -> None:
    """Against a minimisation over the global errors; linear ones are off by t²/(2R)."""
    x = np.linspace(0.0, 1.0, 201)
    outline = Interface.polyline(np.stack([x, 1.2 * x * (1 - x)], axis=1))
    errors = PointErrors(0.001, 0.0, shift=0.03, rotation=1.0, scale=0.01, offset=0.01)
    part = Interface.polyline(outline.points[30:-30])
    seen = errors.moved(errors.draw(part, np.random.default_rng(8)), np.array([1.3, -1.2, 1.5, -1.0, 0.8]))
    model, middle = errors.model(seen), seen.points.mean(axis=0)

    def cost(g: np.ndarray) -> float:
        moved = errors.followed(outline.points[None], outline, g[None], middle=middle)[0]
        residuals = signed_distances(seen.points, Interface(moved, outline.cells))
        return float((residuals**2 / model.local).sum() + g @ g)

    best = minimize(cost, np.zeros(5), method="BFGS", options={"gtol": 1e-2}).fun
    linear = float(model.square(signed_distances(seen.points, outline)))
    assert WhitenedOffset(errors)(outline, seen) == pytest.approx(best, rel=0.03)
    assert linear > best + 20


def test_signed_sums_are_those_of_the_distances() -> None:
    points, template, seen = runs("open", 40)
    random = np.random.default_rng(4)
    weights, features = random.random(len(seen.points)), random.normal(size=(len(seen.points), 3))
    found = weighted_sums(seen.points, points, template, weights, features)
    each = np.array([signed_distances(seen.points, Interface(row, template.cells)) for row in points])
    np.testing.assert_allclose(found[0], each**2 @ weights, rtol=1e-10)
    np.testing.assert_allclose(found[1], each @ features, atol=1e-12)


def test_few_runs_are_done_one_by_one() -> None:
    points, template, seen = runs("open", FEWEST - 1)
    some = np.ones(len(seen.points))
    assert signed_sums(seen.points, points, template.cells, some, some[:, None]) is None
    found = squared_discrepancies(NormalOffset(), points, template, seen)
    np.testing.assert_allclose(found, one_by_one(NormalOffset(), points, template, seen))


def test_surfaces_have_signed_distances_too() -> None:
    lower, upper = sheet(6), sheet(6, height=0.1)
    np.testing.assert_allclose(signed_distances(upper.points, lower), 0.1, atol=1e-12)
    np.testing.assert_allclose(signed_distances(lower.points, upper), -0.1, atol=1e-12)
    assert whitened(sd=0.05)(lower, upper) == pytest.approx(36 * 4.0)
    assert whitened(sd=0.001, offset=0.1)(lower, upper) == pytest.approx(1.0, rel=1e-3)
    found = NormalOffset().many(np.stack([lower.points] * 3), lower, upper)
    np.testing.assert_allclose(found, 36 * 0.1**2)


def test_the_nearest_side_of_a_corner_gives_the_sign() -> None:
    corner = line((0, 0), (1, 0), (1, 1))
    np.testing.assert_allclose(
        signed_distances(np.array([[0.9, 0.3], [1.2, 0.3], [1.3, -0.4]]), corner), [0.1, -0.2, -0.5]
    )
