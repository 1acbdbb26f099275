"""The noise variance of a measure: by the general rule, by closed forms, and by what it does to the coverage."""

import numpy as np
import pytest
from tests.unit.discrepancy.surfaces import sheet, sphere

from strandline.discrepancy import ClosestPoint, Currents, Discrepancy, MeasurementLines, TrackedPoints, WhitenedOffset
from strandline.errors import InvalidInput
from strandline.interface import Interface, PointErrors
from strandline.likelihood.noise_rule import _shapes, fitting_variance, noise_variance

NUMBER, DRAWS = 41, 40
NODES = np.linspace(0.0, 1.0, NUMBER)
AT, STEPS = np.array([0.3, 0.05]), np.array([2e-3, 2e-3])
TO_SIMULATED = ClosestPoint(direction="to_simulated")
MEAN = ClosestPoint(direction="to_simulated", weighting="length")
FINE, CORRELATED = PointErrors(0.002), PointErrors(0.002, 0.06)


def arches(x: np.ndarray) -> np.ndarray:
    """Return an arch of some height that leans to one side."""
    height, lean = x[:, :1], x[:, 1:]
    y = 4 * height * NODES * (1 - NODES)
    return np.stack([NODES + lean * np.sin(np.pi * NODES), y], axis=2)


def arch(number: int = NUMBER) -> Interface:
    found = Interface.polyline(arches(AT[None])[0])
    return found if number == NUMBER else found.resampled(number)


def by_rule(measure: Discrepancy, errors: PointErrors, *, number: int = NUMBER, draws: int = DRAWS) -> float:
    return fitting_variance(measure, arches, arch(), AT, STEPS, arch(number), errors, draws=draws)


def test_closed_forms_agree_with_the_general_rule() -> None:
    for measure, errors in (
        (TO_SIMULATED, CORRELATED),
        (MEAN, CORRELATED),
        (Currents(0.1), PointErrors(0.002, 0.03)),
        (MeasurementLines(20), PointErrors(0.001)),
        (MeasurementLines(10, smooth=0.1), PointErrors(0.001, 0.03)),
    ):
        assert by_rule(measure, errors) == pytest.approx(measure.noise_variance(errors, arch()), rel=0.35), measure


def test_the_rule_knows_what_independent_residuals_are() -> None:
    """Global errors show as a large variance; more points do not change that of each."""
    assert by_rule(WhitenedOffset(FINE), FINE, draws=100) == pytest.approx(1.0, rel=0.15)
    assert by_rule(WhitenedOffset(CORRELATED), CORRELATED) == pytest.approx(1.0, rel=0.35)
    local = by_rule(TO_SIMULATED, FINE, draws=80)
    assert by_rule(TO_SIMULATED, PointErrors(0.002, shift=0.01)) > 10 * local
    assert by_rule(TO_SIMULATED, FINE, number=120, draws=80) == pytest.approx(local, rel=0.3)


def test_a_square_of_the_sd_is_wrong_for_a_mean() -> None:
    """What a user would type: six times too wide."""
    assert by_rule(MEAN, FINE) < 0.05 * 0.002**2


def test_smooth_shapes_stand_for_the_inputs() -> None:
    """Before any run, the variance is nearly that which the model's own inputs ask for."""
    errors = PointErrors(0.002, 0.02)
    for measure in (ClosestPoint(), Currents(0.1, quadrature="centre"), MEAN):
        found = noise_variance(measure, arch(), errors, NUMBER, draws=DRAWS)
        assert found == pytest.approx(by_rule(measure, errors), rel=0.4), measure


def test_which_variance_is_taken() -> None:
    """A closed form that the rule confirms; global errors do not widen it; forms that do not hold are left out."""
    assert noise_variance(TO_SIMULATED, arch(), FINE, NUMBER) == TO_SIMULATED.noise_variance(FINE, arch())
    both = PointErrors(0.002, shift=0.05, offset=0.01)
    assert noise_variance(ClosestPoint(), arch(), both, NUMBER) == noise_variance(ClosestPoint(), arch(), FINE, NUMBER)
    for measure in (ClosestPoint(), Currents(0.005), MeasurementLines(10)):
        assert measure.noise_variance(PointErrors(0.01), arch()) is None
    with pytest.raises(InvalidInput, match="normal_offset"):
        noise_variance(lambda simulated, observed: 1.0, arch(), FINE, NUMBER)


def test_tracked_points_err_along_the_interface_as_much_as_across_it() -> None:
    spacing = float(arch().lengths.mean())
    for errors, expected in ((FINE, 0.002**2), (CORRELATED, 0.002**2 * 0.12 / spacing)):
        assert noise_variance(TrackedPoints(), arch(), errors, NUMBER) == pytest.approx(expected, rel=0.1)


def test_closed_forms_agree_with_the_rule_on_a_surface() -> None:
    """The rule sees only a function; a square of the sd alone would be off by far more."""
    surface, centre = sphere(1.0, 2), Currents(0.6, quadrature="centre")
    for measure, length in ((TO_SIMULATED, 0.15), (centre, 0.0)):
        errors = PointErrors(0.01, length)
        by_draws = noise_variance(lambda a, b: measure(a, b), surface, errors, len(surface.points), draws=20)  # noqa: B023
        assert measure.noise_variance(errors, surface) == pytest.approx(by_draws, rel=0.4), measure


def test_smooth_shapes_move_a_surface_along_its_normals_whatever_its_size() -> None:
    """Spheres along their radii; a sheet z = 0.1 sin(5u) cos(4v), whose normals at the rim are one-sided."""
    for radius in (0.05, 20.0):
        ball = sphere(radius, 3)
        np.testing.assert_allclose((_shapes(ball)[0] * ball.points).sum(axis=1), radius, rtol=0.01)
    wavy = sheet(40, bend=0.1)
    u, v, _ = wavy.points.T
    exact = np.stack([-0.5 * np.cos(5 * u) * np.cos(4 * v), 0.4 * np.sin(5 * u) * np.sin(4 * v), np.ones(len(u))], 1)
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    shapes = _shapes(wavy)
    assert (shapes[0] * exact).sum(axis=1).min() > 0.99
    assert exact[:, 2].min() < 0.95
    assert len(shapes) == 4
    sizes = np.linalg.norm(shapes, axis=2).max(axis=1)
    assert (sizes > 0.1).all()
    assert (sizes < 1.001).all()
