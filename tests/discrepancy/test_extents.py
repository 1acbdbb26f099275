"""Sizes of interfaces, and the unit that was probably mistaken."""

import numpy as np
import pytest

from strandline.discrepancy import extent, extent_ratio, unit_mistake
from strandline.interface import Interface


def slope(width: float, height: float) -> Interface:
    return Interface.polyline(np.array([[1.0, 2.0], [1.0 + width, 2.0 + height]]))


def test_the_extent_is_the_largest_side_of_the_box() -> None:
    assert extent(slope(0.3, 0.8)) == pytest.approx(0.8)
    assert extent(slope(0.9, 0.8)) == pytest.approx(0.9)
    assert extent_ratio(slope(0.3, 0.8), slope(0.2, 0.1)) == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("ratio", "observed", "read_in", "factor"),
    [
        (1e3, "µm", "mm", "1000"),
        (1e-3, "mm", "µm", "1000"),
        (800.0, "µm", "mm", "1000"),
        (10.0, "mm", "cm", "10"),
        (0.1, "cm", "mm", "10"),
        (2e6, "µm", "m", "1e+06"),
    ],
)
def test_the_unit_that_was_mistaken(ratio: float, observed: str, read_in: str, factor: str) -> None:
    """An observation in µm that is read in mm appears a thousand times as large as the model's."""
    said = unit_mistake(ratio)
    assert f"the observation is in {observed} and was read in {read_in}" in said
    assert f"differ by a factor of {factor})" in said


@pytest.mark.parametrize("ratio", [1.0, 9.0, 1 / 9])
def test_similar_sizes_are_no_mistake(ratio: float) -> None:
    assert unit_mistake(ratio) == ""
