"""Residuals have the noise with which they were drawn; that of the points follows from σ_N² and leads back to it."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from tests.unit.discrepancy.surfaces import sheet

from strandline.discrepancy import ClosestPoint, Currents, MeasurementLines, NormalOffset, TrackedPoints
from strandline.interface import Interface, Observation, PointErrors, arc_lengths
from strandline.interface.correlated import correlated
from strandline.likelihood.noise_rule import noise_variance
from strandline.likelihood.residual_noise import noise_of_residuals, noise_on_surface, stated_errors


def line(number: int = 1200, *, uneven: float = 1.0) -> Interface:
    x = 6.0 * np.linspace(0.0, 1.0, number) ** uneven
    return Interface.polyline(np.stack([x, 0 * x], axis=1))


def circle(number: int = 1200) -> Interface:
    angle = 2 * np.pi * np.arange(number) / number
    return Interface.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)


def arch(number: int = 41) -> Interface:
    t = np.linspace(0.0, 1.0, number)
    return Interface.polyline(np.stack([t, 1.2 * t * (1 - t)], axis=1))


def test_sd_and_length_are_those_drawn() -> None:
    """In the mean over 20 draws; independent residuals have half the spacing or little more."""
    for interface, length in ((line(), 0.03), (line(uneven=1.3), 0.1), (circle(), 0.1)):
        drawn = 0.003 * correlated(interface, length, 20, np.random.default_rng(5))
        each = [noise_of_residuals(row, interface) for row in drawn]
        assert np.mean([one.sd for one in each]) == pytest.approx(0.003, rel=0.1)
        assert np.mean([one.length for one in each]) == pytest.approx(length, rel=0.35)
    drawn, spacing = correlated(line(), 0.0, 20, np.random.default_rng(1)), 6.0 / 1199
    lengths = [noise_of_residuals(row, line()).length for row in drawn]
    assert min(lengths) >= 0.5 * spacing
    assert np.mean(lengths) < 0.8 * spacing


def test_a_constant_is_as_long_as_the_interface_and_no_residuals_have_no_noise() -> None:
    """A constant counts as an error of its own, not as a mean to be removed."""
    noise = noise_of_residuals(np.full(41, 0.01), arch())
    assert noise.sd == pytest.approx(0.01)
    assert noise.length > 0.3 * arch().lengths.sum()
    assert noise.level == pytest.approx(noise.sd**2 * noise.length)
    none = noise_of_residuals(np.zeros(41), arch())
    assert none.sd == 0.0
    assert none.length == pytest.approx(0.5 * arch().lengths.sum() / 40, rel=1e-3)
    flat = noise_on_surface(np.zeros(400), sheet(20))
    assert (flat.sd, flat.length) == (0.0, pytest.approx(0.5 / 20))


def test_residuals_on_a_surface_have_the_sd_and_length_drawn() -> None:
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


def test_arc_lengths_follow_the_segments() -> None:
    outline = circle(8)
    np.testing.assert_allclose(arc_lengths(outline), np.arange(8) * outline.lengths[0])
    np.testing.assert_allclose(arc_lengths(line(7)), np.linspace(0.0, 6.0, 7))


def test_the_noise_of_the_points_has_the_stated_variance() -> None:
    """Four times the variance means twice the sd."""
    seen, sd = arch(), 0.002
    for measure in (TrackedPoints(), NormalOffset(), MeasurementLines(12), ClosestPoint()):
        variance = sd**2 if measure == NormalOffset() else noise_variance(measure, seen, PointErrors(sd), 41)
        stated = stated_errors(Observation(seen, variance), measure, 41)
        assert stated.assumed
        assert stated.errors.length == 0.0
        assert stated.errors.sd == pytest.approx(sd, rel=0.25)
        assert stated.noise_along(seen).length == pytest.approx(0.5 * seen.lengths.mean(), rel=0.1)
    one, two = (stated_errors(Observation(seen, v), ClosestPoint(), 41).errors.sd for v in (1e-5, 4e-5))
    assert two == pytest.approx(2 * one)


def test_stated_errors_are_taken_as_they_are() -> None:
    errors = PointErrors(0.002, 0.05, shift=0.01)
    stated = stated_errors(Observation(arch(), errors), Currents(0.1), 41)
    assert (stated.errors, stated.assumed) == (errors, False)
    half = 0.5 * arch().lengths.mean()
    assert stated.noise_along(arch()).level == pytest.approx(0.002**2 * half / np.tanh(half / 0.05), rel=0.01)
