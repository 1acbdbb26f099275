"""The noise variance of a measure: by the general rule, by closed forms, and by what it does to the coverage."""

import numpy as np
import pytest
from tests.discrepancy.surfaces import sheet, sphere

from strandline.discrepancy import (
    ClosestPoint,
    Currents,
    Discrepancy,
    MeasurementLines,
    TrackedPoints,
    WhitenedOffset,
)
from strandline.errors import InvalidInput
from strandline.interface import Interface, PointErrors
from strandline.likelihood.noise_rule import _shapes, fitting_variance, noise_variance

NODES = np.linspace(0.0, 1.0, 61)
AT, STEPS = np.array([0.3, 0.05]), np.array([2e-3, 2e-3])
TO_SIMULATED = ClosestPoint(direction="to_simulated")
MEAN = ClosestPoint(direction="to_simulated", weighting="length")


def arches(x: np.ndarray) -> np.ndarray:
    """Return an arch of some height that leans to one side."""
    height, lean = x[:, :1], x[:, 1:]
    y = 4 * height * NODES * (1 - NODES)
    return np.stack([NODES + lean * np.sin(np.pi * NODES), y], axis=2)


def arch(x: np.ndarray = AT, number: int = 61) -> Interface:
    found = Interface.polyline(arches(x[None])[0])
    return found if number == 61 else found.resampled(number)


def by_rule(measure: Discrepancy, errors: PointErrors, *, number: int = 61, draws: int = 200) -> float:
    return fitting_variance(measure, arches, arch(), AT, STEPS, arch(number=number), errors, draws=draws)


@pytest.mark.parametrize(
    ("measure", "errors"),
    [
        (TO_SIMULATED, PointErrors(0.002)),
        (TO_SIMULATED, PointErrors(0.002, 0.06)),
        (MEAN, PointErrors(0.002)),
        (MEAN, PointErrors(0.002, 0.06)),
        (Currents(0.1), PointErrors(0.002)),
        (Currents(0.1), PointErrors(0.002, 0.03)),
        (MeasurementLines(20), PointErrors(0.001)),
        (MeasurementLines(10, smooth=0.1), PointErrors(0.001, 0.03)),
    ],
    ids=str,
)
def test_closed_forms_agree_with_the_general_rule(measure: Discrepancy, errors: PointErrors) -> None:
    expected = measure.noise_variance(errors, arch())  # type: ignore[attr-defined]
    assert by_rule(measure, errors) == pytest.approx(expected, rel=0.35)


def test_the_rule_knows_what_independent_residuals_are() -> None:
    assert by_rule(WhitenedOffset(PointErrors(0.002)), PointErrors(0.002)) == pytest.approx(1.0, rel=0.15)
    assert by_rule(WhitenedOffset(PointErrors(0.002, 0.06)), PointErrors(0.002, 0.06)) == pytest.approx(1.0, rel=0.35)


def test_a_square_of_the_sd_is_wrong_for_a_mean() -> None:
    """What a user would type: six times too wide."""
    assert by_rule(MEAN, PointErrors(0.002)) < 0.05 * 0.002**2


def test_global_errors_show_as_a_large_variance() -> None:
    local, shifted = PointErrors(0.002), PointErrors(0.002, shift=0.01)
    assert by_rule(TO_SIMULATED, shifted) > 10 * by_rule(TO_SIMULATED, local)


def test_more_points_do_not_change_the_variance_of_each() -> None:
    few, many = (by_rule(TO_SIMULATED, PointErrors(0.002), number=number) for number in (61, 200))
    assert many == pytest.approx(few, rel=0.3)


def test_forms_that_do_not_hold_are_left_out() -> None:
    errors = PointErrors(0.01)
    assert ClosestPoint().noise_variance(errors, arch()) is None
    assert Currents(0.005).noise_variance(errors, arch()) is None
    assert MeasurementLines(10).noise_variance(errors, arch()) is None


