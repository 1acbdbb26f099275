"""Bands of interfaces, and offsets along and to a polyline."""

import numpy as np

from strandline.interface import Interface
from strandline.posterior import interface_band, normal_offsets, observed_offsets

LINE = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]]))
ANGLES = np.linspace(0, 2 * np.pi, 90, endpoint=False)
CIRCLE = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)


def test_the_band_is_that_of_each_coordinate() -> None:
    values = np.random.default_rng(9).normal(size=(41, 5, 3))
    band = interface_band(values)
    ordered = np.sort(values, axis=0)
    np.testing.assert_allclose(band.low, ordered[2])
    np.testing.assert_allclose(band.median, ordered[20])
    np.testing.assert_allclose(band.high, ordered[38])


def test_offsets_of_nodes_are_positive_to_the_left() -> None:
    points = np.stack([LINE.points + np.array([0.2, 0.1]), LINE.points - np.array([0.0, 0.3])])
    found = normal_offsets(points, LINE)
    np.testing.assert_allclose(found.arc_length, [0, 1, 3])
    np.testing.assert_allclose(found.offset, [[0.1] * 3, [-0.3] * 3], atol=1e-15)


def test_offsets_of_nodes_on_a_closed_line() -> None:
    """Run through anticlockwise, a circle has its inside to the left."""
    circle = Interface.polyline(CIRCLE, closed=True)
    found = normal_offsets(np.stack([1.1 * CIRCLE]), circle)
    np.testing.assert_allclose(found.offset, -0.1)
    chord = 2 * np.sin(np.pi / 90)
    np.testing.assert_allclose(found.arc_length, chord * np.arange(90))


def test_offsets_of_other_points() -> None:
    observed = Interface.polyline(np.array([[3.0, -0.4], [2.0, 0.2], [0.5, 0.0], [-0.3, 0.4]]))
    found = observed_offsets(observed, LINE)
    np.testing.assert_allclose(found.arc_length, [0.0, 0.5, 2.0, 3.0])
    np.testing.assert_allclose(found.offset, [0.5, 0.0, 0.2, -0.4])


def test_offsets_of_other_points_from_a_closed_line() -> None:
    circle = Interface.polyline(CIRCLE, closed=True)
    inner = Interface.polyline(0.9 * CIRCLE[3:80], closed=False)
    found = observed_offsets(inner, circle)
    np.testing.assert_allclose(found.offset, 0.1, atol=2e-3)
    assert (np.diff(found.arc_length) > 0).all()
