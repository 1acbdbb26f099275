"""Errors of points from repeated contours: those that the contours were drawn with, and bugs that must show."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from strandline.discrepancy import Repeats, errors_from_repeats
from strandline.discrepancy.contours import repeats as module
from strandline.discrepancy.contours.correlation import Correlated
from strandline.errors import InvalidInput, InvalidInterface
from strandline.interface import Interface, PointErrors

LOCAL = PointErrors(0.0015, 0.01)
GLOBAL = PointErrors(0.0015, 0.01, shift=0.03, rotation=2.0, scale=0.005, offset=0.004)


@lru_cache
def ellipse(number: int = 600) -> Interface:
    """Return a closed outline of equal segments, 2.6 mm long."""
    angle = np.linspace(0.0, 2 * np.pi, 4000, endpoint=False)
    fine = np.stack([0.5 * np.cos(angle), 0.3 * np.sin(angle)], axis=1)
    return Interface.polyline(fine, closed=True).resampled(number)


@lru_cache
def hill(number: int = 450) -> Interface:
    """Return an open outline of equal segments, 1.5 mm long."""
    x = np.linspace(0.0, 1.2, 3000)
    return Interface.polyline(np.stack([x, 0.4 * np.sin(np.pi * x / 1.2) ** 2], axis=1)).resampled(number)


def drawn(errors: PointErrors, number: int, *, seed: int = 1, outline: Callable[[], Interface] = ellipse) -> Repeats:
    truth, random = outline(), np.random.default_rng(seed)
    return errors_from_repeats([errors.draw(truth, random) for _ in range(number)])


@pytest.mark.parametrize(("errors", "outline"), [(LOCAL, ellipse), (GLOBAL, hill), (GLOBAL, ellipse)])
def test_the_errors_are_those_drawn(errors: PointErrors, outline: Callable[[], Interface]) -> None:
    """What independent contours differ by is far from a shift of their sd."""
    found = drawn(errors, 16, outline=outline).errors
    assert found.sd == pytest.approx(errors.sd, rel=0.1)
    assert found.length == pytest.approx(errors.length, rel=0.3)
    if errors is LOCAL:
        assert found.shift < 0.25 * LOCAL.sd
        assert found.offset < 0.5 * LOCAL.sd
    else:
        assert found.shift == pytest.approx(errors.shift, rel=0.4)
        assert found.rotation == pytest.approx(errors.rotation, rel=0.5)


def test_independent_points_have_half_the_spacing() -> None:
    found = drawn(PointErrors(0.001), 10)
    assert found.errors.sd == pytest.approx(0.001, rel=0.05)
    assert 0.5 * found.spacing <= found.errors.length < 0.9 * found.spacing


def of_three() -> float:
    """Return the mean sd from three contours each, relative to the true one."""
    return float(np.mean([drawn(LOCAL, 3, seed=seed).errors.sd for seed in range(4)])) / LOCAL.sd


def test_few_contours_do_not_lower_the_sd(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: n/(n-1) forgotten."""
    assert of_three() == pytest.approx(1.0, abs=0.1)
    monkeypatch.setattr(module, "_of_one", lambda contours: 1.0)
    assert of_three() < 0.9


def summed(covariance: np.ndarray, removed: np.ndarray) -> Correlated:
    """Add up all lags, beyond the first zero of the autocovariance."""
    return Correlated(float(covariance[0]), float(covariance[0] + 2 * covariance[1:].sum()), False)


def length_or_none(seed: int) -> float:
    """Return the correlation length found; 0 if it is refused, being below 0."""
    try:
        return drawn(LOCAL, 10, seed=seed).errors.length
    except InvalidInput:
        return 0.0


def test_an_integral_beyond_the_first_zero_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: what follows the first zero is noise, and what was removed with the common errors."""
    monkeypatch.setattr(module, "restored", summed)
    found = np.array([length_or_none(seed) for seed in range(4)])
    assert np.max(np.abs(found / LOCAL.length - 1)) > 0.3


def test_the_motion_of_each_contour_is_found() -> None:
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


def test_what_moved_a_contour_is_taken_back() -> None:
    outline, middle, shift, turned, size = ellipse(60), np.array([0.2, -0.1]), np.array([0.03, 0.05]), 20.0, 0.1
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    arms = (outline.points - middle) @ np.array([[c, -s], [s, c]]).T
    moved = Interface(middle + shift + (1 + size) * arms, outline.cells)
    back = module._moved_back(moved, np.array([*shift, turned, size, 0.0]), middle)
    np.testing.assert_allclose(back.points, outline.points, atol=1e-12)


def test_the_point_next_to_each_place_is_the_nearest_one() -> None:
    for outline in (ellipse(300), hill(300)):
        whole, random = outline.lengths.sum(), np.random.default_rng(4)
        feet, places = whole * random.random(40), whole * random.random(25)
        apart = np.abs(feet - places[:, None])
        if outline.closed:
            apart = np.minimum(apart, whole - apart)
        np.testing.assert_array_equal(module._nearest(feet, places, outline, np.inf), apart.argmin(axis=1))


def test_neither_points_nor_directions_need_to_correspond() -> None:
    random = np.random.default_rng(5)
    contours = [LOCAL.draw(ellipse(number), random) for number in (390, 400, 410, 420, 430, 440, 450, 460)]
    turned = [one.reversed() if k % 2 else one for k, one in enumerate(contours)]
    rolled = [Interface.polyline(np.roll(one.points, 40 * k, axis=0), closed=True) for k, one in enumerate(turned)]
    found = errors_from_repeats(rolled).errors
    assert found.sd == pytest.approx(LOCAL.sd, rel=0.12)
    assert found.length == pytest.approx(LOCAL.length, rel=0.35)


def test_contours_of_different_ends_are_compared_where_all_have_points() -> None:
    random = np.random.default_rng(6)
    whole = [LOCAL.draw(hill(), random) for _ in range(8)]
    cut = [Interface.polyline(one.points[3 * k : len(one.points) - 4 * k]) for k, one in enumerate(whole)]
    found = errors_from_repeats(cut)
    assert 370 < found.places < 415
    assert found.errors.sd == pytest.approx(LOCAL.sd, rel=0.12)


def test_notes_say_what_repeats_never_show() -> None:
    many, few = drawn(LOCAL, 6), drawn(LOCAL, 2)
    assert "never show" in many.notes[0]
    assert len(many.notes) == 1
    assert "2 contours only" in few.notes[1]


def test_what_cannot_be_compared_is_refused() -> None:
    round_one, apart = ellipse(100), Interface.polyline(hill(100).points + np.array([5.0, 0.0]))
    for contours, said in (
        ([], "number of contours"),
        ([round_one], "number of contours"),
        ([round_one, ellipse(29)], "points of contour 2: got 29"),
        ([round_one, Interface.polyline(round_one.points)], "contour 1 is closed, contour 2 open"),
        ([round_one, Interface.polyline(1000 * round_one.points, closed=True)], "in the same unit"),
        ([round_one, round_one], "identical contours; expected one contour per picture"),
        ([hill(100), apart], "that all contours show: got 0 mm, with 0 points of the coarsest"),
        ([round_one, Interface.polyline(round_one.points[:60], closed=True)], "gap"),
    ):
        with pytest.raises(InvalidInput, match=said):
            errors_from_repeats(contours)
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    with pytest.raises(InvalidInterface, match="plane"):
        errors_from_repeats([Interface(corners, np.array([[0, 1, 2]]))] * 2)
