"""Interfaces of all runs over common points, and which runs have none with most others."""

import numpy as np
import pytest
import shapely
from tests.unit.discrepancy.surfaces import divided, sheet

from strandline.foundations import InvalidInterface
from strandline.interface import Interface
from strandline.surrogate.field.correspondence import (
    FEWEST_POINTS,
    common_layout,
    fields_of,
    flipped,
    odd_ones,
    registered,
    stopped_early,
)


def line(s, y):
    return Interface.polyline(np.stack([s, y], axis=1))


def arc(nodes, *, height=0.3, seed=None):
    """Return an arc, through unevenly spaced nodes if there is a seed."""
    s = np.linspace(0.0, 1.0, nodes)
    if seed is not None:
        s[1:-1] = np.sort(np.random.default_rng(seed).uniform(0.0, 1.0, nodes - 2))
    return line(s, height * np.sin(np.pi * s))


def ring(nodes, *, start=0.0):
    angle = start + np.linspace(0.0, 2 * np.pi, nodes, endpoint=False)
    return Interface.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)


def test_nodes_that_correspond_are_taken_as_they_are_and_weigh_their_share_of_the_length_or_the_area():
    runs, surface = [arc(20), arc(20, height=0.5)], sheet(5)
    layout = common_layout(runs)
    assert layout.way == "nodes"
    np.testing.assert_array_equal(registered(runs[1], layout)[0], runs[1].points)
    layout = common_layout([line([0.0, 1.0, 4.0], [0.0, 0.0, 0.0])])
    np.testing.assert_allclose(layout.weights, [1 / 8, 1 / 2, 3 / 8])
    for other, way in ((sheet(5, height=0.1), "nodes"), (divided(surface), "projection")):
        layout = common_layout([surface, other])
        assert layout.way == way
        assert layout.weights.sum() == pytest.approx(1.0)
        assert layout.weights @ surface.points[:, 0] == pytest.approx(0.5)


def test_polylines_of_other_nodes_are_taken_by_arclength():
    runs = [arc(60, seed=1), arc(90, seed=2), arc(75, seed=3).reversed()]
    layout = common_layout(runs)
    assert layout.way == "arclength"
    assert len(layout.template.points) == 90
    taken = [registered(run, layout) for run in runs]
    for run, (points, error) in zip(runs, taken, strict=True):
        distances = shapely.distance(shapely.points(run.points), shapely.LineString(points))
        assert error == pytest.approx(np.sqrt(np.mean(distances**2)))
        np.testing.assert_allclose(points, taken[0][0], atol=5e-3)
        np.testing.assert_allclose(points[:, 1], 0.3 * np.sin(np.pi * points[:, 0]), atol=2e-3)
        assert 0 < error < 1e-3
    fields, worst = fields_of([{"": run} for run in runs], {"": layout})
    np.testing.assert_array_equal(fields, [points.ravel() for points, _ in taken])
    assert worst == max(error for _, error in taken)
    assert len(common_layout([arc(4), arc(5)]).template.points) == FEWEST_POINTS


def test_closed_polylines_may_begin_anywhere_and_run_either_way():
    runs = [ring(80), ring(97, start=2.1), ring(97, start=1.0).reversed()]
    layout = common_layout(runs)
    first, _ = registered(runs[0], layout)
    for run in runs[1:]:
        points, error = registered(run, layout)
        assert np.abs(points - first).max() < 2 * np.pi / 97 + 1e-3  # the first nodes differ by half a segment
        assert error < 2e-3


def test_interfaces_of_other_kinds_are_refused():
    for together, other, words in (
        ([arc(30), ring(30)], None, "open polylines in some runs"),
        ([sheet(4), arc(30)], None, "polylines in some runs, surfaces in others"),
        ([arc(30), arc(40)], ring(30), "open or closed where the others are not"),
        ([arc(20)], arc(21), "a different number of points"),
        ([sheet(4), sheet(5)], arc(30), "a polyline where the others are surfaces"),
    ):
        with pytest.raises(InvalidInterface, match=words):
            registered(other, common_layout(together))


def test_the_surface_that_no_other_fits_is_odd_even_if_it_comes_first_and_so_is_another_kind():
    """The others have different meshes of the same square; the first one is three times as large."""
    squares = [sheet(nodes, bend=0.02) for nodes in (6, 7, 8, 9, 10)]
    assert list(odd_ones([{"": one} for one in [sheet(7, size=3.0), *squares]], 0.01)) == [0]
    assert odd_ones([{"": one} for one in squares], 0.01) == {}
    found = odd_ones([{"": one} for one in (*(arc(9, height=h) for h in (0.1, 0.2, 0.3)), ring(8))], 0.01)
    assert found == {3: "its interface is a closed polyline, most others are an open polyline"}


def test_an_interface_close_to_another_one_in_the_opposite_direction_is_flipped():
    """Reversing the points of a line of length 1 moves them by 0.58, root mean square."""
    s = np.linspace(0.0, 1.0, 40)
    for off, is_flipped in ((0.0, True), (0.2, True), (0.6, False)):
        other = line(s, 0 * s + off * 0.58)
        assert flipped(other.reversed(), line(s, 0 * s)) == is_flipped
        assert not flipped(other, line(s, 0 * s))


def rod(height, *, points=41, of=41, floor=None, held=0, tilt=0.3):
    """Return part of a line of 41 points on [0, 1], perhaps with a floor, or with its last values held."""
    y = height + tilt * np.linspace(0, 1, of)
    y[of - held :] = y[of - held - 1]
    xy = np.stack([np.linspace(0, 1, of), y if floor is None else np.maximum(y, floor)], axis=1)
    return {"": Interface.polyline(xy[:points])}


WHOLE = [rod(0.01 * k) for k in range(12)]
S = np.linspace(0, 1, 41)
ROUNDED = [{"": line(S, np.round(0.02 * k * np.sin(0.5 * np.pi * S), 2))} for k in range(1, 12)]
FLAT = [{"": line(S, np.round(0.01 * k + 0.3 * np.exp(-9 * S), 3))} for k in range(6)]  # three digits of a decay


@pytest.mark.parametrize(
    ("runs", "early"),
    [
        (WHOLE, []),
        ([*WHOLE, rod(0.2, points=21), rod(0.3, points=30)], [12, 13]),
        ([*(rod(0.01 * k, points=21) for k in range(20)), *WHOLE], list(range(20))),
        ([*WHOLE, rod(0.2, of=21, points=18)], []),  # one of a coarser mesh
        ([rod(0.1, points=n) for n in range(20, 41)], []),  # as long as its mesh
        ([*WHOLE, rod(0.2, held=1)], []),
        ([*WHOLE, rod(0.2, held=5), {"": rod(0.3, held=7)[""].reversed()}], [12, 13]),
        ([rod(0.01 * k, tilt=-0.3, floor=0.0) for k in range(12)], []),
        ([rod(0.01 * k, held=7) for k in range(12)], []),
        ([*WHOLE, *FLAT], []),
        (ROUNDED, []),
        ([], []),
    ],
)
def test_runs_that_stop_early_are_found_and_other_meshes_floors_and_habits_are_not(runs, early):
    assert list(stopped_early(runs)) == early
