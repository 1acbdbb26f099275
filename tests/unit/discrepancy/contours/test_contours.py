"""Errors of points from repeated contours and from the roughness of single ones; bugs that must show."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
from tests.unit.discrepancy.curves import graph, line, ring
from tests.unit.discrepancy.surfaces import sheet

from strandline.discrepancy import Repeats, errors_from_repeats, errors_from_roughness
from strandline.discrepancy import contours as module
from strandline.discrepancy.contours import _removed, restored, smoothed, smoothing_weights
from strandline.foundations import InvalidInput, InvalidInterface
from strandline.interface import Interface, PointErrors

LAGS = np.arange(60)
LOCAL = PointErrors(0.0015, 0.01)
GLOBAL = PointErrors(0.0015, 0.01, shift=0.03, rotation=2.0, scale=0.005, offset=0.004)


@lru_cache
def ellipse(number: int = 600) -> Interface:
    """Return a closed outline of equal segments, 2.6 mm long."""
    return ring(4000, 0.5, flat=0.6).resampled(number)


@lru_cache
def hill(number: int = 450) -> Interface:
    """Return an open outline of equal segments, 1.5 mm long."""
    x = np.linspace(0.0, 1.2, 3000)
    return graph(x, 0.4 * np.sin(np.pi * x / 1.2) ** 2).resampled(number)


def drawn(errors: PointErrors, number: int, *, seed: int = 1, outline=ellipse) -> Repeats:
    truth, random = outline(), np.random.default_rng(seed)
    return errors_from_repeats([errors.draw(truth, random) for _ in range(number)])


def test_lengths_in_closed_form():
    """Of exponentials and of independent values; what follows the first zero does not count."""
    for length in (2.0, 5.0):
        found = restored(4.0 * np.exp(-LAGS / length), np.zeros(60))
        assert found.variance == pytest.approx(4.0)
        assert found.length(1.0) == pytest.approx(0.5 / np.tanh(0.5 / length), rel=1e-4)
        assert found.length(0.1) == pytest.approx(0.1 * found.length(1.0))
    white = restored(np.where(LAGS == 0, 2.0, 0.0), np.zeros(60))
    assert (white.length(3.0), white.cut) == (pytest.approx(1.5), False)
    assert restored(np.ones(60), np.zeros(60)).cut
    covariance = np.where(LAGS < 4, 1.0, np.where(LAGS < 10, -0.2, 0.5))
    assert restored(covariance, np.zeros(60)).level == pytest.approx(7.0)


def test_what_was_removed_comes_back():
    """c(k) - S q(k) with a slow q: variance and level are those of c. Planted: nothing put back."""
    c, q = np.exp(-LAGS / 4.0), 0.02 * np.cos(LAGS / 60)
    level = 1 + 2 * c[1:].sum()
    found = restored(c - level * q, q)
    assert found.variance == pytest.approx(1.0, rel=0.03)
    assert found.level == pytest.approx(level, rel=0.15)
    assert restored(c - level * q, np.zeros(60)).level < 0.8 * level


def test_smoothing_keeps_straight_lines_to_their_ends_parabolas_inside_and_circles():
    for half in (2, 7):
        k = np.arange(-half, half + 1)
        design = np.stack([k**0, k, k**2], axis=1)
        np.testing.assert_allclose(smoothing_weights(half), np.linalg.pinv(design)[0], atol=1e-12)
    t = np.linspace(0.0, 1.0, 40)
    straight, parabola = graph(t, 2 * t).points, graph(t, t**2).points
    np.testing.assert_allclose(smoothed(straight, 5, closed=False), straight, atol=1e-12)
    np.testing.assert_allclose(smoothed(parabola, 5, closed=False)[5:-5], parabola[5:-5], atol=1e-12)
    radii = np.linalg.norm(smoothed(ring(90).points, 6, closed=True), axis=1)
    np.testing.assert_allclose(radii, radii[0], rtol=1e-12)
    assert radii[0] == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize(("errors", "outline"), [(LOCAL, ellipse), (GLOBAL, hill), (GLOBAL, ellipse)])
def test_the_errors_are_those_drawn(errors, outline):
    """What independent contours differ by is far from a shift of their sd; independent points have half the spacing."""
    found = drawn(errors, 16, outline=outline).errors
    assert found.sd == pytest.approx(errors.sd, rel=0.1)
    assert found.length == pytest.approx(errors.length, rel=0.3)
    if errors is LOCAL:
        assert found.shift < 0.25 * LOCAL.sd
        assert found.offset < 0.5 * LOCAL.sd
        white = drawn(PointErrors(0.001), 10)
        assert white.errors.sd == pytest.approx(0.001, rel=0.05)
        assert 0.5 * white.spacing <= white.errors.length < 0.9 * white.spacing
    else:
        assert found.shift == pytest.approx(errors.shift, rel=0.4)
        assert found.rotation == pytest.approx(errors.rotation, rel=0.5)


def test_few_contours_do_not_lower_the_sd():
    """Without n/(n-1) it would be 18 % lower."""
    found = [drawn(LOCAL, 3, seed=seed).errors.sd for seed in range(4)]
    assert np.mean(found) == pytest.approx(LOCAL.sd, rel=0.1)


def test_the_motion_of_each_contour_is_found():
    truth = ellipse()
    for reach, angle in ((0.03, 0.0), (0.0, 3.0)):
        random, contours = np.random.default_rng(3), []
        angles, shifts = angle * np.array([-1.0, 0.0, 0.4, 1.2]), reach * random.standard_normal((4, 2))
        for turned, shift in zip(np.radians(angles), shifts, strict=True):
            turn = np.array([[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]])
            contours.append(Interface(LOCAL.draw(truth, random).points @ turn + shift, truth.cells))
        found = errors_from_repeats(contours)
        np.testing.assert_allclose(found.parts[:, :2], shifts - shifts.mean(axis=0), atol=0.0015)
        np.testing.assert_allclose(found.parts[:, 2], angles - angles.mean(), atol=0.3)
        assert found.errors.sd == pytest.approx(LOCAL.sd, rel=0.12)


def test_what_moved_a_contour_is_taken_back():
    outline, middle, part = ellipse(60), np.array([0.2, -0.1]), np.array([0.03, 0.05, 20.0, 0.1, 0.0])
    c, s = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
    arms = (outline.points - middle) @ np.array([[c, -s], [s, c]]).T
    back = module._moved_back(Interface(middle + part[:2] + 1.1 * arms, outline.cells), part, middle)
    np.testing.assert_allclose(back.points, outline.points, atol=1e-12)


def test_the_point_next_to_each_place_is_the_nearest_one():
    for outline in (ellipse(300), hill(300)):
        whole, random = outline.lengths.sum(), np.random.default_rng(4)
        feet, places = whole * random.random(40), whole * random.random(25)
        apart = np.abs(feet - places[:, None])
        if outline.closed:
            apart = np.minimum(apart, whole - apart)
        np.testing.assert_array_equal(module._nearest(feet, places, outline, np.inf), apart.argmin(axis=1))
    found = module._nearest(np.array([0.9, 0.1, 0.5]), np.array([0.0, 0.2, 0.69, 0.8, 1.0]), line((0, 0), (1, 0)), 0.3)
    np.testing.assert_array_equal(found, [1, 1, 2, 0, 0])


def test_neither_points_nor_directions_nor_ends_need_to_correspond():
    """Closed contours that begin anywhere; open ones are compared where all have points."""
    (one, other), closed, opened = map(np.random.default_rng, (5, 6)), [], []
    for k in range(8):
        points = LOCAL.draw(ellipse(390 + 10 * k), one).points
        closed.append(Interface.polyline(np.roll(points[:: -1 if k % 2 else 1], 40 * k, axis=0), closed=True))
        opened.append(Interface.polyline(LOCAL.draw(hill(), other).points[3 * k : 450 - 4 * k]))
    found, cut = errors_from_repeats(closed).errors, errors_from_repeats(opened)
    assert (found.sd, cut.errors.sd) == pytest.approx((LOCAL.sd, LOCAL.sd), rel=0.12)
    assert found.length == pytest.approx(LOCAL.length, rel=0.35)
    assert 370 < cut.places < 415


def half_ellipse() -> Interface:
    angle = np.linspace(0.0, np.pi, 4000)
    return graph(-0.5 * np.cos(angle), 0.4 * np.sin(angle)).resampled(400)


ROUND, OPEN = ring(4000, 0.5, flat=0.8).resampled(400), half_ellipse()


def rough(errors: PointErrors, outline: Interface = ROUND, *, seed: int = 4, window: float | None = None):
    return errors_from_roughness(errors.draw(outline, np.random.default_rng(seed)), window=window)


def test_independent_points_have_the_sd_drawn_and_half_the_spacing_in_one_contour():
    for outline, sd in ((ROUND, 2e-4), (OPEN, 0.001)):
        found = [rough(PointErrors(sd), outline, seed=seed) for seed in range(8)]
        assert np.mean([one.errors.sd for one in found]) == pytest.approx(sd, rel=0.08)
        assert np.mean([one.errors.length / one.spacing for one in found]) < 0.8
    assert rough(PointErrors(1e-5), OPEN).errors.sd < 1e-4  # the outline itself is not taken for roughness


def correlated(outline: Interface, length: float) -> tuple[float, float]:
    """Return sd and sd² × length, each relative to the true one, in the mean over contours."""
    errors, random = PointErrors(0.001, length), np.random.default_rng(1)
    found = [errors_from_roughness(errors.draw(outline, random)).errors for _ in range(12)]
    sds, lengths = np.array([(one.sd, one.length) for one in found]).T
    return sds.mean() / errors.sd, (sds**2 * lengths).mean() / (errors.sd**2 * length)


def test_the_level_of_correlated_points_reads_low_by_less_than_it_is_said(monkeypatch):
    """Planted: residuals of the smoothed contour taken as the errors."""
    found = [correlated(*one) for one in ((ROUND, 0.02), (OPEN, 0.01))]
    for sd, level in found:
        assert 0.8 < sd < 1.25
        assert 1 / 3 < level < 1.2
    monkeypatch.setattr("strandline.discrepancy.contours._removed", lambda half, number: np.zeros(number))
    sd, level = correlated(ROUND, 0.02)
    assert sd < 0.97 * found[0][0]
    assert level < 0.8 * found[0][1]


def test_what_smoothing_takes_from_white_noise_is_one_weight_of_it_up_to_twice_its_half_width():
    for half in (2, 4, 9):
        removed = _removed(half, 40)
        assert removed[0] == pytest.approx(smoothing_weights(half)[half])
        assert removed[0] + 2 * removed[1:].sum() == pytest.approx(1.0)
        assert (len(removed), len(_removed(half, 5))) == (40, 5)
        np.testing.assert_array_equal(removed[2 * half + 1 :], 0.0)


def test_a_window_is_used_as_given_and_notes_say_where_the_length_cannot_be_trusted():
    found = rough(PointErrors(0.001), window=0.2)
    assert found.window == pytest.approx(0.2, rel=0.1)
    assert found.errors.sd == pytest.approx(0.001, rel=0.15)
    assert "do not trust the length" in rough(PointErrors(0.001, 0.03), window=0.06).notes[-1]
    notes = " ".join(rough(PointErrors(0.001), window=0.3).notes)
    assert "do not trust" not in notes
    assert "is underestimated" in notes


def test_what_cannot_be_compared_or_shows_no_errors_is_refused():
    round_one, apart = ellipse(100), Interface.polyline(hill(100).points + np.array([5.0, 0.0]))
    for contours, said in (
        ([round_one, ellipse(29)], "points of contour 2: got 29"),
        ([round_one, Interface.polyline(round_one.points)], "contour 1 is closed, contour 2 open"),
        ([round_one, Interface.polyline(1000 * round_one.points, closed=True)], "in the same unit"),
        ([round_one, round_one], "identical contours; expected one contour per picture"),
        ([hill(100), apart], "that all contours show: got 0 mm, with 0 points of the coarsest"),
        ([round_one, Interface.polyline(round_one.points[:60], closed=True)], "gap"),
        ([sheet(2)] * 2, "plane"),
    ):
        with pytest.raises((InvalidInput, InvalidInterface), match=said):
            errors_from_repeats(contours)
    for contour, window, said in (
        (ROUND, 2.0, "half the contour"),
        (ROUND, 0.035, "got 0.035 mm; expected a length from 0.042"),  # six times 2.84 mm / 400
        (line((0, 0), (1, 0)).resampled(50), None, "roughness"),
    ):
        with pytest.raises(InvalidInput, match=said):
            errors_from_roughness(contour, window=window)


@pytest.mark.stand_in
def test_errors_of_the_whole_contour_are_those_that_local_ones_do_not_explain():
    """Two coordinates of the shift share one spread."""
    parts = np.zeros((5, 5))
    parts[:, :2] = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])[:, None]  # variance 2.5
    local = SimpleNamespace(level=0.25, variance=1.0, cut=False, length=lambda step: 0.1)
    frame = SimpleNamespace(estimate=np.ones((5, 1)), step=0.1)
    assert module._errors(local, parts, frame).shift == pytest.approx(1.5)
