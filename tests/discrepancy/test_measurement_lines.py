"""Oracles: parallel lines and circles in closed form, intersections by shapely."""

import math

import numpy as np
import pytest
import shapely

from strandline.discrepancy import MeasurementLines, TrackedPoints
from strandline.errors import InvalidInput, InvalidInterface
from strandline.interface import Interface


def line(*points):
    return Interface.polyline(np.array(points, float))


def wavy(nodes: int, shift: float, seed: int) -> Interface:
    x = np.linspace(0.0, 2.0, nodes)
    wiggle = np.random.default_rng(seed).normal(0.0, 0.01, nodes)
    return Interface.polyline(np.stack([x, shift + 0.3 * np.sin(3 * x) + wiggle], axis=1))


def test_parallel_lines_give_n_times_the_gap_squared():
    observed, simulated = line((0, 0), (1, 0), (3, 0)), line((0, 0.1), (3, 0.1))
    assert MeasurementLines(7)(simulated, observed) == pytest.approx(7 * 0.1**2, rel=1e-13)


def test_default_lines_stand_at_midpoints_of_equal_shares_with_the_observed_normal():
    placed = MeasurementLines().place(line((0, 0), (1, 0), (1, 1)))
    along = (np.arange(10) + 0.5) / 10 * 2.0
    assert placed[:5] == pytest.approx(np.stack([along[:5], 0 * along[:5], np.zeros(5), np.ones(5)], axis=1))
    assert placed[5:] == pytest.approx(np.stack([np.ones(5), along[5:] - 1, -np.ones(5), np.zeros(5)], axis=1))


def test_placing_does_not_depend_on_the_nodes():
    coarse, fine = line((0, 0), (2, 0), (2, 1)), line((0, 0), (0.3, 0), (1.1, 0), (2, 0), (2, 0.77), (2, 1))
    measure = MeasurementLines(6)
    assert measure.place(coarse) == pytest.approx(measure.place(fine), abs=1e-14)


def test_concentric_circles_along_given_radii():
    angle = 2 * np.pi * np.arange(64) / 64
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inner, outer = Interface.polyline(ring, closed=True), Interface.polyline(1.2 * ring, closed=True)
    nodes = ring[[0, 8, 24, 40]]
    radii = MeasurementLines(np.hstack([nodes, 3 * nodes]))
    assert radii(outer, inner) == pytest.approx(4 * 0.2**2, rel=1e-12)
    assert radii.read(inner, outer).distances == pytest.approx([-0.2] * 4)


@pytest.mark.parametrize("seed", range(8))
def test_distances_against_shapely(seed):
    observed, simulated = wavy(66, 0.0, seed), wavy(51, 0.05, seed + 100)
    measure = MeasurementLines(10)
    curve = shapely.LineString(simulated.points)
    readings = measure.read(simulated, observed)
    for (x, y, dx, dy), found, missed in zip(measure.place(observed), readings.distances, readings.missed, strict=True):
        reach = measure.reach_on(observed)
        ray = shapely.LineString([(x - reach * dx, y - reach * dy), (x + reach * dx, y + reach * dy)])
        hits = [(p.x - x) * dx + (p.y - y) * dy for p in shapely.get_parts(ray.intersection(curve))]
        assert missed == (not hits)
        assert found == pytest.approx(min(hits, key=abs) if hits else reach, abs=1e-12)


def test_given_line_starts_from_the_observed_crossing_nearest_to_its_point():
    observed = line((0, 0), (2, 0), (2, 1), (0, 1))
    near_top = MeasurementLines(((1.0, 0.9, 0.0, -2.0),))
    assert near_top.place(observed)[0] == pytest.approx([1.0, 1.0, 0.0, -1.0])
    assert near_top.read(line((0, 0.8), (2, 0.8)), observed).distances == pytest.approx([0.2])


