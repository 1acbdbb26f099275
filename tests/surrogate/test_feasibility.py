"""The classifier of failed runs: known borders, failures at random, and evidence by numerical integration."""

import math

import numpy as np
import pytest
from scipy.integrate import dblquad, quad
from scipy.special import expit
from scipy.stats import multivariate_normal, norm

from strandline.design import sobol
from strandline.surrogate.feasibility import SPREADS, _laplace, learn_feasibility

Z = np.sqrt(12.0) * (sobol(80, 2, scramble=1) - 0.5)
GRID = np.sqrt(12.0) * (sobol(256, 2, scramble=2) - 0.5)


def test_without_a_failure_every_run_succeeds() -> None:
    np.testing.assert_array_equal(learn_feasibility(Z, np.ones(80, bool)).log_probability(GRID), 0.0)


@pytest.mark.parametrize("turn", [0.0, 0.6, 2.0])
def test_a_half_plane_of_failures_is_found(turn: float) -> None:
    direction = np.array([math.cos(turn), math.sin(turn)])
    found = learn_feasibility(Z, Z @ direction < 0.4)
    distance, probability = GRID @ direction - 0.4, np.exp(found.log_probability(GRID))
    assert (probability[distance < -0.6] > 0.8).all()
    assert (probability[distance > 0.6] < 0.2).all()


def spread(seed: int, ok: np.ndarray | None = None) -> float:
    """Return how far the probability of success varies over the box, after failures of 30 % of the runs at random."""
    ok = np.random.default_rng(seed).random(80) >= 0.3 if ok is None else ok
    probability = np.exp(learn_feasibility(Z, ok).log_probability(GRID))
    assert abs(probability.mean() - ok.mean()) < 0.1
    return float(np.ptp(probability))


def test_failures_at_random_move_no_border() -> None:
    spreads = [spread(seed) for seed in range(10)]
    assert np.median(spreads) < 0.15
    assert max(spreads) < 0.5


def test_failures_that_are_not_at_random_do() -> None:
    """The planted bug: the 30 % with the largest first input."""
    assert spread(0, Z[:, 0] < np.quantile(Z[:, 0], 0.7)) > 0.8


@pytest.mark.parametrize("deviation", [0.3, 2.0])
@pytest.mark.parametrize("ok", [True, False])
def test_the_evidence_of_one_run_is_its_integral(deviation: float, ok: bool) -> None:
    offset = 0.7
    evidence, _ = _laplace(np.zeros((1, 2)), np.array([ok]), 1.0, deviation, offset)
    sign = 1 if ok else -1
    exact, _ = quad(
        lambda f: expit(sign * (offset + f)) * norm.pdf(f, scale=deviation), -12 * deviation, 12 * deviation
    )
    assert evidence == pytest.approx(math.log(exact), abs=0.1)


@pytest.mark.parametrize("distance", [0.2, 3.0])
def test_the_evidence_of_two_runs_is_their_integral(distance: float) -> None:
    """One failed, one did not: near each other that is unlikely, far from each other it is not."""
    deviation, offset = 2.0, 0.0
    z = np.array([[0.0], [distance]])
    evidence, _ = _laplace(z, np.array([True, False]), 1.0, deviation, offset)
    k = deviation**2 * math.exp(-0.5 * distance**2)
    density = multivariate_normal(cov=np.array([[deviation**2, k], [k, deviation**2]]))
    exact, _ = dblquad(
        lambda g, f: expit(f) * expit(-g) * density.pdf([f, g]), -14, 14, -14, 14, epsabs=1e-5, epsrel=1e-4
    )
    assert evidence == pytest.approx(math.log(exact), abs=0.1)
    both, _ = _laplace(z, np.array([True, True]), 1.0, deviation, offset)
    assert (both > evidence + 0.5) == (distance < 1.0)


def test_the_probability_of_one_run_is_its_integral() -> None:
    """Far from all runs: the base rate under a latent function of known spread."""
    found = _laplace(np.zeros((1, 1)), np.array([False]), 1.0, 2.0, 0.7)[1]
    exact, _ = quad(lambda f: expit(0.7 + f) * norm.pdf(f, scale=2.0), -24, 24)
    far = float(np.exp(found.log_probability(np.array([[50.0]])))[0])
    assert far == pytest.approx(exact, abs=0.02)
    assert float(np.exp(found.log_probability(np.array([[0.0]])))[0]) < exact - 0.1


def test_the_last_runs_count_where_there_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strandline.surrogate.feasibility._LARGEST", 40)
    ok = np.concatenate([np.zeros(40, bool), np.ones(40, bool)])
    np.testing.assert_array_equal(learn_feasibility(Z, ok).log_probability(GRID), 0.0)


def test_the_smallest_spread_is_taken_where_failures_are_at_random() -> None:
    ok = np.random.default_rng(3).random(80) >= 0.3
    assert learn_feasibility(Z, ok).spread == SPREADS[0]
    assert learn_feasibility(Z, Z[:, 0] < 0.4).spread == SPREADS[-1]
