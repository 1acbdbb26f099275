"""The expected information gain against closed forms, and against quadrature of a bent signal."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm, qmc

from strandline.planning.information import expected_gain, linear_gain, linear_sd
from strandline.posterior.weighted import Weighted


def drawn(number: int, dim: int, seed: int = 0) -> Weighted:
    x = norm.ppf(qmc.Sobol(dim, seed=np.random.default_rng(seed)).random(number))
    return Weighted(x, np.full(number, 1 / number))


@pytest.mark.parametrize(
    ("slope", "gain"), [(0.1, 0.5 * np.log(1.01)), (1.0, 0.5 * np.log(2)), (5.0, 0.5 * np.log(26))]
)
def test_one_linear_signal_of_a_normal_input(slope: float, gain: float) -> None:
    now = drawn(2048, 1)
    found = expected_gain(now, slope * now.draws, np.random.default_rng(1))
    assert found.nats == pytest.approx(gain, abs=max(4 * found.error, 0.005))
    assert found.error < 0.02
    assert found.sd[0] == pytest.approx(1 / np.sqrt(1 + slope**2), rel=0.02)


def test_a_linear_experiment_with_correlated_inputs_has_the_closed_form() -> None:
    now = drawn(4096, 2)
    root = np.array([[1.0, 0.0], [0.8, 0.6]])
    now = Weighted(now.draws @ root.T, now.weights)
    slopes = np.array([[2.0, 0.0, 1.0], [0.0, 1.0, -1.0]])
    information = slopes @ slopes.T
    found = expected_gain(now, now.draws @ slopes, np.random.default_rng(2))
    assert found.nats == pytest.approx(linear_gain(root @ root.T, [information]), abs=0.02)
    np.testing.assert_allclose(found.sd, linear_sd(root @ root.T, [information]), rtol=0.02)


def test_weights_count_as_copies_would() -> None:
    """Draws of a wide distribution with the weights of a normal one."""
    x = np.linspace(-6, 6, 3001)[:, None]
    weights = norm.pdf(x[:, 0])
    now = Weighted(x, weights / weights.sum())
    found = expected_gain(now, 2 * x, np.random.default_rng(3))
    assert found.nats == pytest.approx(0.5 * np.log(5), abs=max(4 * found.error, 0.01))


def test_a_bent_signal_against_quadrature() -> None:
    """The signal is z = x² of a standard normal x: two inputs fit each observation."""
    now = drawn(4096, 1)
    found = expected_gain(now, now.draws**2, np.random.default_rng(4))

    def density(s: float) -> float:
        return float(quad(lambda x: norm.pdf(x) * norm.pdf(s - x * x), -8, 8, limit=200)[0])

    entropy = quad(lambda s: -density(s) * np.log(max(density(s), 1e-300)), -6, 40, limit=400)[0]
    assert found.nats == pytest.approx(entropy - 0.5 * np.log(2 * np.pi * np.e), abs=max(4 * found.error, 0.01))


def test_an_experiment_that_shows_nothing_teaches_nothing() -> None:
    now = drawn(1024, 2)
    found = expected_gain(now, np.zeros((1024, 3)), np.random.default_rng(5))
    assert found.nats == pytest.approx(0.0, abs=1e-5)
    np.testing.assert_allclose(found.sd, now.sd, rtol=1e-2)


def test_the_bias_of_few_draws_is_removed() -> None:
    """Without the correction, 64 draws overestimate a gain of 1.6 nats by 0.1."""
    gains = []
    for seed in range(200):
        random = np.random.default_rng(seed)
        now = Weighted(random.standard_normal((64, 1)), np.full(64, 1 / 64))
        gains.append(expected_gain(now, 5 * now.draws, random).nats)
    assert np.mean(gains) == pytest.approx(0.5 * np.log(26), abs=0.085)


def test_too_sharp_a_signal_for_the_draws_is_noticed() -> None:
    now = drawn(512, 2)
    assert not expected_gain(now, 1e3 * now.draws, np.random.default_rng(6)).reliable
    assert expected_gain(now, now.draws, np.random.default_rng(6)).reliable


def test_a_draw_that_resembles_no_other_leaves_the_gain_about_some_inputs_finite() -> None:
    now = drawn(1024, 2)
    signals = now.draws.copy()
    expected = expected_gain(now, signals, np.random.default_rng(7), interest=[0]).of_interest
    signals[10] += 1e3
    found = expected_gain(now, signals, np.random.default_rng(7), interest=[0])
    assert found.reliable
    assert found.of_interest == pytest.approx(expected, abs=0.02)