def test_of_several_crossings_the_nearest_counts():
    observed = line((0, 0), (1, 0))
    simulated = line((0, 0.2), (1, 0.2), (1, 0.05), (0, 0.05), (0, -0.1), (1, -0.1))
    assert MeasurementLines(1).read(simulated, observed).distances == pytest.approx([0.05])


def test_miss_counts_the_reach():
    observed, short = line((0, 0), (1, 0)), line((0, 0.01), (0.5, 0.01))
    readings = MeasurementLines(4).read(short, observed)
    assert readings.missed.tolist() == [False, False, True, True]
    assert MeasurementLines(4)(short, observed) == pytest.approx(2 * 0.01**2 + 2 * 0.25**2)
    assert MeasurementLines(4, reach=0.1)(short, observed) == pytest.approx(2 * 0.01**2 + 2 * 0.1**2)


def test_continuous_where_a_crossing_moves_out_of_reach():
    observed, measure = line((0, 0), (1, 0)), MeasurementLines(5, reach=0.1)
    inside, outside = (measure(line((0, h), (1, h)), observed) for h in (0.1 - 1e-9, 0.1 + 1e-9))
    assert outside == pytest.approx(inside, rel=1e-7)


def test_crossing_at_a_node_is_found():
    observed, simulated = line((0, 0), (1, 0)), line((0, 0.3), (0.5, 0.1), (1, 0.3))
    assert MeasurementLines(1).read(simulated, observed).distances == pytest.approx([0.1])


@pytest.mark.parametrize(("low", "high", "expected"), [(0.05, 0.2, 0.05), (-0.2, -0.1, -0.1), (-0.1, 0.2, 0.0)])
def test_segment_that_lies_in_the_line(low, high, expected):
    observed, simulated = line((0, 0), (1, 0)), line((0.5, low), (0.5, high))
    assert MeasurementLines(1).read(simulated, observed).distances == pytest.approx([expected])


def test_distance_to_itself_is_zero():
    observed = wavy(66, 0.0, 3)
    assert MeasurementLines()(observed, observed) < 1e-28


def test_line_that_misses_the_observation_is_refused():
    with pytest.raises(InvalidInput, match="line 1 misses the observed"):
        MeasurementLines(((0.5, 0.0, 0.0, 1.0), (5.0, 0.0, 0.0, 1.0)))(line((0, 0), (1, 0)), line((0, 0), (1, 0)))


@pytest.mark.parametrize(
    "lines",
    [0, -3, (), ((0.0, 0.0, 0.0, 0.0),), ((0.0, 0.0, 1.0),), ((0.0, math.nan, 1.0, 0.0),)],
)
def test_invalid_lines(lines):
    with pytest.raises(InvalidInput, match="measurement lines"):
        MeasurementLines(lines)


@pytest.mark.parametrize("reach", [0.0, -1.0, math.inf, math.nan])
def test_invalid_reach(reach):
    with pytest.raises(InvalidInput, match="reach"):
        MeasurementLines(reach=reach)


def test_terms_and_unit():
    observed = line((0, 0), (1, 0))
    assert MeasurementLines().terms(observed) == 10
    assert MeasurementLines(((0, 0, 0, 1), (1, 0, 0, 1))).terms(observed) == 2
    assert MeasurementLines().unit == TrackedPoints().unit == "mm²"


def test_tracked_points_is_the_sum_of_squared_displacements():
    observed, simulated = wavy(20, 0.0, 1), wavy(20, 0.1, 2)
    exact = sum(math.dist(p, q) ** 2 for p, q in zip(simulated.points, observed.points, strict=True))
    assert TrackedPoints()(simulated, observed) == pytest.approx(exact, rel=1e-13)
    assert TrackedPoints().terms(observed) == 40


def test_tracked_points_refuses_other_nodes():
    with pytest.raises(InvalidInterface, match="correspond"):
        TrackedPoints()(wavy(20, 0.0, 1), wavy(21, 0.0, 1))
