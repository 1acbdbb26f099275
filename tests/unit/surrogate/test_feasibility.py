"""The classifier of failed runs: known borders, failures at random, and evidence by numerical integration."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import expit
from scipy.stats import multivariate_normal, norm

from strandline.design import sobol
from strandline.surrogate.feasibility import SPREADS, _laplace, learn_feasibility

Z = np.sqrt(12.0) * (sobol(80, 2, scramble=1) - 0.5)
GRID = np.sqrt(12.0) * (sobol(256, 2, scramble=2) - 0.5)
HALF = np.arange(80) >= 40


def test_without_a_failure_among_the_last_runs_every_run_succeeds():
    for found in (learn_feasibility(Z, np.ones(80, bool)), learn_feasibility(Z, HALF, largest=40)):
        np.testing.assert_array_equal(found.log_probability(GRID), 0.0)
    assert (learn_feasibility(Z, HALF, largest=41).log_probability(GRID) < 0.0).all()


def test_a_half_plane_of_failures_is_found():
    for turn in (0.0, 0.6, 2.0):
        direction = np.array([math.cos(turn), math.sin(turn)])
        found = learn_feasibility(Z, Z @ direction < 0.4)
        distance, probability = GRID @ direction - 0.4, np.exp(found.log_probability(GRID))
        assert (probability[distance < -0.6] > 0.8).all()
        assert (probability[distance > 0.6] < 0.2).all()
        assert found.spread == SPREADS[-1]


def spread(ok):
    """Return how far the probability of success varies over the box."""
    probability = np.exp(learn_feasibility(Z, ok).log_probability(GRID))
    assert abs(probability.mean() - ok.mean()) < 0.1
    return float(np.ptp(probability))


def test_failures_at_random_move_no_border():
    """The planted bug: the 30 % with the largest first input."""
    outcomes = [np.random.default_rng(seed).random(80) >= 0.3 for seed in range(10)]
    spreads = [spread(ok) for ok in outcomes]
    assert np.median(spreads) < 0.15
    assert max(spreads) < 0.5
    assert learn_feasibility(Z, outcomes[3]).spread == SPREADS[0]
    assert spread(Z[:, 0] < np.quantile(Z[:, 0], 0.7)) > 0.8


@pytest.mark.parametrize("ok", [True, False])
def test_the_evidence_and_the_probability_of_one_run_are_integrals(ok):
    offset, sign = 0.7, 1 if ok else -1
    for deviation in (0.3, 2.0):
        evidence, found = _laplace(np.zeros((1, 2)), np.array([ok]), 1.0, deviation, offset)
        end = 12 * deviation
        exact, _ = quad(lambda f, sd=deviation: expit(sign * (offset + f)) * norm.pdf(f, scale=sd), -end, end)
        assert evidence == pytest.approx(math.log(exact), abs=0.1)
        far, near = np.exp(found.log_probability(np.array([[50.0, 0.0], [0.0, 0.0]])))
        assert far == pytest.approx(exact if ok else 1 - exact, abs=0.02)
        assert near > far if ok else near < far
        assert abs(near - far) > 0.1 or deviation < 1


def test_the_evidence_of_two_runs_is_their_integral():
    """One failed, one did not: near each other that is unlikely, far from each other it is not."""
    deviation, axis = 2.0, np.linspace(-14, 14, 281)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    for distance in (0.2, 3.0):
        z, k = np.array([[0.0], [distance]]), deviation**2 * math.exp(-0.5 * distance**2)
        evidence, both = (_laplace(z, np.array([True, other]), 1.0, deviation, 0.0)[0] for other in (False, True))
        density = multivariate_normal(cov=np.array([[deviation**2, k], [k, deviation**2]]))
        exact = np.sum(expit(grid[..., 0]) * expit(-grid[..., 1]) * density.pdf(grid)) * 0.1**2
        assert evidence == pytest.approx(math.log(exact), abs=0.1)
        assert (both > evidence + 0.5) == (distance < 1.0)
