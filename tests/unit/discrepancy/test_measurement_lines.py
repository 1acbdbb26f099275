"""Oracles: parallel lines and circles in closed form, intersections by shapely."""

import numpy as np
import pytest
import shapely
from tests.unit.discrepancy.curves import graph, line, ring

from strandline.discrepancy import MeasurementLines
from strandline.foundations import InvalidInput
from strandline.interface import Interface, PointErrors

STRAIGHT = line((0, 0), (1, 0))


def wavy(nodes: int, shift: float, seed: int) -> Interface:
    x = np.linspace(0.0, 2.0, nodes)
    return graph(x, shift + 0.3 * np.sin(3 * x) + np.random.default_rng(seed).normal(0.0, 0.01, nodes))


def test_lines_stand_at_midpoints_of_equal_shares_with_the_observed_normal_whatever_the_nodes():
    placed = MeasurementLines().place(line((0, 0), (1, 0), (1, 1)))
    along = (np.arange(10) + 0.5) / 10 * 2.0
    assert placed[:5] == pytest.approx(np.stack([along[:5], 0 * along[:5], np.zeros(5), np.ones(5)], axis=1))
    assert placed[5:] == pytest.approx(np.stack([np.ones(5), along[5:] - 1, -np.ones(5), np.zeros(5)], axis=1))
    coarse, fine = line((0, 0), (2, 0), (2, 1)), line((0, 0), (0.3, 0), (1.1, 0), (2, 0), (2, 0.77), (2, 1))
    assert MeasurementLines(6).place(coarse) == pytest.approx(MeasurementLines(6).place(fine), abs=1e-14)


def test_the_ends_of_an_open_outline_can_be_left_out():
    trimmed, circle = MeasurementLines(4, trim=0.1), ring(40)
    np.testing.assert_allclose(trimmed.place(line((0, 0), (2, 0)))[:, 0], [0.4, 0.8, 1.2, 1.6], atol=1e-12)
    np.testing.assert_array_equal(trimmed.place(circle), MeasurementLines(4).place(circle))


def test_parallel_lines_and_circles_along_given_radii_have_n_times_the_gap_squared():
    observed, simulated = line((0, 0), (1, 0), (3, 0)), line((0, 0.1), (3, 0.1))
    assert MeasurementLines(7)(simulated, observed) == pytest.approx(7 * 0.1**2, rel=1e-13)
    inner, outer = ring(64), ring(64, 1.2)
    nodes = inner.points[[0, 8, 24, 40]]
    radii = MeasurementLines(np.hstack([nodes, 3 * nodes]))
    assert radii(outer, inner) == pytest.approx(4 * 0.2**2, rel=1e-12)
    assert radii.read(inner, outer).distances == pytest.approx([-0.2] * 4)
    assert (MeasurementLines().terms(STRAIGHT), radii.terms(inner)) == (10, 4)


def test_distances_against_shapely():
    measure = MeasurementLines(10)
    for seed in range(5):
        observed, simulated = wavy(66, 0.0, seed), wavy(51, 0.05, seed + 100)
        curve, reach = shapely.LineString(simulated.points), measure.reach_on(observed)
        readings = measure.read(simulated, observed)
        rows = zip(measure.place(observed), readings.distances, readings.missed, strict=True)
        for (x, y, dx, dy), found, missed in rows:
            ray = shapely.LineString([(x - reach * dx, y - reach * dy), (x + reach * dx, y + reach * dy)])
            hits = [(p.x - x) * dx + (p.y - y) * dy for p in shapely.get_parts(ray.intersection(curve))]
            assert missed == (not hits)
            assert found == pytest.approx(min(hits, key=abs) if hits else reach, abs=1e-12)


def test_given_line_starts_from_the_observed_crossing_nearest_to_its_point():
    observed = line((0, 0), (2, 0), (2, 1), (0, 1))
    near_top = MeasurementLines(((1.0, 0.9, 0.0, -2.0),))
    assert near_top.place(observed)[0] == pytest.approx([1.0, 1.0, 0.0, -1.0])
    assert near_top.read(line((0, 0.8), (2, 0.8)), observed).distances == pytest.approx([0.2])
    with pytest.raises(InvalidInput, match="line 1 misses the observed"):
        MeasurementLines(((0.5, 0.0, 0.0, 1.0), (5.0, 0.0, 0.0, 1.0)))(STRAIGHT, STRAIGHT)


