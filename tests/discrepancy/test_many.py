"""Many interfaces at once against one after the other."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from tests.discrepancy.surfaces import sheet, sphere

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
from strandline.discrepancy.currents import QUADRATURES
from strandline.discrepancy.products import many_currents
from strandline.discrepancy.products.many_currents import BLOCK, FEWEST
from strandline.discrepancy.products.pieces import Pairs
from strandline.errors import InvalidInterface
from strandline.interface import Interface
from strandline.models.biofilm.outline import Outline

LINES = [[x, 0.0, 0.1, 1.0] for x in (0.2, 0.5, 0.8)]
EXACT: list[Discrepancy] = [
    MeasurementLines(),
    MeasurementLines(3),
    MeasurementLines(7, reach=0.05),
    MeasurementLines(LINES),
    TrackedPoints(),
    NormalOffset(),
    *(ClosestPoint(direction=d, weighting=w) for d in DIRECTIONS for w in WEIGHTINGS),
]
CURRENTS = [
    *(Currents(width, quadrature=quadrature) for width in (0.02, 0.6) for quadrature in QUADRATURES),
    Currents(0.02, tolerance=1e-9),
]


def runs(kind: str, number: int, *, seed: int = 1, noise: float = 0.02) -> tuple[np.ndarray, Interface, Interface]:
    """Return points of perturbed interfaces, a template and an observed interface."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, 24)
    if kind == "open":
        base = Interface.polyline(np.stack([s, 0.2 * np.sin(4 * s)], axis=1))
    elif kind == "closed":
        base = Interface.polyline(
            np.stack([np.cos(2 * np.pi * s[:-1]), 0.6 * np.sin(2 * np.pi * s[:-1])], axis=1), closed=True
        )
    else:
        base = sheet(5, bend=0.1) if kind == "sheet" else sphere(1.0, 1)
    seen = Interface(base.points + 0.5 * noise * rng.standard_normal(base.points.shape), base.cells)
    smooth = rng.normal(size=(number, 1, base.dim)) * np.sin(3 * base.points.sum(axis=1))[:, None]
    jagged = 0.2 * rng.standard_normal((number, *base.points.shape))
    return base.points + noise * (smooth + jagged), base, seen


def one_by_one(measure: Discrepancy, points: np.ndarray, template: Interface, seen: Interface) -> np.ndarray:
    return np.array([measure(Interface(row, template.cells), seen) for row in points])


@pytest.mark.parametrize("kind", ["open", "closed"])
@pytest.mark.parametrize("measure", EXACT, ids=str)
def test_distances_are_the_same(measure: Discrepancy, kind: str) -> None:
    if kind == "closed" and isinstance(measure, MeasurementLines) and not isinstance(measure.lines, int):
        measure = MeasurementLines([[0.2, 0.0, 0.1, 1.0], [-0.3, 0.1, 1.0, 0.2]])
    points, template, seen = runs(kind, 40, noise=0.03)
    found = squared_discrepancies(measure, points, template, seen)
    np.testing.assert_allclose(found, one_by_one(measure, points, template, seen), rtol=1e-11, atol=1e-14)


def within(measure: Discrepancy, found: np.ndarray, expected: np.ndarray, seen: Interface) -> bool:
    """Tell whether d² is right, the refined currents to their tolerance of <T,T>."""
    bound = 1e-10
    if isinstance(measure, Currents):
        square = measure.inner(seen, seen)
        bound = (measure.tolerance if measure.quadrature == "refined" else 1e-12) * square
    return bool((found >= 0).all() and (np.abs(found - expected) <= bound).all())


@pytest.mark.parametrize(("kind", "noise"), [("open", 1e-3), ("closed", 0.02), ("open", 0.3)])
@pytest.mark.parametrize("measure", CURRENTS, ids=str)
def test_currents_keep_their_tolerance(measure: Currents, noise: float, kind: str) -> None:
    points, template, seen = runs(kind, 40, noise=noise)
    found = measure.many(points, template, seen)
    assert found is not None
    finer = replace(measure, tolerance=1e-11)
    assert within(measure, found, one_by_one(finer, points, template, seen), seen)


