"""Oracles: parallel lines and circles in closed form, intersections by shapely."""

import math

import numpy as np
import pytest
import shapely

from strandline.discrepancy import MeasurementLines, TrackedPoints
from strandline.errors import InvalidInput, InvalidInterface
from strandline.interface import Interface, PointErrors


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


def half_circle(nodes: int = 201) -> Interface:
    angle = np.linspace(0.0, np.pi, nodes)
    return Interface.polyline(np.stack([-np.cos(angle), np.sin(angle)], axis=1))


SPACING = float(half_circle().lengths[0])
ROUGH = PointErrors(0.5 * SPACING)


def directions_off(measure: MeasurementLines, observed: Interface) -> np.ndarray:
    """Return the angles, degrees, between lines and radii of the half circle, away from its ends."""
    lines = measure.place(observed)[5:-5]
    outward = lines[:, :2] / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    side = outward[:, 0] * lines[:, 3] - outward[:, 1] * lines[:, 2]
    return np.degrees(np.arcsin(np.clip(side, -1, 1)))


def test_a_piece_within_a_segment_has_its_direction():
    observed = wavy(66, 0.0, 1)
    np.testing.assert_allclose(
        MeasurementLines(smooth=1e-7).place(observed), MeasurementLines().place(observed), atol=1e-6
    )


def test_directions_of_longer_pieces_are_steady():
    noisy = ROUGH.draw(half_circle(), np.random.default_rng(1))
    assert directions_off(MeasurementLines(40), noisy).std() > 20
    assert directions_off(MeasurementLines(40, smooth=0.3), noisy).std() < 4
    assert abs(directions_off(MeasurementLines(40, smooth=0.3), half_circle())).max() < 0.1


def mean_square(measure: MeasurementLines) -> float:
    """Return d² of the true outline over n s², in the mean over noisy observations."""
    random, true = np.random.default_rng(2), half_circle()
    squares = [measure(true, ROUGH.draw(true, random)) for _ in range(30)]
    return float(np.mean(squares)) / (measure.terms(true) * ROUGH.sd**2)


def test_distances_along_steady_lines_have_the_noise_of_the_points():
    assert 0.4 < mean_square(MeasurementLines(20, smooth=0.4)) < 1.2
    assert mean_square(MeasurementLines(20)) > 1.5  # lines that turn with the noise


def test_the_ends_can_be_left_out():
    x = np.linspace(0.0, 2.0, 41)
    line = Interface.polyline(np.stack([x, 0 * x], axis=1))
    np.testing.assert_allclose(MeasurementLines(4, trim=0.1).place(line)[:, 0], [0.4, 0.8, 1.2, 1.6], atol=1e-12)
    np.testing.assert_allclose(MeasurementLines(4).place(line)[:, 0], [0.25, 0.75, 1.25, 1.75], atol=1e-12)
    closed = Interface.polyline(half_circle().points, closed=True)
    np.testing.assert_allclose(MeasurementLines(4, trim=0.1).place(closed), MeasurementLines(4).place(closed))
    for lines, trim in ((4, 0.5), (4, -0.1), (((0.0, 0.9, 0.0, 1.0),), 0.1)):
        with pytest.raises(InvalidInput, match="trim"):
            MeasurementLines(lines, trim=trim)


def test_steady_lines_have_a_noise_variance():
    seen = half_circle()
    smooth, correlated = PointErrors(0.15 * SPACING), PointErrors(0.3 * SPACING, 2 * SPACING)
    for lines in (MeasurementLines(10, smooth=0.2), MeasurementLines(((0.0, 0.9, 0.0, 1.0),))):
        assert lines.noise_variance(smooth, seen) == pytest.approx(2 / 3 * smooth.sd**2)
        expected = correlated.sd**2 * (2 + np.exp(-0.5)) / 3
        assert lines.noise_variance(correlated, seen) == pytest.approx(expected, rel=1e-3)
        assert lines.noise_variance(ROUGH, seen) is None
    assert MeasurementLines(10).noise_variance(correlated, seen) is None


def test_a_closed_outline_has_no_ends_to_leave_out():
    angle = np.linspace(0.0, 2 * np.pi, 400, endpoint=False)
    circle = Interface.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)
    errors = PointErrors(1e-3, 0.3)
    whole, trimmed = (MeasurementLines(20, smooth=0.1, trim=trim) for trim in (0.0, 0.25))
    np.testing.assert_array_equal(whole.place(circle), trimmed.place(circle))
    assert whole.noise_variance(errors, circle) == trimmed.noise_variance(errors, circle)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.2])
def test_the_scatter_is_that_of_the_segments(share):
    noisy = [PointErrors(share * SPACING).draw(half_circle(), np.random.default_rng(k)) for k in range(10)]
    found = np.mean([MeasurementLines().scatter(one) for one in noisy])
    assert found == pytest.approx(np.degrees(np.sqrt(2) * share), rel=0.15)
    smoothed = np.mean([MeasurementLines(smooth=5 * SPACING).scatter(one) for one in noisy])
    assert smoothed == pytest.approx(found / 5, rel=0.05)


def test_curves_and_corners_do_not_scatter():
    side = np.linspace(0.0, 1.0, 25, endpoint=False)
    corners = [(side, 0 * side), (1 + 0 * side, side), (1 - side, 1 + 0 * side), (0 * side, 1 - side)]
    square = Interface.polyline(np.concatenate([np.stack(one, axis=1) for one in corners]), closed=True)
    assert MeasurementLines().scatter(square) < 1e-6
    assert MeasurementLines().scatter(half_circle()) < 1e-6
    assert MeasurementLines(((0.0, 0.0, 0.0, 1.0),)).scatter(wavy(66, 0.0, 1)) == 0.0
    assert MeasurementLines().scatter(line((0, 0), (1, 0.5), (2, 0))) == 0.0


@pytest.mark.parametrize("smooth", [0.0, -1.0, math.inf, math.nan])
def test_invalid_smooth(smooth):
    with pytest.raises(InvalidInput, match="smooth"):
        MeasurementLines(smooth=smooth)


def test_given_lines_take_no_piece():
    with pytest.raises(InvalidInput, match="given lines"):
        MeasurementLines(((0.0, 0.0, 0.0, 1.0),), smooth=0.1)


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
