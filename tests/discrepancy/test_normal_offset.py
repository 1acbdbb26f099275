"""Whitened normal offsets against plain geometry and one by one."""

import numpy as np
import pytest
from scipy.optimize import minimize
from tests.discrepancy.test_many import one_by_one, runs

from strandline.discrepancy import squared_discrepancies
from strandline.discrepancy.normal_offset import NormalOffset, WhitenedOffset, signed_distances, weighted_sums
from strandline.discrepancy.search import signed_sums as module
from strandline.discrepancy.search.signed_sums import signed_sums
from strandline.interface import Interface, PointErrors

LINE = Interface.polyline(np.stack([np.linspace(0.0, 1.0, 11), np.zeros(11)], axis=1))
ALL = PointErrors(0.01, 0.05, 0.02, 1.0, 0.01, 0.01)
MEASURES = [NormalOffset(), *(WhitenedOffset(one) for one in (PointErrors(0.01), PointErrors(0.01, 0.05), ALL))]


def whitened(**errors: float) -> WhitenedOffset:
    return NormalOffset().whitened(PointErrors(**errors))


def test_distances_are_positive_on_the_side_of_the_normals() -> None:
    points = np.array([[0.35, 0.2], [0.5, -0.1], [1.35, 0.4], [1.04, 0.01], [-0.04, -0.02]])
    np.testing.assert_allclose(signed_distances(points, LINE), [0.2, -0.1, 0.5, 0.01, -0.02], rtol=1e-12)
    assert (LINE.normals[:, 1] > 0).all()


def test_independent_points_are_a_sum_of_squares() -> None:
    seen = Interface.polyline(LINE.points + np.array([0.0, 0.03]))
    assert NormalOffset()(LINE, seen) == pytest.approx(11 * 0.03**2)
    assert whitened(sd=0.01)(LINE, seen) == pytest.approx(11 * 9.0)
    assert whitened(sd=0.01).terms(seen) == NormalOffset().terms(seen) == 11


def test_what_was_not_seen_costs_nothing() -> None:
    seen = Interface.polyline(LINE.points[3:7] + np.array([0.0, 0.01]))
    assert whitened(sd=0.01)(LINE, seen) == pytest.approx(4.0)


def test_a_common_offset_costs_as_one_error() -> None:
    seen = Interface.polyline(LINE.points + np.array([0.0, 0.02]))
    found = whitened(sd=0.001, offset=0.02)(LINE, seen)
    assert found == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("kind", ["open", "closed"])
@pytest.mark.parametrize("measure", MEASURES, ids=str)
def test_many_are_as_one_by_one(measure: NormalOffset | WhitenedOffset, kind: str) -> None:
    points, template, seen = runs(kind, 60)
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

    best = minimize(cost, np.zeros(5), method="BFGS").fun
    linear = float(model.square(signed_distances(seen.points, outline)))
    assert WhitenedOffset(errors)(outline, seen) == pytest.approx(best, rel=0.03)
    assert linear > best + 20


def test_signed_sums_are_those_of_the_distances() -> None:
    points, template, seen = runs("open", 50)
    random = np.random.default_rng(4)
    weights, features = random.random(len(seen.points)), random.normal(size=(len(seen.points), 3))
    found = weighted_sums(seen.points, points, template, weights, features)
    each = np.array([signed_distances(seen.points, Interface(row, template.cells)) for row in points])
    np.testing.assert_allclose(found[0], each**2 @ weights, rtol=1e-10)
    np.testing.assert_allclose(found[1], each @ features, atol=1e-12)


def test_few_runs_are_done_one_by_one() -> None:
    points, template, seen = runs("open", module.FEWEST - 1)
    some = np.ones(len(seen.points))
    assert signed_sums(seen.points, points, template.cells, some, some[:, None]) is None
    found = squared_discrepancies(MEASURES[0], points, template, seen)
    np.testing.assert_allclose(found, one_by_one(MEASURES[0], points, template, seen))


def sheet(height: float, number: int = 6) -> Interface:
    """Return a flat square of side 1 at some height, its normals upwards."""
    x, y = (one.ravel() for one in np.meshgrid(*2 * [np.linspace(0.0, 1.0, number)], indexing="ij"))
    corner = np.arange(number * number).reshape(number, number)
    a, b, c, d = (one.ravel() for one in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    cells = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Interface(np.stack([x, y, np.full(len(x), height)], axis=1), cells)


def test_surfaces_have_signed_distances_too() -> None:
    np.testing.assert_allclose(signed_distances(sheet(0.1).points, sheet(0.0)), 0.1, atol=1e-12)
    np.testing.assert_allclose(signed_distances(sheet(0.0).points, sheet(0.1)), -0.1, atol=1e-12)
    assert whitened(sd=0.05)(sheet(0.0), sheet(0.1)) == pytest.approx(36 * 4.0)
    assert whitened(sd=0.001, offset=0.1)(sheet(0.0), sheet(0.1)) == pytest.approx(1.0, rel=1e-3)
    found = NormalOffset().many(np.stack([sheet(0.0).points] * 3), sheet(0.0), sheet(0.1))
    np.testing.assert_allclose(found, 36 * 0.1**2)