@pytest.mark.parametrize("quadrature", QUADRATURES)
@pytest.mark.parametrize("width", [0.002, 0.05])
def test_currents_of_a_sheared_biofilm_keep_their_tolerance(width: float, quadrature: str) -> None:
    """At 0.002 mm, segments are longer than a piece of the Gauss rule and are divided."""
    template = Outline().interface()
    x, y = template.points.T
    move = np.stack([y / 0.47 + 0.1 * np.sin(9 * x), -0.3 * x * y], axis=1)
    points = template.points + np.linspace(0.0, 0.09, 20)[:, None, None] * move
    seen = Interface(template.points + 0.05 * move, template.cells)
    measure = Currents(width, quadrature=quadrature)
    found = measure.many(points, template, seen)
    assert found is not None
    finer = replace(measure, tolerance=1e-11)
    assert within(measure, found, one_by_one(finer, points, template, seen), seen)


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_currents_know_no_unit(unit: float) -> None:
    points, template, seen = runs("open", 20)
    found = Currents(0.1).many(points, template, seen)
    other = Currents(0.1 * unit).many(
        unit * points + 5 * unit, template, Interface(unit * seen.points + 5 * unit, seen.cells)
    )
    assert found is not None
    assert other is not None
    np.testing.assert_allclose(other, unit**2 * found, rtol=1e-9, atol=1e-12 * unit**2)


def test_currents_of_unlike_runs_keep_their_tolerance() -> None:
    """Runs that are far off, turned and stretched: some pairs are far beyond what the loop need count."""
    points, template, seen = runs("open", 30)
    angles = np.linspace(0.0, 6.0, 30)
    turn = np.array([[np.cos(angles), -np.sin(angles)], [np.sin(angles), np.cos(angles)]])
    points = np.einsum("ijr,rpj->rpi", turn, points) * np.geomspace(1, 4, 30)[:, None, None]
    points[-3:] += 1e4
    each = [Interface(row, template.cells) for row in points]
    for width in (0.01, 3.0):
        measure = Currents(width)
        found = measure.many(points, template, seen)
        assert found is not None
        square, own = measure.inner(seen, seen), np.array([measure.inner(one, one) for one in each])
        expected = own - 2 * np.array([measure.inner(one, seen) for one in each]) + square
        assert (np.abs(found - expected) <= 2e-6 * np.maximum(own, square)).all()


@pytest.mark.parametrize("planted", ["a coarse rule", "a short reach", "nothing"])
def test_rules_that_are_too_coarse_show(planted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    points, template, seen = runs("open", 20)
    measure = Currents(0.02)
    if planted == "a coarse rule":
        monkeypatch.setattr(many_currents, "MARGIN", 1e4)
    elif planted == "a short reach":
        near = Pairs.near
        monkeypatch.setattr(Pairs, "near", lambda a, b, reach: near(a, b, 0.5 * reach))
    found = measure.many(points, template, seen)
    assert found is not None
    right = within(measure, found, one_by_one(replace(measure, tolerance=1e-10), points, template, seen), seen)
    assert right == (planted == "nothing")


def test_a_finer_tolerance_takes_higher_orders() -> None:
    points, template, seen = runs("open", 20)
    errors = []
    for tolerance in (1e-2, 1e-4, 1e-8):
        measure = Currents(0.05, tolerance=tolerance)
        found = measure.many(points, template, seen)
        assert found is not None
        exact = one_by_one(replace(measure, tolerance=1e-12), points, template, seen)
        errors.append(np.abs(found - exact).max() / measure.inner(seen, seen))
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 1e3 * errors[-1]


@pytest.mark.parametrize("kind", ["sheet", "sphere"])
@pytest.mark.parametrize(
    "measure",
    [TrackedPoints(), ClosestPoint(), ClosestPoint(direction="symmetric", weighting="length"), Currents(0.5)],
    ids=str,
)
def test_surfaces_are_the_same(measure: Discrepancy, kind: str) -> None:
    points, template, seen = runs(kind, FEWEST)
    found = squared_discrepancies(measure, points, template, seen)
    np.testing.assert_allclose(found, one_by_one(measure, points, template, seen), rtol=1e-11, atol=1e-14)


def test_every_registered_measure_is_looked_at() -> None:
    looked_at = {type(measure) for measure in EXACT} | {type(measure) for measure in CURRENTS}
    assert looked_at == set(DISCREPANCIES.values())


@pytest.mark.parametrize("number", [0, 1, BLOCK, 2 * BLOCK + 3])
def test_blocks_come_back_in_their_order(number: int) -> None:
    """They are sorted by place inside."""
    points, template, seen = runs("open", number, noise=0.01)
    for measure in (Currents(0.1, quadrature="centre"), Currents(0.1), ClosestPoint()):
        found = squared_discrepancies(measure, points, template, seen)
        assert found.shape == (number,)
        some = np.arange(0, number, 37)
        expected = one_by_one(measure, points[some], template, seen)
        assert within(measure, found[some], expected, seen)


def test_a_pair_out_of_reach_in_one_run_only_is_not_left_out() -> None:
    """Planted: a batch where one run lies beside the observed interface and all others far from it."""
    points, template, seen = runs("open", 60)
    points[1:] += 10.0
    measure = Currents(0.05)
    found = squared_discrepancies(measure, points, template, seen)
    expected = one_by_one(measure, points, template, seen)
    assert within(measure, found, expected, seen)
    assert found[0] < 0.5 * found[1:].min()


def test_interfaces_need_not_have_the_nodes_of_the_observed_one() -> None:
    points, template, seen = runs("open", FEWEST)
    coarse = seen.resampled(9)
    for measure in (MeasurementLines(4), ClosestPoint(), Currents(0.1)):
        found = squared_discrepancies(measure, points, template, coarse)
        expected = one_by_one(measure, points, template, coarse)
        assert within(measure, found, expected, coarse)
    with pytest.raises(InvalidInterface, match="do not correspond"):
        squared_discrepancies(TrackedPoints(), points, template, coarse)


def test_segments_many_widths_long_are_divided() -> None:
    base = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.1], [1.3, 0.0], [2.5, 0.2]]))
    points = base.points + 0.02 * np.random.default_rng(5).standard_normal((FEWEST, 4, 2))
    seen, measure = Interface.polyline(base.points + np.array([0.0, 0.01])), Currents(0.05)
    found = squared_discrepancies(measure, points, base, seen)
    assert within(measure, found, one_by_one(measure, points, base, seen), seen)


