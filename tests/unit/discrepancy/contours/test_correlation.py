"""Variance and level of a process whose autocovariance is known, also after something smooth was removed from it."""

import numpy as np
import pytest

from strandline.discrepancy.contours.correlation import autocovariance, restored
from strandline.discrepancy.contours.paths import smoothed, smoothing_weights

LAGS = np.arange(60)


def test_the_autocovariance_is_that_of_plain_loops() -> None:
    values = np.random.default_rng(1).normal(size=(3, 17))
    opened, closed = (autocovariance(values, closed=one) for one in (False, True))
    assert len(opened) == len(closed) == 5
    for k in range(5):
        pairs = [row[i] * row[i + k] for row in values for i in range(17 - k)]
        assert opened[k] == pytest.approx(np.mean(pairs))
        assert closed[k] == pytest.approx(np.mean([row[i] * row[(i + k) % 17] for row in values for i in range(17)]))


def test_lengths_in_closed_form() -> None:
    """Of exponentials and of independent values; what follows the first zero does not count."""
    for length in (2.0, 5.0):
        found = restored(4.0 * np.exp(-LAGS / length), np.zeros(60))
        assert found.variance == pytest.approx(4.0)
        assert found.length(1.0) == pytest.approx(0.5 / np.tanh(0.5 / length), rel=1e-4)
        assert found.length(0.1) == pytest.approx(0.1 * found.length(1.0))
    white = restored(np.where(LAGS == 0, 2.0, 0.0), np.zeros(60))
    assert white.length(3.0) == pytest.approx(1.5)
    assert not white.cut
    assert restored(np.ones(60), np.zeros(60)).cut
    covariance = np.where(LAGS < 4, 1.0, np.where(LAGS < 10, -0.2, 0.5))
    assert restored(covariance, np.zeros(60)).level == pytest.approx(7.0)


def test_what_was_removed_comes_back() -> None:
    """c(k) - S q(k) with a slow q: variance and level are those of c."""
    c, q = np.exp(-LAGS / 4.0), 0.02 * np.cos(LAGS / 60)
    level = 1 + 2 * c[1:].sum()
    found = restored(c - level * q, q)
    assert found.variance == pytest.approx(1.0, rel=0.03)
    assert found.level == pytest.approx(level, rel=0.15)
    as_it_is = restored(c - level * q, np.zeros(60))
    assert as_it_is.level < 0.8 * level  # planted: nothing put back


def test_the_weights_of_smoothing_keep_a_parabola() -> None:
    for half in (2, 7):
        k = np.arange(-half, half + 1)
        design = np.stack([k**0, k, k**2], axis=1)
        np.testing.assert_allclose(smoothing_weights(half), np.linalg.pinv(design)[0], atol=1e-12)


def test_smoothing_keeps_straight_lines_to_their_ends_parabolas_inside_and_circles() -> None:
    t, angle = np.linspace(0.0, 1.0, 40), 2 * np.pi * np.arange(90) / 90
    line, parabola = np.stack([t, 2 * t], axis=1), np.stack([t, t**2], axis=1)
    np.testing.assert_allclose(smoothed(line, 5, closed=False), line, atol=1e-12)
    np.testing.assert_allclose(smoothed(parabola, 5, closed=False)[5:-5], parabola[5:-5], atol=1e-12)
    radii = np.linalg.norm(smoothed(np.stack([np.cos(angle), np.sin(angle)], axis=1), 6, closed=True), axis=1)
    np.testing.assert_allclose(radii, radii[0], rtol=1e-12)
    assert radii[0] == pytest.approx(1.0, abs=2e-4)
