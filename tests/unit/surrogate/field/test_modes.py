"""Proper orthogonal decomposition: an orthonormal basis, as small as the tolerance allows, that spans derivatives."""

import numpy as np
import pytest

from strandline.surrogate.field.modes import decompose

S = np.linspace(0.0, 1.0, 40)
WEIGHTS = np.random.default_rng(0).uniform(0.5, 1.5, 40)
WEIGHTS /= WEIGHTS.sum()
SHAPES = np.array([S, np.sin(3 * S), np.cos(5 * S), S**3])
SIZES = np.array([1.0, 0.1, 0.01, 0.001])


def fields(runs: int = 30, seed: int = 1) -> np.ndarray:
    return 2.0 + (np.random.default_rng(seed).normal(size=(runs, 4)) * SIZES) @ SHAPES


def rms(values: np.ndarray) -> float:
    """Return the root of the mean over runs of the mean square along the interface."""
    return float(np.sqrt(np.mean(values**2 @ WEIGHTS)))


def test_the_fewest_modes_within_the_tolerance() -> None:
    F = fields()
    for tolerance, number in [(1e-7, 4), (2e-4, 3), (5e-3, 2), (0.3, 1), (10.0, 1)]:
        found = decompose(F, WEIGHTS, None, tolerance=tolerance)
        np.testing.assert_allclose(found.basis @ found.basis.T, np.eye(number), atol=1e-12)
        left = rms(F - found.fields(found.coefficients(F)))
        assert found.remainder == pytest.approx(left, rel=1e-6, abs=1e-12)
        assert left <= tolerance
        fewer = found.coefficients(F)
        fewer[:, -1] = 0.0
        assert number == 1 or rms(F - found.fields(fewer)) > tolerance


def test_coefficients_are_lengths() -> None:
    """The squared norm of a field is its mean square along the interface, so that coefficients are in mm."""
    F = fields()
    found = decompose(F, WEIGHTS, None, tolerance=1e-9)
    norms = np.sum(found.coefficients(F) ** 2, axis=1)
    np.testing.assert_allclose(norms, ((F - F.mean(axis=0)) ** 2) @ WEIGHTS, rtol=1e-8)


def test_derivatives_are_spanned_and_carried_over() -> None:
    """Runs at one value of an input know its derivative only."""
    x = np.random.default_rng(2).normal(size=12)
    F = np.outer(x, SHAPES[0])
    derivatives = np.stack([np.tile(SHAPES[0], (12, 1)), np.tile(SHAPES[1], (12, 1))], axis=2)
    found = decompose(F, WEIGHTS, derivatives, tolerance=1e-6)
    by_input = found.by_input(derivatives)
    np.testing.assert_allclose(
        by_input[:, :, 0], found.coefficients(F + SHAPES[0]) - found.coefficients(F), rtol=1e-6, atol=1e-9
    )
    kept = np.sum(by_input[0, :, 0] ** 2)
    assert kept == pytest.approx(SHAPES[0] ** 2 @ WEIGHTS, rel=1e-2)


def test_there_are_no_more_modes_than_processes() -> None:
    F = fields()
    found = decompose(F, WEIGHTS, None, tolerance=1e-9, most=2)
    assert len(found.basis) == 2
    assert found.remainder == pytest.approx(rms(F - found.fields(found.coefficients(F))), rel=1e-9)
    np.testing.assert_allclose(found.tail @ found.basis.T, 0.0, atol=1e-12)