def test_a_measure_is_not_asked_for_no_interfaces() -> None:
    @dataclass(frozen=True)
    class Demanding(TrackedPoints):
        def many(self, points: np.ndarray, template: Interface, observed: Interface) -> np.ndarray:
            return super().many(points, template, observed) / (points[0] == points[0]).mean()

    points, template, seen = runs("open", 3)
    assert squared_discrepancies(Demanding(), points[:0], template, seen).shape == (0,)
    assert squared_discrepancies(Demanding(), points, template, seen).shape == (3,)


def test_a_plain_function_will_do() -> None:
    points, template, seen = runs("open", 5)

    def largest(simulated: Interface, observed: Interface) -> float:
        return float(np.max((simulated.points - observed.points) ** 2))

    expected = np.max((points - seen.points) ** 2, axis=(1, 2))
    np.testing.assert_array_equal(squared_discrepancies(largest, points, template, seen), expected)


def test_single_precision_is_left_to_the_way_run_by_run(monkeypatch: pytest.MonkeyPatch) -> None:
    s = np.linspace(0.0, 1.0, 40)
    seen = Interface.polyline(np.column_stack([s, 0.3 * np.sin(np.pi * s)]))
    points = np.stack([np.column_stack([s, h * np.sin(np.pi * s)]) for h in np.linspace(0.2, 0.4, FEWEST)])
    given = {"width": 0.05, "square": 1.0, "rule": many_currents.Rule(1e-6, 1e-3)}
    assert many_currents.currents_of_many(points, seen.cells, seen.points, seen.cells, **given) is not None
    monkeypatch.setattr(many_currents, "double", lambda: False)
    assert many_currents.currents_of_many(points, seen.cells, seen.points, seen.cells, **given) is None


def test_the_reach_is_that_of_the_longest_run() -> None:
    s = np.linspace(0.0, 1.0, 40)
    flat = np.column_stack([s, 0 * s])
    cells = Interface.polyline(flat).cells

    def reach(*heights: float) -> float:
        runs = np.stack([flat + h * np.column_stack([0 * s, np.sin(20 * s)]) for h in heights], axis=2)
        return many_currents._Batch.of(runs, cells, flat, cells, many_currents.Rule(1e-8, 1e-3)).reach

    assert reach(0.0, 0.5) == reach(0.5) > reach(0.0)
