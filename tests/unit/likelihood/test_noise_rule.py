"""The noise of a measure by rule, in closed form and by coverage; that of residuals leads back to the one drawn."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from tests.unit.discrepancy.curves import arch, graph, ring
from tests.unit.discrepancy.surfaces import sheet, sphere

from strandline.discrepancy import ClosestPoint, Currents, MeasurementLines, NormalOffset, TrackedPoints
from strandline.foundations import InvalidInput
from strandline.interface import Interface, Observation, PointErrors
from strandline.interface.point_errors import correlated
from strandline.likelihood.noise_rule import (
    _shapes,
    fitting_variance,
    noise_of_residuals,
    noise_on_surface,
    noise_variance,
    stated_errors,
)

NUMBER, DRAWS = 41, 40
NODES = np.linspace(0.0, 1.0, NUMBER)
AT, STEPS = np.array([0.3, 0.05]), np.array([2e-3, 2e-3])
TO_SIMULATED = ClosestPoint(direction="to_simulated")
MEAN = ClosestPoint(direction="to_simulated", weighting="length")
FINE, CORRELATED = PointErrors(0.002), PointErrors(0.002, 0.06)


def leaning_arches(x: np.ndarray) -> np.ndarray:
    """Return arches of some height that lean to one side."""
    y = 4 * x[:, :1] * NODES * (1 - NODES)
    return np.stack([NODES + x[:, 1:] * np.sin(np.pi * NODES), y], axis=2)


LEANING = Interface.polyline(leaning_arches(AT[None])[0])


def by_rule(measure, errors: PointErrors) -> float:
    return fitting_variance(measure, leaning_arches, LEANING, AT, STEPS, LEANING, errors, draws=DRAWS)


def test_closed_forms_agree_with_the_general_rule():
    for measure, errors in (
        (TO_SIMULATED, CORRELATED),
        (MEAN, CORRELATED),
        (Currents(0.1), PointErrors(0.002, 0.03)),
        (MeasurementLines(20), PointErrors(0.001)),
        (MeasurementLines(10, smooth=0.1), PointErrors(0.001, 0.03)),
    ):
        assert by_rule(measure, errors) == pytest.approx(measure.noise_variance(errors, LEANING), rel=0.35), measure


def test_smooth_shapes_stand_for_the_inputs():
    """Before any run, the variance is nearly that which the model's own inputs ask for."""
    errors = PointErrors(0.002, 0.02)
    for measure in (ClosestPoint(), Currents(0.1, quadrature="centre"), MEAN):
        found = noise_variance(measure, LEANING, errors, NUMBER, draws=DRAWS)
        assert found == pytest.approx(by_rule(measure, errors), rel=0.4), measure


def test_which_variance_is_taken():
    """A closed form, where there is one; global errors do not widen it."""
    assert noise_variance(TO_SIMULATED, LEANING, FINE, NUMBER) == TO_SIMULATED.noise_variance(FINE, LEANING)
    both = PointErrors(0.002, shift=0.05, offset=0.01)
    found, local = (noise_variance(ClosestPoint(), LEANING, errors, NUMBER) for errors in (both, FINE))
    assert found == local
    along = 0.002**2 * 0.12 / LEANING.lengths.mean()
    for errors, expected in ((FINE, 0.002**2), (CORRELATED, along)):  # tracked points err along the interface, too
        assert noise_variance(TrackedPoints(), LEANING, errors, NUMBER) == pytest.approx(expected, rel=0.1)
    with pytest.raises(InvalidInput, match="normal_offset"):
        noise_variance(lambda simulated, observed: 1.0, LEANING, FINE, NUMBER)


def test_noise_as_large_as_the_interface_is_refused_before_anything_is_drawn():
    seen = arch(0.3)
    with pytest.raises(InvalidInput, match="got an sd of 3000 µm; expected at most a tenth"):
        noise_variance(Currents(0.05), seen, PointErrors(3.0), 40)


