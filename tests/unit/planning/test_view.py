"""Parts, points and errors of a view, and what they tell, against sums by hand."""

from dataclasses import replace

import numpy as np
import pytest

from strandline.calibration.experiment import CoordinateErrors
from strandline.calibration.footprint import footprint
from strandline.errors import InvalidInput
from strandline.interface import Interface, PointErrors
from strandline.planning.observing import Observing
from strandline.planning.view import View, focused

X = np.linspace(0.0, 2.0, 41)
LINE = Interface.polyline(np.column_stack([X, np.zeros(41)]))
SLOPES = {"": np.stack([np.column_stack([0 * X, X]), np.column_stack([0 * X, X**2])], axis=2)}
"""The line rises by x and by x² per unit of two inputs."""


def view(errors: PointErrors | CoordinateErrors) -> View:
    return View(footprint(LINE, LINE), errors)


def fisher(one: View) -> np.ndarray:
    return Observing({"": one}, {"": LINE.points}).fisher(SLOPES)


def by_hand(x: np.ndarray, sd: float) -> np.ndarray:
    rows = np.column_stack([x, x**2]) / sd
    return np.asarray(rows.T @ rows)


def test_the_whole_line_a_part_and_other_points() -> None:
    whole = view(PointErrors(0.01))
    half = focused(whole, LINE.points, part=(0.5, 1.0))
    few = focused(whole, LINE.points, part=(0.25, 0.75), points=5)
    places = np.linspace(0.5, 1.5, 5)
    assert len(half.seen(LINE.points).points) == 21
    np.testing.assert_allclose(few.seen(LINE.points).points[:, 0], places)
    np.testing.assert_allclose(fisher(half), by_hand(X[20:], 0.01))
    np.testing.assert_allclose(fisher(few), by_hand(places, 0.01), rtol=2e-3)
    for errors in (PointErrors(0.01), CoordinateErrors(0.01)):
        np.testing.assert_allclose(fisher(view(errors)), by_hand(X, 0.01))
        np.testing.assert_allclose(fisher(focused(view(errors), LINE.points, sd=0.005)), by_hand(X, 0.005))


def test_views_of_two_models_have_the_same_points_if_one_arc_length_counts() -> None:
    """Where one model stretches the line's first half, fewer of its points lie in it."""
    stretched = Interface.polyline(np.column_stack([np.where(X < 1, 3 * X, X + 2), np.zeros(41)]))
    one, other = (focused(view(PointErrors(0.01)), at.points, part=(0.0, 0.4)) for at in (LINE, stretched))
    assert len(one.footprint.corners) != len(other.footprint.corners)
    for options in ({}, {"points": 7}):
        one = focused(view(PointErrors(0.01)), LINE.points, part=(0.0, 0.4), **options)
        other = focused(view(PointErrors(0.01)), stretched.points, part=(0.0, 0.4), along=LINE, **options)
        np.testing.assert_allclose(other.seen(LINE.points).points, one.seen(LINE.points).points)


def test_errors_of_each_point_go_with_their_points() -> None:
    shares = tuple(np.linspace(1.0, 2.0, 41))
    half = focused(view(PointErrors(0.01, shares=shares)), LINE.points, part=(0.5, 1.0))
    assert half.errors == PointErrors(0.01, shares=shares[20:])
    rows = np.column_stack([X, X**2])[20:] / (0.01 * np.array(shares[20:]))[:, None]
    np.testing.assert_allclose(fisher(half), rows.T @ rows)
    few = focused(view(PointErrors(0.01, shares=shares)), LINE.points, points=5)
    assert few.errors == PointErrors(0.01)


def test_a_closed_outline_keeps_its_closure_only_as_a_whole() -> None:
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = Interface.polyline(np.column_stack([np.cos(angles), np.sin(angles)]), closed=True)
    whole = View(footprint(ring, ring), PointErrors(0.01))
    assert focused(whole, ring.points, points=20).seen(ring.points).closed
    part = focused(whole, ring.points, part=(0.0, 0.5)).seen(ring.points)
    assert not part.closed
    assert len(part.points) == 21


def test_shared_errors_of_two_conditions_count_once() -> None:
    """A common shift of unknown size hides what both lines do together; what differs between them stays."""
    together = {"": SLOPES[""], "b": SLOPES[""]}
    opposite = {"": SLOPES[""], "b": -SLOPES[""]}
    own = PointErrors(0.01, shift=0.5)
    for errors, factor in ((replace(own, shared=True), 50.0), (own, 1.0)):
        both = Observing({"": view(errors), "b": view(errors)}, {"": LINE.points, "b": LINE.points})
        ratio = both.fisher(opposite)[0, 0] / both.fisher(together)[0, 0]
        assert ratio == pytest.approx(1.0, rel=1e-6) if factor == 1.0 else ratio > 2.0


def test_signals_differ_by_what_the_errors_hide() -> None:
    draws = np.random.default_rng(0).standard_normal((50, 2)) * 0.01
    nodes = LINE.points + np.einsum("nad,kd->kna", SLOPES[""], draws)
    observing = Observing({"": view(PointErrors(0.01))}, {"": LINE.points})
    signals = observing.signals({"": nodes})
    squares = ((signals[:, None] - signals[None]) ** 2).sum(axis=2)
    apart = draws[:, None] - draws[None]
    np.testing.assert_allclose(
        squares, np.einsum("ijk,kl,ijl->ij", apart, by_hand(X, 0.01), apart), rtol=1e-3, atol=1e-6
    )


def test_displacement_in_standard_deviations() -> None:
    lower = {"": LINE.points - np.array([0.0, 0.03])}
    assert Observing({"": view(PointErrors(0.01))}, {"": LINE.points}).displacement(lower) == pytest.approx(3.0)


def test_parts_of_surfaces_and_too_few_points_are_refused() -> None:
    with pytest.raises(InvalidInput, match="at least 3 points"):
        focused(view(PointErrors(0.01)), LINE.points, part=(0.0, 0.03))
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    surface = Interface(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    whole = View(footprint(surface, surface), PointErrors(0.01))
    assert focused(whole, corners) is whole
    with pytest.raises(InvalidInput, match="the whole surface"):
        focused(whole, corners, points=10)