def test_of_several_crossings_the_nearest_counts_also_at_a_node_and_along_a_segment():
    several = line((0, 0.2), (1, 0.2), (1, 0.05), (0, 0.05), (0, -0.1), (1, -0.1))
    for simulated, expected in (
        (several, 0.05),
        (line((0, 0.3), (0.5, 0.1), (1, 0.3)), 0.1),
        (line((0.5, 0.05), (0.5, 0.2)), 0.05),
        (line((0.5, -0.2), (0.5, -0.1)), -0.1),
        (line((0.5, -0.1), (0.5, 0.2)), 0.0),
    ):
        assert MeasurementLines(1).read(simulated, STRAIGHT).distances == pytest.approx([expected])
    observed = wavy(66, 0.0, 3)
    assert MeasurementLines()(observed, observed) < 1e-28


def test_a_miss_counts_the_reach_without_a_jump():
    short = line((0, 0.01), (0.5, 0.01))
    assert MeasurementLines(4).read(short, STRAIGHT).missed.tolist() == [False, False, True, True]
    assert MeasurementLines(4)(short, STRAIGHT) == pytest.approx(2 * 0.01**2 + 2 * 0.25**2)
    measure = MeasurementLines(4, reach=0.1)
    assert measure(short, STRAIGHT) == pytest.approx(2 * 0.01**2 + 2 * 0.1**2)
    inside, outside = (measure(line((0, h), (1, h)), STRAIGHT) for h in (0.1 - 1e-9, 0.1 + 1e-9))
    assert outside == pytest.approx(inside, rel=1e-7)


def half_circle() -> Interface:
    angle = np.linspace(0.0, np.pi, 201)
    return graph(-np.cos(angle), np.sin(angle))


SPACING = float(half_circle().lengths[0])
ROUGH = PointErrors(0.5 * SPACING)


def test_directions_of_longer_pieces_are_steady_and_distances_along_them_have_the_noise_of_the_points():
    """In the mean over noisy observations; planted: lines that turn with the noise."""
    true, random = half_circle(), np.random.default_rng(2)
    noisy = [ROUGH.draw(true, random) for _ in range(30)]
    place, direction = np.split(MeasurementLines(40, smooth=0.3).place(true)[5:-5], 2, axis=1)
    np.testing.assert_allclose(direction, place / np.linalg.norm(place, axis=1, keepdims=True), atol=2e-3)
    for measure, low, high in ((MeasurementLines(20, smooth=0.4), 0.4, 1.2), (MeasurementLines(20), 1.5, np.inf)):
        assert low < np.mean([measure(true, one) for one in noisy]) / (measure.terms(true) * ROUGH.sd**2) < high


def test_steady_lines_have_a_noise_variance():
    seen = half_circle()
    smooth, correlated = PointErrors(0.15 * SPACING), PointErrors(0.3 * SPACING, 2 * SPACING)
    for lines in (MeasurementLines(10, smooth=0.2), MeasurementLines(((0.0, 0.9, 0.0, 1.0),))):
        assert lines.noise_variance(smooth, seen) == pytest.approx(2 / 3 * smooth.sd**2)
        expected = correlated.sd**2 * (2 + np.exp(-0.5)) / 3
        assert lines.noise_variance(correlated, seen) == pytest.approx(expected, rel=1e-3)
        assert lines.noise_variance(ROUGH, seen) is None
    assert MeasurementLines(10).noise_variance(correlated, seen) is None


def test_the_scatter_is_that_of_the_segments_and_curves_and_corners_have_none():
    for share in (0.02, 0.2):
        noisy = [PointErrors(share * SPACING).draw(half_circle(), np.random.default_rng(k)) for k in range(10)]
        each = [[MeasurementLines(smooth=size).scatter(one) for one in noisy] for size in (None, 5 * SPACING)]
        found, smoothed = np.mean(each, axis=1)
        assert found == pytest.approx(np.degrees(np.sqrt(2) * share), rel=0.15)
        assert smoothed == pytest.approx(found / 5, rel=0.05)
    for outline in (line((0, 0), (1, 0), (1, 1), (0, 1), closed=True).resampled(100), half_circle()):
        assert MeasurementLines().scatter(outline) < 1e-6
