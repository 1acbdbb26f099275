"""Designs that cost no run, against a true posterior in closed form up to quadrature."""

from collections.abc import Mapping

import numpy as np
import pytest
from verification.reproduction.field_table import LoadCoordinates
from verification.reproduction.grid_posterior import Difference, posterior_on_grid, product_grid
from verification.reproduction.larger_designs import READINGS, LargerDesign, larger_designs, runs_to_find
from verification.reproduction.log_likelihood_field import LogLikelihoodField, spline_field

from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform

SPACE = ParameterSpace(
    (
        Parameter("E", Uniform(100.0, 800.0), "Pa"),
        Parameter("nu", Uniform(-0.8, 0.5)),
        Parameter("V_in", Uniform(20.0, 100.0), "mm^2/s", nuisance=True),
    )
)
SIZES = (40, 160, 320)


def field_about(centre: float) -> LogLikelihoodField:
    """A ridge along a constant load, so that E goes with V, and a peak in ν."""
    axes = (np.linspace(-1.0, 1.0, 61), np.linspace(-1.0, 1.0, 15), np.linspace(-1.0, 1.0, 11))
    box = LoadCoordinates()
    x = box.from_box(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    load = np.where(np.isfinite(x[..., 0]), box.load(x), 0.0)
    values = -30 * (1 - np.exp(-(((load - centre) / 0.1) ** 2) / 60)) - 0.5 * ((x[..., 1] - 0.1) / 0.25) ** 2
    return spline_field(box, axes, values)


FIELD = field_about(0.45)


def compared(
    field: LogLikelihoodField, true: LogLikelihoodField, sizes: tuple[int, ...] = SIZES, **options: int
) -> tuple[LargerDesign, ...]:
    grid = product_grid(SPACE, panels=(16, 8, 6))
    truth = {reading: posterior_on_grid(true, SPACE, grid, reading=reading) for reading in READINGS}
    return larger_designs(field, truth, SPACE, sizes=sizes, panels=(16, 8, 6), **options)


@pytest.fixture(scope="module")
def designs() -> tuple[LargerDesign, ...]:
    return compared(FIELD, FIELD)


def test_more_runs_come_nearer_until_the_posterior_is_found(designs: tuple[LargerDesign, ...]) -> None:
    for reading in READINGS:
        off = [float(np.abs(d.differences[reading].mean).max()) for d in designs]
        assert off[-1] < 0.15 < off[0], reading
        assert runs_to_find(designs, reading) in SIZES[1:]
    assert [design.runs for design in designs] == list(SIZES)
    # Points beyond the table are no training points.
    assert all(0.85 * design.runs < design.succeeded < design.runs for design in designs)


def test_the_posterior_of_another_model_is_not_found() -> None:
    """Planted: the designs answer a softer model than the truth is of."""
    softer = compared(field_about(0.5), FIELD, SIZES[-1:])
    assert all(runs_to_find(softer, reading) is None for reading in READINGS)


def test_hyperparameters_of_the_first_runs_serve_the_larger_designs(designs: tuple[LargerDesign, ...]) -> None:
    frozen = compared(FIELD, FIELD, fitted=160)
    for reading in READINGS:
        np.testing.assert_array_equal(frozen[1].differences[reading].mean, designs[1].differences[reading].mean)
        assert np.abs(frozen[2].differences[reading].mean - designs[2].differences[reading].mean).max() < 0.1


def differences(mean: float, ratio: float = 0.0) -> Mapping[str, Difference]:
    one = Difference(np.array([0.0, mean]), np.array([ratio, 0.0]), 0.0, 0.0, None)
    return dict.fromkeys(READINGS, one)


def test_found_is_what_stays_found_in_the_mean_and_the_standard_deviation() -> None:
    for found, runs in (((0, 1, 1), 160), ((1, 0, 1), 320), ((1, 1, 1), 40), ((1, 1, 0), None)):
        designs = [LargerDesign(n, n, differences(0.1 if ok else 0.2)) for n, ok in zip(SIZES, found, strict=True)]
        assert runs_to_find(designs, "joint") == runs
    assert LargerDesign(9, 9, differences(-0.1)).found("cut")
    assert not LargerDesign(9, 9, differences(-0.2)).found("cut")
    assert not LargerDesign(9, 9, differences(0.0, ratio=-0.2)).found("cut")