@pytest.mark.parametrize("measure", [ClosestPoint(), Currents(0.1), Currents(0.01), MEAN], ids=str)
def test_smooth_shapes_stand_for_the_inputs(measure: Discrepancy) -> None:
    """Before any run, the variance is nearly that which the model's own inputs ask for."""
    errors = PointErrors(0.002, 0.02)
    assert noise_variance(measure, arch(), errors, 61) == pytest.approx(by_rule(measure, errors), rel=0.4)


def test_tracked_points_err_along_the_interface_as_much_as_across_it() -> None:
    for errors, expected in ((PointErrors(0.002), 0.002**2), (PointErrors(0.002, 0.06), 0.002**2 * 0.12 / SPACING)):
        assert noise_variance(TrackedPoints(), arch(), errors, 61) == pytest.approx(expected, rel=0.1)


SPACING = float(arch().lengths.mean())


def test_a_closed_form_that_the_rule_confirms_is_taken() -> None:
    errors = PointErrors(0.002)
    assert noise_variance(TO_SIMULATED, arch(), errors, 61) == TO_SIMULATED.noise_variance(errors, arch())


def test_global_errors_do_not_widen_a_variance() -> None:
    local, both = PointErrors(0.002), PointErrors(0.002, shift=0.05, offset=0.01)
    assert noise_variance(ClosestPoint(), arch(), both, 61) == noise_variance(ClosestPoint(), arch(), local, 61)


def test_a_measure_without_a_minimum_is_refused() -> None:
    with pytest.raises(InvalidInput, match="normal_offset"):
        noise_variance(lambda simulated, observed: 1.0, arch(), PointErrors(0.002), 61)


@pytest.mark.parametrize(
    "measure",
    [
        ClosestPoint(direction="to_simulated"),
        ClosestPoint(direction="to_simulated", weighting="length"),
        Currents(0.6, quadrature="centre"),
    ],
    ids=str,
)
@pytest.mark.parametrize("length", [0.0, 0.15])
def test_closed_forms_agree_with_the_rule_on_a_surface(measure: ClosestPoint | Currents, length: float) -> None:
    """The rule sees only a function; a square of the sd alone would be off by far more."""
    surface, errors = sphere(1.0, 2), PointErrors(0.01, length)
    closed = measure.noise_variance(errors, surface)
    assert closed is not None
    by_draws = noise_variance(lambda a, b: measure(a, b), surface, errors, len(surface.points), draws=30)
    assert closed == pytest.approx(by_draws, rel=0.4)


@pytest.mark.parametrize("radius", [0.05, 1.0, 20.0])
def test_smooth_shapes_move_a_sphere_along_its_radii_whatever_its_size(radius: float) -> None:
    ball = sphere(radius, 3)
    np.testing.assert_allclose((_shapes(ball)[0] * ball.points).sum(axis=1), radius, rtol=0.01)


def test_smooth_shapes_move_a_wavy_sheet_along_its_normals() -> None:
    """z = 0.1 sin(5u) cos(4v) over the unit square; normals at the rim are one-sided."""
    wavy = sheet(40, bend=0.1)
    u, v, _ = wavy.points.T
    slopes = 0.5 * np.cos(5 * u) * np.cos(4 * v), -0.4 * np.sin(5 * u) * np.sin(4 * v)
    exact = np.stack([-slopes[0], -slopes[1], np.ones(len(u))], axis=1)
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    assert (_shapes(wavy)[0] * exact).sum(axis=1).min() > 0.99
    assert exact[:, 2].min() < 0.95


def test_shapes_of_a_surface_have_amplitudes_of_one() -> None:
    shapes = _shapes(sheet(12))
    assert len(shapes) == 4
    sizes = np.linalg.norm(shapes, axis=2).max(axis=1)
    assert (sizes > 0.1).all()
    assert (sizes < 1.001).all()
