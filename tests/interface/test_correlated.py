"""Drawn errors have the correlations that they should have."""

import numpy as np
import pytest
from tests.discrepancy.surfaces import sheet

from strandline.interface import Interface, PointErrors
from strandline.interface.correlated import correlated, summed_length

DRAWS = 4000
TOLERANCE = 0.1
"""More than four standard errors of a correlation from so many draws."""


def circle(number: int) -> Interface:
    angle = 2 * np.pi * np.arange(number) / number
    return Interface.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)


def line(number: int) -> Interface:
    x = np.linspace(0.0, 1.0, number) ** 1.5
    return Interface.polyline(np.stack([x, 0 * x], axis=1))


def correlations(interface: Interface, length: float) -> np.ndarray:
    drawn = correlated(interface, length, DRAWS, np.random.default_rng(3))
    assert drawn.shape == (DRAWS, len(interface.points))
    return np.asarray(drawn.T @ drawn / DRAWS)


def test_errors_along_a_line_of_uneven_points() -> None:
    outline = line(30)
    apart = np.abs(outline.points[:, None, 0] - outline.points[:, 0])
    np.testing.assert_allclose(correlations(outline, 0.2), np.exp(-apart / 0.2), atol=TOLERANCE)


def test_another_length_shows() -> None:
    """Planted: twice the correlation length."""
    outline = line(30)
    apart = np.abs(outline.points[:, None, 0] - outline.points[:, 0])
    assert np.abs(correlations(outline, 0.4) - np.exp(-apart / 0.2)).max() > 2 * TOLERANCE


def test_the_ends_of_a_closed_line_are_far_apart() -> None:
    found = correlations(circle(40), 0.5)
    assert abs(found[0, -1]) < TOLERANCE
    assert found[0, 1] == pytest.approx(np.exp(-2 * np.sin(np.pi / 40) / 0.5), abs=TOLERANCE)


def test_errors_over_a_surface() -> None:
    """The waves are random, too, but the same in all draws."""
    surface = sheet(6, bend=0.1)
    apart = np.linalg.norm(surface.points[:, None] - surface.points, axis=2)
    np.testing.assert_allclose(correlations(surface, 0.3), np.exp(-apart / 0.3), atol=2 * TOLERANCE)


@pytest.mark.parametrize("interface", [line(20), sheet(5)], ids=["line", "surface"])
def test_no_length_means_independent_points(interface: Interface) -> None:
    np.testing.assert_allclose(correlations(interface, 0.0), np.eye(len(interface.points)), atol=TOLERANCE)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0, 3.0, 8.0])
def test_the_variance_of_a_slow_mean_is_that_of_the_drawn_errors(share: float) -> None:
    """Of n points h apart, from their whole covariance; planted: s² max(1, 2ℓ/h), right in both limits only."""
    number, sd = 400, 0.002
    outline = Interface.polyline(np.stack([np.linspace(0.0, 4.0, number), np.zeros(number)], axis=1))
    spacing = 4.0 / (number - 1)
    length = share * spacing
    apart = np.abs(np.subtract.outer(np.arange(number), np.arange(number))) * spacing
    covariance = sd**2 * (np.exp(-apart / length) if length else np.eye(number))
    slow = np.sin(np.pi * (np.arange(number) + 0.5) / number)
    exact = slow @ covariance @ slow / (slow @ slow)
    found = PointErrors(sd, length).local_variances(outline)
    assert found.mean() == pytest.approx(exact, rel=0.03)
    assert 2 * summed_length(length, spacing) * sd**2 / spacing == pytest.approx(found.mean(), rel=0.01)
    if 0.2 < share < 2:
        assert sd**2 * max(1.0, 2 * share) != pytest.approx(exact, rel=0.03)
