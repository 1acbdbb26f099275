"""Candidates, what they look at and with what errors, and the interface in another experiment, against sums by hand."""

from dataclasses import replace

import numpy as np
import pytest

from strandline.calibration.experiment import CoordinateErrors, footprint
from strandline.design import sobol
from strandline.design.candidates import Look, candidates
from strandline.foundations import InvalidInput
from strandline.interface import Interface, PointErrors
from strandline.questions.observing import Observing, View, crossing_share, focused, learn_failure_by_size, transfer
from strandline.surrogate.field import FieldTraining, fit_field

X = np.linspace(0.0, 2.0, 41)
LINE = Interface.polyline(np.column_stack([X, np.zeros(41)]))
SLOPES = {"": np.stack([np.column_stack([0 * X, X]), np.column_stack([0 * X, X**2])], axis=2)}
"""The line rises by x and by x² per unit of two inputs."""
EVEN = PointErrors(0.01)


def test_candidates_are_all_combinations_alone_and_together_in_words():
    """Present values and values given twice are one candidate."""
    found = candidates({"V_in": [50.0, 100.0, 50.0]}, [Look()], together=2, present={"V_in": 100.0})
    again = ["V_in 50", "the same again", "V_in 50 and V_in 50", "V_in 50 and the same again", "the same again, twice"]
    assert [one.label() for one in found] == again
    look = Look(("slow",), (0.0, 0.5), sd=0.003)
    one, other = candidates({"V_in": [50.0], "h": [0.5]}, [look, Look(points=20)])
    assert one.label() == "V_in 50 h 0.5, condition slow, 0–50 % of the interface, sd 3 µm"
    assert other.label() == "V_in 50 h 0.5, 20 points"


def view(errors=EVEN, line=LINE, along=None, **part):
    """Return a view of a line, or of a part of it."""
    whole = View(footprint(LINE, LINE), errors)
    return focused(whole, line.points, Look(**part), along) if part else whole


def fisher(one):
    return Observing({"": one}, {"": LINE.points}).fisher(SLOPES)


def by_hand(x, sd):
    rows = np.column_stack([x, x**2]) / np.reshape(sd, (-1, 1))
    return rows.T @ rows


def test_the_whole_line_a_part_and_other_points():
    places = np.linspace(0.5, 1.5, 5)
    np.testing.assert_allclose(fisher(view(part=(0.5, 1.0))), by_hand(X[20:], 0.01))
    np.testing.assert_allclose(fisher(view(part=(0.25, 0.75), points=5)), by_hand(places, 0.01), rtol=2e-3)
    for errors in (EVEN, CoordinateErrors(0.01)):
        np.testing.assert_allclose(fisher(view(errors)), by_hand(X, 0.01))
        np.testing.assert_allclose(fisher(view(errors, sd=0.005)), by_hand(X, 0.005))


def test_views_of_two_models_have_the_same_points_if_one_arc_length_counts():
    """Where one model stretches the line's first half, fewer of its points lie in it."""
    stretched, part = Interface.polyline(np.column_stack([np.where(X < 1, 3 * X, X + 2), np.zeros(41)])), (0.0, 0.4)
    assert len(view(part=part).footprint.corners) != len(view(line=stretched, part=part).footprint.corners)
    for options in ({}, {"points": 7}):
        one, other = view(part=part, **options), view(line=stretched, part=part, along=LINE, **options)
        np.testing.assert_allclose(other.seen(LINE.points).points, one.seen(LINE.points).points)


def test_errors_of_each_point_go_with_their_points():
    shares = np.linspace(1.0, 2.0, 41)
    errors = PointErrors(0.01, shares=tuple(shares))
    half = view(errors, part=(0.5, 1.0))
    assert half.errors == PointErrors(0.01, shares=tuple(shares[20:]))
    np.testing.assert_allclose(fisher(half), by_hand(X[20:], 0.01 * shares[20:]))


def test_shared_errors_of_two_conditions_count_once():
    """A common shift of unknown size hides what both lines do together; what differs between them stays."""
    together, opposite = ({"": SLOPES[""], "b": sign * SLOPES[""]} for sign in (1, -1))
    own = PointErrors(0.01, shift=0.5)
    for errors, shared in ((replace(own, shared=True), True), (own, False)):
        both = Observing({"": view(errors), "b": view(errors)}, {"": LINE.points, "b": LINE.points})
        ratio = both.fisher(opposite)[0, 0] / both.fisher(together)[0, 0]
        assert ratio > 2.0 if shared else ratio == pytest.approx(1.0, rel=1e-6)


