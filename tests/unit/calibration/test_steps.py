"""Outputs in steps are found; smooth, clipped and symmetric ones, and those of a grid of inputs, are left alone."""

import numpy as np
import pytest
from tests.unit.discrepancy.curves import graph

from strandline.calibration.learning import steps_of
from strandline.design import sobol

X = np.linspace(0.0, 1.0, 41)
INPUTS = np.random.default_rng(1).random((32, 2))
ARCH = np.sin(np.pi * X)
"""Symmetric: each value occurs twice in a run."""


def found(shape, inputs=INPUTS):
    return [
        (one.axis, pytest.approx(one.step)) for one in steps_of([{"": graph(X, shape(*k))} for k in inputs], inputs)
    ]


@pytest.mark.parametrize("step", [1e-3, 0.05, 0.1])
def test_rounded_values_are_found(step):
    """Also in the coordinate of an interface that moves as a whole."""
    assert found(lambda a, b: step * np.round(0.6 * a * ARCH / step)) == [("y", step)]
    assert found(lambda a, b: step * np.round((0.2 * a + b * X) / step)) == [("y", step)]


@pytest.mark.parametrize("digits", [1, 2, 3, 4])
@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_few_significant_digits_are_found(digits, unit):
    """The first 20 of 41 points lie nearer to 0, where steps are a tenth as long, and most of what is met."""

    def shape(a, b):
        growth = a * np.exp(b * X)
        exact = np.where(X < 0.5, 0.2 + 0.2 * growth, 2.0 + 0.5 * growth)  # none crosses a power of ten
        return [unit * float(f"{one:.{digits - 1}e}") for one in exact]

    long = unit * 10.0 ** (1 - digits)
    assert found(shape) == [("y", long * np.sqrt((20 * 0.01 + 21) / 41))]


def test_powers_of_ten_that_are_exact_make_no_longer_steps():
    """Whole numbers that end at 100 are not rounded to tens."""
    assert found(lambda a, b: np.minimum(np.round(400 * a * np.exp(b * X)), 100.0)) == [("y", 1.0)]


def test_what_is_not_rounded_is_not_told():
    assert found(lambda a, b: 0.6 * a * ARCH) == []
    assert found(lambda a, b: np.maximum(a * ARCH - b, -0.05)) == []  # on the ground
    assert found(lambda a, b: 0.3 * ARCH) == []  # the inputs do nothing
    assert found(lambda a, b: np.clip(2.0 * a * np.exp(b * X) - 0.5, 0.0, 1.0)) == []  # 0 and 1 are exact
    assert found(lambda a, b: np.where(X < 0.5, 0.5, np.exp(a * b * X))) == []  # the first half stays at 0.5
    assert found(lambda a, b: np.float32(a * np.exp(b * X))) == []
    fractions = sobol(64, 2)
    assert found(lambda a, b: a * X + b, fractions) == []
    assert found(lambda a, b: a * b * X, fractions) == []
    grid = np.stack(np.meshgrid(np.arange(8.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    assert found(lambda a, b: np.where(X < 0.5, a, b) * ARCH, grid) == []
    of_all_lengths = [{"": graph(X[: 41 - k], np.round(k * X[: 41 - k]))} for k in range(9)]
    assert steps_of(of_all_lengths, np.arange(9.0)[:, None]) == []
