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
SIZES = (40, 160, 640)


def field_about(centre: float) -> LogLikelihoodField:
    """A ridge along a constant load, so that E goes with V, and a peak in ν."""
    axes = (np.linspace(-1.0, 1.0, 61), np.linspace(-1.0, 1.0, 15), np.linspace(-1.0, 1.0, 11))
    box = LoadCoordinates()
    x = box.from_box(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    load = np.where(np.isfinite(x[..., 0]), box.load(x), 0.0)
    values = -30 * (1 - np.exp(-(((load - centre) / 0.1) ** 2) / 60)) - 0.5 * ((x[..., 1] - 0.1) / 0.25) ** 2
    return spline_field(box, axes, values)


@pytest.fixture(scope="module")
def field() -> LogLikelihoodField:
    return field_about(0.45)


@pytest.fixture(scope="module")
def designs(field: LogLikelihoodField) -> tuple[LargerDesign, ...]:
    return compared(field, field)


def compared(
    field: LogLikelihoodField, true: LogLikelihoodField, sizes: tuple[int, ...] = SIZES, **options: int
) -> tuple[LargerDesign, ...]:
    grid = product_grid(SPACE, panels=(16, 8, 6))
    truth = {reading: posterior_on_grid(true, SPACE, grid, reading=reading) for reading in READINGS}
    return larger_designs(field, truth, SPACE, sizes=sizes, panels=(16, 8, 6), **options)


def test_more_runs_come_nearer_until_the_posterior_is_found(designs: tuple[LargerDesign, ...]) -> None:
    for reading in READINGS:
        off = [float(np.abs(d.differences[reading].mean).max()) for d in designs]
        assert off[-1] < 0.15 < off[0], reading
        assert runs_to_find(designs, reading) in SIZES[1:]


def test_points_beyond_the_table_are_no_training_points(
    field: LogLikelihoodField, designs: tuple[LargerDesign, ...]
) -> None:
    inside = [design.succeeded for design in designs]
    assert [design.runs for design in designs] == list(SIZES)
    assert all(0.85 * n < k < n for n, k in zip(SIZES, inside, strict=True))


def test_the_posterior_of_another_model_is_not_found(field: LogLikelihoodField) -> None:
    """Planted: the designs answer a softer model than the truth is of."""
    softer = compared(field_about(0.5), field, SIZES[-1:])
    assert all(runs_to_find(softer, reading) is None for reading in READINGS)


def test_hyperparameters_of_the_first_runs_serve_the_larger_designs(
    field: LogLikelihoodField, designs: tuple[LargerDesign, ...]
) -> None:
    frozen = compared(field, field, fitted=160)
    for reading in READINGS:
        np.testing.assert_array_equal(frozen[1].differences[reading].mean, designs[1].differences[reading].mean)
        assert np.abs(frozen[2].differences[reading].mean - designs[2].differences[reading].mean).max() < 0.1


@pytest.mark.parametrize(
    ("found", "runs"),
    [([False, True, True], 160), ([True, False, True], 640), ([True, True, True], 40), ([True, True, False], None)],
)
def test_found_is_what_stays_found(found: list[bool], runs: int | None) -> None:
    designs = [LargerDesign(n, n, differences(0.1 if ok else 0.2)) for n, ok in zip(SIZES, found, strict=True)]
    assert runs_to_find(designs, "joint") == runs


def test_both_the_mean_and_the_standard_deviation_must_be_found() -> None:
    assert LargerDesign(9, 9, differences(-0.1)).found("cut")
    assert not LargerDesign(9, 9, differences(-0.2)).found("cut")
    assert not LargerDesign(9, 9, differences(0.0, ratio=-0.2)).found("cut")


def differences(mean: float, ratio: float = 0.0) -> Mapping[str, Difference]:
    one = Difference(np.array([0.0, mean]), np.array([ratio, 0.0]), 0.0, 0.0, None)
    return dict.fromkeys(READINGS, one)