def test_closed_forms_agree_with_the_rule_on_a_surface():
    """The rule sees only a function; a square of the sd alone would be off by far more."""
    surface, centre = sphere(1.0, 2), Currents(0.6, quadrature="centre")
    for measure, errors in ((TO_SIMULATED, PointErrors(0.01, 0.15)), (centre, PointErrors(0.01))):
        by_draws = noise_variance(lambda a, b: measure(a, b), surface, errors, len(surface.points), draws=20)  # noqa: B023
        assert measure.noise_variance(errors, surface) == pytest.approx(by_draws, rel=0.4), measure


def test_smooth_shapes_move_a_surface_along_its_normals_whatever_its_size():
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
    sizes = np.linalg.norm(shapes, axis=2).max(axis=1)
    assert len(sizes) == 4
    assert ((sizes > 0.1) & (sizes < 1.001)).all()


def test_sd_and_length_of_residuals_are_those_drawn():
    """In the mean over 20 draws."""
    even, uneven = (graph(6.0 * np.linspace(0.0, 1.0, 1200) ** power, 0.0) for power in (1.0, 1.3))
    for interface, length in ((even, 0.03), (uneven, 0.1), (ring(1200), 0.1)):
        drawn = 0.003 * correlated(interface, length, 20, np.random.default_rng(5))
        each = [noise_of_residuals(row, interface) for row in drawn]
        assert np.mean([one.sd for one in each]) == pytest.approx(0.003, rel=0.1)
        assert np.mean([one.length for one in each]) == pytest.approx(length, rel=0.35)


def test_a_constant_is_as_long_as_the_interface_and_no_residuals_have_no_noise():
    """A constant counts as an error of its own, not as a mean to be removed."""
    seen = arch(nodes=41)
    noise = noise_of_residuals(np.full(41, 0.01), seen)
    assert noise.sd == pytest.approx(0.01)
    assert noise.length > 0.3 * seen.lengths.sum()
    assert noise.level == pytest.approx(noise.sd**2 * noise.length)
    none, flat = noise_of_residuals(np.zeros(41), seen), noise_on_surface(np.zeros(400), sheet(20))
    assert (none.sd, none.length) == (0.0, pytest.approx(0.5 * seen.lengths.sum() / 40, rel=1e-3))
    assert (flat.sd, flat.length) == (0.0, pytest.approx(0.5 / 20))


def test_residuals_on_a_surface_have_the_sd_and_length_drawn():
    """In the mean over draws; the sum ends at the first zero, so the length reads a little low.

    Of 2500 points every second one is taken: independent residuals have half their spacing.
    """
    surface, random = sheet(20), np.random.default_rng(3)
    covariance = np.exp(-cdist(surface.points, surface.points) / 0.2)
    drawn = 0.01 * np.linalg.cholesky(covariance + 1e-9 * np.eye(400)) @ random.standard_normal((400, 30))
    each = [noise_on_surface(row, surface) for row in drawn.T]
    assert np.mean([one.sd for one in each]) == pytest.approx(0.01, rel=0.1)
    assert np.mean([one.length for one in each]) == pytest.approx(0.2, rel=0.3)
    found = noise_on_surface(0.01 * random.standard_normal(2500), sheet(50))
    assert found.sd == pytest.approx(0.01, rel=0.1)
    assert 0.4 < found.length * np.sqrt(1250) < 0.8


def test_the_noise_of_the_points_has_the_stated_variance():
    """Four times the variance means twice the sd; stated errors are taken as they are."""
    seen, sd = arch(nodes=41), 0.002
    for measure in (TrackedPoints(), NormalOffset(), MeasurementLines(12), ClosestPoint()):
        variance = sd**2 if measure == NormalOffset() else noise_variance(measure, seen, PointErrors(sd), 41)
        stated = stated_errors(Observation(seen, variance), measure, 41)
        assert (stated.assumed, stated.errors.length) == (True, 0.0)
        assert stated.errors.sd == pytest.approx(sd, rel=0.25)
        assert stated.noise_along(seen).length == pytest.approx(0.5 * seen.lengths.mean(), rel=0.1)
    one, two = (stated_errors(Observation(seen, v), ClosestPoint(), 41).errors.sd for v in (1e-5, 4e-5))
    assert two == pytest.approx(2 * one)
    errors = PointErrors(0.002, 0.05, shift=0.01)
    stated = stated_errors(Observation(seen, errors), Currents(0.1), 41)
    assert (stated.errors, stated.assumed) == (errors, False)