def test_part_of_a_closed_outline_is_open_and_a_surface_is_whole():
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = Interface.polyline(np.column_stack([np.cos(angles), np.sin(angles)]), closed=True)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    surface = Interface(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    whole, all_of_it = (View(footprint(one, one), EVEN) for one in (ring, surface))
    assert focused(whole, ring.points, Look(points=20)).seen(ring.points).closed
    part = focused(whole, ring.points, Look(part=(0.0, 0.5))).seen(ring.points)
    assert (part.closed, len(part.points)) == (False, 21)
    with pytest.raises(InvalidInput, match="the whole surface"):
        focused(all_of_it, corners, Look(points=10))


S = np.linspace(0.0, 1.0, 21)


def bent(young, load):
    """Return arcs of height load/E, mm."""
    heights = load / young[:, None] * np.sin(np.pi * S)
    return np.stack([np.broadcast_to(S, heights.shape), heights], axis=-1)


def test_arcs_fail_where_they_are_too_high():
    """Of 60 runs at load 100, those with arcs higher than 0.4 mm failed; the share at the limit is the true one."""
    x = 100.0 + 700.0 * sobol(60, 1, scramble=1)
    ok = 100.0 / x[:, 0] < 0.4
    runs = [{"": Interface.polyline(points)} for points in bent(x[ok, 0], 100.0)]
    surrogate = fit_field(FieldTraining(x[ok], runs, None, np.array([100.0]), np.array([800.0])))
    found = learn_failure_by_size(surrogate, x, ok, np.column_stack([S, 0 * S]).ravel(), np.empty((0, 2 * len(S))))
    young = np.random.default_rng(1).normal(400, 60, 500)
    shares = [float(found(bent(young, load).reshape(500, -1)).mean()) for load in (20.0, 100.0, 160.0, 250.0)]
    assert shares == sorted(shares)
    assert shares[1] <= 0.05
    assert shares[2] == pytest.approx(float((160.0 / young > 0.4).mean()), abs=0.1)
    assert shares[3] >= 0.9


def test_the_share_of_interfaces_that_cross_themselves():
    loop = np.array([[0.0, 0], [1, 0], [1, 1], [0.5, -1], [2, -1]])
    line = np.column_stack([np.arange(5.0), np.zeros(5)])
    assert crossing_share({"": np.array([loop, line, line, line])}, {"": Interface.polyline(line)}) == 0.25


LOW, HIGH, AT = np.array([100.0, -0.8]), np.array([800.0, 0.5]), np.array([400.0, 0.2])


def fields(x, load):
    """Return displacements across: one shape that softens with the load, one that depends on ν."""
    share, nu = load / x[:, :1], x[:, 1:]
    across = (share + 2 * share**2) * np.sin(np.pi * S) + share * np.exp(1.5 * nu) * np.sin(2 * np.pi * S)
    return np.stack([np.broadcast_to(S, across.shape), across], axis=-1).reshape(len(x), -1)


def slopes_of(displacements, step):
    """Return the slopes at `AT` by central differences."""
    return ((displacements(AT + np.diag(step)) - displacements(AT - np.diag(step))) / (2 * np.array(step)[:, None])).T


@pytest.mark.parametrize(("load", "most"), [(20.0, 0.02), (40.0, 2e-3), (60.0, 0.03)])
def test_one_run_predicts_the_interface_under_another_load(load, most):
    """At the inputs of the run it is the run itself, with its slopes."""
    x, covariance = LOW + (HIGH - LOW) * sobol(40, 2, scramble=1), np.array([[900.0, 2.0], [2.0, 0.01]])
    runs = [{"": Interface.polyline(row.reshape(-1, 2))} for row in fields(x, 40.0)]
    surrogate = fit_field(FieldTraining(x, runs, None, LOW, HIGH))
    draws = np.random.default_rng(1).multivariate_normal(AT, covariance, 200)
    true, here = fields(draws, load), fields(AT[None], load)[0]
    slopes = slopes_of(lambda x: fields(x, load), [1e-2, 1e-5])
    one = transfer(surrogate, AT, here, slopes, covariance)
    assert np.sqrt(np.mean((one(draws) - true) ** 2) / np.mean((true - true.mean(axis=0)) ** 2)) < most
    np.testing.assert_allclose(one(AT[None])[0], here, atol=1e-12)
    largest = np.abs(slopes).max(axis=0)
    np.testing.assert_allclose(slopes_of(one, [1.0, 1e-3]) / largest, slopes / largest, atol=2e-3)
