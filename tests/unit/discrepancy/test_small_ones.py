"""Sizes of interfaces and units that were mistaken; distances in units of the noise; sums of registered residuals."""

import numpy as np
import pytest
from tests.unit.discrepancy.curves import level, line

from strandline.discrepancy import (
    ClosestPoint,
    Currents,
    apart,
    count_of_distances,
    extent,
    extent_ratio,
    noise_units,
    unit_mistake,
)
from strandline.discrepancy.registration import Rows, Sums, linear_sums
from strandline.interface import Interface


def slope(width: float, height: float) -> Interface:
    return line((1, 2), (1 + width, 2 + height))


def test_the_extent_is_the_largest_side_of_the_box() -> None:
    assert extent(slope(0.3, 0.8)) == pytest.approx(0.8)
    assert extent(slope(0.9, 0.8)) == pytest.approx(0.9)
    assert extent_ratio(slope(0.3, 0.8), slope(0.2, 0.1)) == pytest.approx(4.0)


def test_the_unit_that_was_mistaken_is_guessed_from_the_ratio_of_sizes() -> None:
    """An observation in µm that is read in mm appears a thousand times as large as the model's."""
    for ratio, observed, read_in, factor in (
        (1e3, "µm", "mm", "1000"),
        (1e-3, "mm", "µm", "1000"),
        (800.0, "µm", "mm", "1000"),
        (10.0, "mm", "cm", "10"),
        (0.1, "cm", "mm", "10"),
        (2e6, "µm", "m", "1e+06"),
    ):
        said = unit_mistake(ratio)
        assert f"the observation is in {observed} and was read in {read_in}" in said
        assert f"differ by a factor of {factor})" in said
    assert unit_mistake(1.0) == unit_mistake(9.0) == unit_mistake(1 / 9) == ""


def test_a_sum_of_distances_counts_by_their_root_mean_square_and_what_is_no_sum_as_a_whole() -> None:
    """Eleven nodes are 0.3 mm off, under noise of 0.1 mm."""
    simulated, observed, measure = level(0.3), level(0.0, nodes=5), ClosestPoint()
    count = count_of_distances(measure, simulated, observed)
    assert count == 11
    assert noise_units(measure(simulated, observed), 0.1**2, count) == pytest.approx(3.0)
    assert count_of_distances(Currents(0.1), level(0.3), level(0.0)) is None
    assert noise_units(0.09, 0.01, None) == pytest.approx(3.0)


def test_the_worse_direction_tells_how_far_interfaces_are_apart() -> None:
    """The end of the longer one is (0.3, 0.4) mm from that of the shorter one, whose nodes are all 0.3 mm from it."""
    short, long = level(0.0), line((0, 0.3), (1, 0.3), (1.4, 0.3))
    for one, other in ((short, long), (long, short)):
        rms, largest = apart(one, other)
        assert largest == pytest.approx(0.5)
        assert rms == pytest.approx(np.sqrt((0.3**2 + 0.3**2 + 0.5**2) / 3))


def test_global_errors_are_estimated_from_some_points_and_the_sums_taken_over_all() -> None:
    """Residuals of a line that is 0.3 too high, with one global error, its offset of sd 1, and with none."""
    asked: list[bool] = []

    def sums(points: Rows, rough: bool) -> Sums:
        asked.append(rough)
        r = points[""][:, :, 1]
        return (r**2).sum(axis=1), r.sum(axis=1)[:, None]

    def followed(points: Rows, g: np.ndarray) -> Rows:
        return {"": points[""] - g[:, :1, None] * np.array([0.0, 1.0])}

    points = {"": np.stack([np.arange(4.0), np.full(4, 0.3)], axis=1)[None]}
    squares, products = linear_sums(points, sums, lambda b: b / 5.0, followed, np.array([[4.0]]))
    np.testing.assert_allclose(squares, 4 * 0.3**2)
    np.testing.assert_allclose(products, [[4 * 0.3]])
    assert asked == [True, True, False]
    asked.clear()
    alone = linear_sums(points, lambda *given: (sums(*given)[0], np.zeros((1, 0))), lambda b: b, followed, np.eye(0))
    np.testing.assert_allclose(alone[0], 4 * 0.3**2)
    assert asked == [False]
