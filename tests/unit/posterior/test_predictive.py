"""Bands of interfaces, and offsets along and to a polyline."""

import numpy as np

from strandline.interface import Interface
from strandline.posterior import interface_band, normal_offsets, observed_offsets

LINE = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]]))
ANGLES = np.linspace(0, 2 * np.pi, 90, endpoint=False)
ROUND = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
CIRCLE = Interface.polyline(ROUND, closed=True)
"""Run through anticlockwise: its inside is to the left."""


def test_the_band_is_that_of_each_coordinate() -> None:
    values = np.random.default_rng(9).normal(size=(41, 5, 3))
    band, ordered = interface_band(values), np.sort(values, axis=0)
    for found, row in ((band.low, 2), (band.median, 20), (band.high, 38)):
        np.testing.assert_allclose(found, ordered[row])


def test_offsets_of_nodes_are_positive_to_the_left() -> None:
    found = normal_offsets(LINE.points + np.array([[[0.2, 0.1]], [[0.0, -0.3]]]), LINE)
    np.testing.assert_allclose(found.arc_length, [0, 1, 3])
    np.testing.assert_allclose(found.offset, [[0.1] * 3, [-0.3] * 3], atol=1e-15)
    found = normal_offsets(np.stack([1.1 * ROUND]), CIRCLE)
    np.testing.assert_allclose(found.offset, -0.1)
    np.testing.assert_allclose(found.arc_length, 2 * np.sin(np.pi / 90) * np.arange(90))


def test_offsets_of_other_points_are_to_the_closest_place() -> None:
    observed = Interface.polyline(np.array([[3.0, -0.4], [2.0, 0.2], [0.5, 0.0], [-0.3, 0.4]]))
    found = observed_offsets(observed, LINE)
    np.testing.assert_allclose(found.arc_length, [0.0, 0.5, 2.0, 3.0])
    np.testing.assert_allclose(found.offset, [0.5, 0.0, 0.2, -0.4])
    found = observed_offsets(Interface.polyline(0.9 * ROUND[3:80], closed=False), CIRCLE)
    np.testing.assert_allclose(found.offset, 0.1, atol=2e-3)
    assert (np.diff(found.arc_length) > 0).all()
