"""Forward–backward against a Gaussian random walk, whose posterior is known, and against its own draws."""

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.imaging.markov_path import MarkovPath
from strandline.imaging.random_walk import walk

CANDIDATES = np.arange(-8.0, 8.01, 0.25)


def test_the_posterior_is_that_of_a_gaussian_walk() -> None:
    seen, sd, drift = np.sin(np.arange(60) / 8.0) + 0.5, 1.5, 0.5
    found = walk(-0.5 * ((seen[:, None] - CANDIDATES) / sd) ** 2, CANDIDATES, drift, draws=2000,
                 random=np.random.default_rng(1))  # fmt: skip
    steps = np.diff(np.eye(60), axis=0)
    precision = np.eye(60) / sd**2 + steps.T @ steps / drift**2
    covariance = np.linalg.inv(precision)
    np.testing.assert_allclose(found.mean, covariance @ seen / sd**2, atol=2e-3)
    np.testing.assert_allclose(found.sd, np.sqrt(np.diag(covariance)), rtol=5e-3)
    np.testing.assert_allclose(found.draws.mean(axis=0), found.mean, atol=0.1)
    np.testing.assert_allclose(np.cov(found.draws.T)[30, 25:36], covariance[30, 25:36], rtol=0.12)


def test_normals_that_show_nothing_are_bridged() -> None:
    table = -0.5 * ((CANDIDATES - 2.0) / 0.3) ** 2 * np.ones((40, 1))
    table[10:30] = 0.0
    found = walk(table, CANDIDATES, 0.3)
    np.testing.assert_allclose(found.mean, 2.0, atol=0.02)
    assert found.sd[20] > 2 * found.sd[5]


def test_a_path_that_could_not_move_is_refused() -> None:
    with pytest.raises(InvalidInput, match="drift of the path"):
        MarkovPath(drift=0.2)
