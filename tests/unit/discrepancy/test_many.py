"""Many interfaces at once against one after the other, and against trying every segment."""

from dataclasses import replace

import numpy as np
import pytest
from tests.unit.discrepancy.curves import graph, line, one_by_one, runs, within

from strandline.discrepancy import (
    ClosestPoint,
    Currents,
    MeasurementLines,
    NormalOffset,
    TrackedPoints,
    many_currents,
    many_distances,
    measurement_lines,
    squared_discrepancies,
)
from strandline.discrepancy.closest_point import DIRECTIONS, WEIGHTINGS
from strandline.discrepancy.many_currents import BLOCK, FEWEST, PiecePairs
from strandline.foundations import InvalidInterface
from strandline.interface import Interface

LINES = MeasurementLines(9, reach=0.2)
OPEN_ONLY = [MeasurementLines(), MeasurementLines([[x, 0.0, 0.1, 1.0] for x in (0.2, 0.5, 0.8)])]
CLOSEST = [ClosestPoint(direction=d, weighting=w) for d in DIRECTIONS for w in WEIGHTINGS]
PLANE = [LINES, TrackedPoints(), NormalOffset(), *CLOSEST]
SURFACES = [TrackedPoints(), *CLOSEST, Currents(0.5)]
MEASURES = {"open": OPEN_ONLY + PLANE, "closed": PLANE, "sheet": SURFACES, "sphere": SURFACES}


@pytest.mark.parametrize("kind", MEASURES)
def test_distances_are_the_same(kind):
    points, template, seen = runs(kind, FEWEST)
    for measure in MEASURES[kind]:
        found = squared_discrepancies(measure, points, template, seen)
        np.testing.assert_allclose(found, one_by_one(measure, points, template, seen), rtol=1e-11, atol=1e-14)


def test_currents_know_no_unit():
    points, template, seen = runs("open", 20)
    found = Currents(0.1).many(points, template, seen)
    for unit in (1e-3, 1e3):
        moved = Interface(unit * seen.points + 5 * unit, seen.cells)
        other = Currents(0.1 * unit).many(unit * points + 5 * unit, template, moved)
        np.testing.assert_allclose(other, unit**2 * found, rtol=1e-9, atol=1e-12 * unit**2)


def test_rules_that_are_too_coarse_show(monkeypatch):
    points, template, seen = runs("open", 20)
    measure, near = Currents(0.02), PiecePairs.near
    expected = one_by_one(replace(measure, tolerance=1e-10), points, template, seen)
    assert within(measure, measure.many(points, template, seen), expected, seen)
    for owner, name, planted in (
        (many_currents._Batch, "orders", lambda batch: (1, 1)),
        (PiecePairs, "near", lambda a, b, reach: near(a, b, 0.5 * reach)),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, planted)
            assert not within(measure, measure.many(points, template, seen), expected, seen)


def test_blocks_come_back_in_their_order():
    """They are sorted by place inside."""
    measures = Currents(0.1, quadrature="centre"), Currents(0.1), ClosestPoint(), ClosestPoint(direction="to_simulated")
    for number in (0, 1, 2 * BLOCK + 3):
        for measure, noise in zip(measures, (0.01, 0.01, 0.01, 1.0), strict=True):
            points, template, seen = runs("open", number, noise=noise)
            found = squared_discrepancies(measure, points, template, seen)
            assert found.shape == (number,)
            some = np.arange(0, number, 37)
            assert within(measure, found[some], one_by_one(measure, points[some], template, seen), seen)


def test_interfaces_need_not_have_the_nodes_of_the_observed_one():
    for kind, measures in (
        ("closed", (Currents(0.6), Currents(0.02, quadrature="centre"))),
        ("open", (MeasurementLines(4), ClosestPoint(), Currents(0.1))),
    ):
        points, template, seen = runs(kind, FEWEST)
        coarse = seen.resampled(9)
        for measure in measures:
            found = squared_discrepancies(measure, points, template, coarse)
            assert within(measure, found, one_by_one(measure, points, template, coarse), coarse)
    with pytest.raises(InvalidInterface, match="do not correspond"):
        squared_discrepancies(TrackedPoints(), points, template, coarse)


def test_segments_many_widths_long_are_divided():
    base = line((0, 0), (1, 0.1), (1.3, 0), (2.5, 0.2))
    points = base.points + 0.02 * np.random.default_rng(5).standard_normal((FEWEST, 4, 2))
    seen, measure = Interface.polyline(base.points + np.array([0.0, 0.01])), Currents(0.05)
    found = squared_discrepancies(measure, points, base, seen)
    assert within(measure, found, one_by_one(measure, points, base, seen), seen)


def test_a_measure_is_not_asked_for_no_interfaces():
    class Demanding(TrackedPoints):
        def many(self, points, template, observed):
            return super().many(points, template, observed) / (points[0] == points[0]).mean()

    points, template, seen = runs("open", 5)
    for number in (0, 5):
        assert squared_discrepancies(Demanding(), points[:number], template, seen).shape == (number,)


def test_few_runs_and_single_precision_are_left_to_the_way_run_by_run(monkeypatch):
    points, template, seen = runs("open", FEWEST)
    given = {"width": 0.05, "square": 1.0, "tolerance": 1e-6, "share": 1e-3}

    def done(some):
        return many_currents.currents_of_many(some, template.cells, seen.points, seen.cells, **given) is not None

    assert done(points)
    assert not done(points[1:])
    monkeypatch.setattr(many_currents, "double", lambda: False)
    assert not done(points)


def test_the_reach_is_that_of_the_longest_run():
    s = np.linspace(0.0, 1.0, 40)
    flat = graph(s, 0 * s)

    def reach(*heights):
        shapes = np.stack([graph(s, h * np.sin(20 * s)).points for h in heights], axis=2)
        return many_currents._Batch(shapes, flat.cells, flat.points, flat.cells, 1e-8, 1e-3).reach

    assert reach(0.0, 0.5) == reach(0.5) > reach(0.0)


@pytest.mark.parametrize(
    ("measure", "module"),
    [*((ClosestPoint(direction=d), many_distances) for d in DIRECTIONS[:2]), (LINES, measurement_lines)],
)
def test_no_segment_is_left_out(measure, module, monkeypatch):
    """Planted: nodes are taken to move a tenth as far as they do."""
    for kind, noise in (("open", 1e-6), ("open", 1e-3), ("closed", 0.05), ("closed", 1.0), ("open", 1.0)):
        points, template, seen = runs(kind, 80, noise=noise)
        expect = one_by_one(measure, points, template, seen)
        np.testing.assert_allclose(measure.many(points, template, seen), expect, rtol=1e-10, atol=1e-14)

    if module is many_distances:  # Here lines have a reach in mm.
        far = Interface(10 * seen.points, seen.cells)
        np.testing.assert_allclose(measure.many(10 * points, template, far), 100 * expect, rtol=1e-10)

    motion = many_distances.motion

    def tenth(array):
        middle, moved = motion(array)
        return middle, 0.1 * moved

    monkeypatch.setattr(module, "motion", tenth)
    assert not np.allclose(measure.many(points, template, seen), expect, rtol=1e-6)
