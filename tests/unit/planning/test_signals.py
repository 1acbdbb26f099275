"""Signals carry the information of displacements with correlated errors."""

import numpy as np

from strandline.planning.signals import signals_of


def test_distances_of_signals_are_those_of_the_errors_covariance() -> None:
    random = np.random.default_rng(0)
    directions = random.standard_normal((3, 40))
    displacements = random.standard_normal((200, 3)) @ directions
    root = random.standard_normal((40, 40)) + 8 * np.eye(40)
    covariance = root @ root.T
    signals = signals_of(displacements, lambda v: v.T @ np.linalg.solve(covariance, v))
    assert signals.shape == (200, 3)
    # In the span of the displacements, differences weigh as the projected covariance says.
    q = np.linalg.qr(directions.T)[0]
    information = q.T @ np.linalg.solve(covariance, q)
    between = (displacements[:100] - displacements[100:]) @ q
    expected = np.einsum("di,ij,dj->d", between, information, between)
    np.testing.assert_allclose(((signals[:100] - signals[100:]) ** 2).sum(axis=1), expected, rtol=1e-8)


def test_displacements_far_below_the_errors_are_left_out() -> None:
    random = np.random.default_rng(1)
    both = np.stack([random.standard_normal(500), 1e-5 * random.standard_normal(500)], axis=1)
    assert signals_of(both, lambda v: v.T @ v).shape == (500, 1)
    assert not signals_of(np.ones((50, 7)), lambda v: v.T @ v).any(), "equal interfaces are a signal of nothing"
