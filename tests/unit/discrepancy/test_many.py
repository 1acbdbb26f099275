"""Many interfaces at once against one after the other."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from tests.unit.discrepancy.curves import line, one_by_one, runs, within

from strandline.discrepancy import (
    DISCREPANCIES,
    ClosestPoint,
    Currents,
    Discrepancy,
    MeasurementLines,
    NormalOffset,
    TrackedPoints,
    squared_discrepancies,
)
from strandline.discrepancy.closest_point import DIRECTIONS, WEIGHTINGS
from strandline.discrepancy.products import many_currents
from strandline.discrepancy.products.many_currents import BLOCK, FEWEST
from strandline.discrepancy.products.pieces import Pairs
from strandline.errors import InvalidInterface
from strandline.interface import Interface

EXACT: list[Discrepancy] = [
    MeasurementLines(),
    MeasurementLines(7, reach=0.05),
    MeasurementLines([[0.2, 0.0, 0.1, 1.0], [-0.3, 0.1, 1.0, 0.2]]),
    TrackedPoints(),
    NormalOffset(),
    *(ClosestPoint(direction=d, weighting=w) for d in DIRECTIONS for w in WEIGHTINGS),
]
CURRENTS = [
    (Currents(0.02), "open", 1e-3),
    (Currents(0.6), "closed", 0.02),
    (Currents(0.02, quadrature="centre"), "closed", 0.02),
]


@pytest.mark.parametrize("kind", ["open", "closed"])
def test_distances_are_the_same(kind: str) -> None:
    points, template, seen = runs(kind, 20, noise=0.03)
    for measure in EXACT if kind == "open" else EXACT[1:6]:
        if kind == "open" and isinstance(measure, MeasurementLines) and not isinstance(measure.lines, int):
            measure = MeasurementLines([[x, 0.0, 0.1, 1.0] for x in (0.2, 0.5, 0.8)])
        found = squared_discrepancies(measure, points, template, seen)
        np.testing.assert_allclose(found, one_by_one(measure, points, template, seen), rtol=1e-11, atol=1e-14)


def test_currents_keep_their_tolerance() -> None:
    for measure, kind, noise in CURRENTS:
        points, template, seen = runs(kind, 20, noise=noise)
        found = measure.many(points, template, seen)
        assert found is not None
        assert within(measure, found, one_by_one(replace(measure, tolerance=1e-11), points, template, seen), seen)


def test_every_registered_measure_is_looked_at() -> None:
    assert {type(measure) for measure in EXACT} | {type(measure) for measure, *_ in CURRENTS} == set(
        DISCREPANCIES.values()
    )


def test_currents_know_no_unit() -> None:
    points, template, seen = runs("open", 20)
    found = Currents(0.1).many(points, template, seen)
    for unit in (1e-3, 1e3):
        moved = Interface(unit * seen.points + 5 * unit, seen.cells)
        other = Currents(0.1 * unit).many(unit * points + 5 * unit, template, moved)
        np.testing.assert_allclose(other, unit**2 * found, rtol=1e-9, atol=1e-12 * unit**2)


def test_currents_of_unlike_runs_keep_their_tolerance() -> None:
    """Runs that are far off, turned and stretched: some pairs are far beyond what the loop need count."""
    points, template, seen = runs("open", 20)
    angles = np.linspace(0.0, 6.0, 20)
    turn = np.array([[np.cos(angles), -np.sin(angles)], [np.sin(angles), np.cos(angles)]])
    points = np.einsum("ijr,rpj->rpi", turn, points) * np.geomspace(1, 4, 20)[:, None, None]
    points[-3:] += 1e4
    each = [Interface(row, template.cells) for row in points]
    measure = Currents(0.02)
    found = measure.many(points, template, seen)
    square, own = measure.inner(seen, seen), np.array([measure.inner(one, one) for one in each])
    expected = own - 2 * np.array([measure.inner(one, seen) for one in each]) + square
    assert (np.abs(found - expected) <= 2e-6 * np.maximum(own, square)).all()


def coarse_orders(batch: many_currents._Batch) -> tuple[int, int]:
    return 1, 1


def half_as_near(a: object, b: object, reach: float, near: object = Pairs.near) -> object:
    return near(a, b, 0.5 * reach)  # type: ignore[operator]


def test_rules_that_are_too_coarse_show(monkeypatch: pytest.MonkeyPatch) -> None:
    points, template, seen = runs("open", 20)
    measure = Currents(0.02)
    expected = one_by_one(replace(measure, tolerance=1e-10), points, template, seen)
    assert within(measure, measure.many(points, template, seen), expected, seen)
    for owner, name, planted in ((many_currents._Batch, "orders", coarse_orders), (Pairs, "near", half_as_near)):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, planted)
            assert not within(measure, measure.many(points, template, seen), expected, seen)


def test_a_finer_tolerance_takes_higher_orders() -> None:
    points, template, seen = runs("open", 20)
    exact = one_by_one(Currents(0.05, tolerance=1e-12), points, template, seen)
    errors = [
        np.abs(Currents(0.05, tolerance=tolerance).many(points, template, seen) - exact).max()
        for tolerance in (1e-2, 1e-8)
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 1e3 * errors[-1]


@pytest.mark.parametrize("kind", ["sheet", "sphere"])
def test_surfaces_are_the_same(kind: str) -> None:
    points, template, seen = runs(kind, FEWEST)
    symmetric = ClosestPoint(direction="symmetric", weighting="length")
    for measure in (TrackedPoints(), ClosestPoint(), symmetric, Currents(0.5)):
        found = squared_discrepancies(measure, points, template, seen)
        np.testing.assert_allclose(found, one_by_one(measure, points, template, seen), rtol=1e-11, atol=1e-14)


def test_blocks_come_back_in_their_order() -> None:
    """They are sorted by place inside."""
    for number in (0, 1, 2 * BLOCK + 3):
        points, template, seen = runs("open", number, noise=0.01)
        for measure in (Currents(0.1, quadrature="centre"), Currents(0.1), ClosestPoint()):
            found = squared_discrepancies(measure, points, template, seen)
            assert found.shape == (number,)
            some = np.arange(0, number, 37)
            assert within(measure, found[some], one_by_one(measure, points[some], template, seen), seen)


def test_a_pair_out_of_reach_in_one_run_only_is_not_left_out() -> None:
    """Planted: a batch where one run lies beside the observed interface and all others far from it."""
    points, template, seen = runs("open", 20)
    points[1:] += 10.0
    found = squared_discrepancies(Currents(0.05), points, template, seen)
    assert within(Currents(0.05), found, one_by_one(Currents(0.05), points, template, seen), seen)
    assert found[0] < 0.5 * found[1:].min()


def test_interfaces_need_not_have_the_nodes_of_the_observed_one() -> None:
    points, template, seen = runs("open", FEWEST)
    coarse = seen.resampled(9)
    for measure in (MeasurementLines(4), ClosestPoint(), Currents(0.1)):
        found = squared_discrepancies(measure, points, template, coarse)
        assert within(measure, found, one_by_one(measure, points, template, coarse), coarse)
    with pytest.raises(InvalidInterface, match="do not correspond"):
        squared_discrepancies(TrackedPoints(), points, template, coarse)


def test_segments_many_widths_long_are_divided() -> None:
    base = line((0, 0), (1, 0.1), (1.3, 0), (2.5, 0.2))
    points = base.points + 0.02 * np.random.default_rng(5).standard_normal((FEWEST, 4, 2))
    seen, measure = Interface.polyline(base.points + np.array([0.0, 0.01])), Currents(0.05)
    found = squared_discrepancies(measure, points, base, seen)
    assert within(measure, found, one_by_one(measure, points, base, seen), seen)


def test_a_measure_is_not_asked_for_no_interfaces_and_a_plain_function_will_do() -> None:
    @dataclass(frozen=True)
    class Demanding(TrackedPoints):
        def many(self, points: np.ndarray, template: Interface, observed: Interface) -> np.ndarray:
            return super().many(points, template, observed) / (points[0] == points[0]).mean()

    def largest(simulated: Interface, observed: Interface) -> float:
        return float(np.max((simulated.points - observed.points) ** 2))

    points, template, seen = runs("open", 5)
    assert squared_discrepancies(Demanding(), points[:0], template, seen).shape == (0,)
    assert squared_discrepancies(Demanding(), points, template, seen).shape == (5,)
    expected = np.max((points - seen.points) ** 2, axis=(1, 2))
    np.testing.assert_array_equal(squared_discrepancies(largest, points, template, seen), expected)


def test_few_runs_and_single_precision_are_left_to_the_way_run_by_run(monkeypatch: pytest.MonkeyPatch) -> None:
    points, template, seen = runs("open", FEWEST)
    given = {"width": 0.05, "square": 1.0, "rule": many_currents.Rule(1e-6, 1e-3)}

    def done(some: np.ndarray) -> bool:
        return many_currents.currents_of_many(some, template.cells, seen.points, seen.cells, **given) is not None

    assert done(points)
    assert not done(points[1:])
    monkeypatch.setattr(many_currents, "double", lambda: False)
    assert not done(points)


def test_the_reach_is_that_of_the_longest_run() -> None:
    s = np.linspace(0.0, 1.0, 40)
    flat = np.column_stack([s, 0 * s])
    cells = Interface.polyline(flat).cells

    def reach(*heights: float) -> float:
        shapes = np.stack([flat + h * np.column_stack([0 * s, np.sin(20 * s)]) for h in heights], axis=2)
        return many_currents._Batch.of(shapes, cells, flat, cells, many_currents.Rule(1e-8, 1e-3)).reach

    assert reach(0.0, 0.5) == reach(0.5) > reach(0.0)
