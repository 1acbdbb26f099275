"""The expected information gain against closed forms, and against quadrature of a bent signal."""

import numpy as np
import pytest
from scipy.stats import norm, qmc

from strandline.planning.information import Gain, expected_gain, linear_gain, linear_sd
from strandline.posterior.weighted import Weighted


def drawn(number: int, dim: int, seed: int = 0) -> Weighted:
    x = norm.ppf(qmc.Sobol(dim, seed=np.random.default_rng(seed)).random(number))
    return Weighted(x, np.full(number, 1 / number))


def test_one_linear_signal_of_a_normal_input() -> None:
    """Weights count as copies would: at last, draws of a wide distribution with the weights of a normal one."""
    now = drawn(1024, 1)
    for slope in (0.1, 1.0, 5.0):
        found = expected_gain(now, slope * now.draws, np.random.default_rng(1))
        assert found.nats == pytest.approx(0.5 * np.log(1 + slope**2), abs=max(4 * found.error, 0.005))
        assert found.error < 0.03
        assert found.sd[0] == pytest.approx(1 / np.sqrt(1 + slope**2), rel=0.03)
    x = np.linspace(-6, 6, 1501)[:, None]
    weights = norm.pdf(x[:, 0])
    found = expected_gain(Weighted(x, weights / weights.sum()), 2 * x, np.random.default_rng(3))
    assert found.nats == pytest.approx(0.5 * np.log(5), abs=max(4 * found.error, 0.01))


def test_a_linear_experiment_with_correlated_inputs_has_the_closed_form() -> None:
    now = drawn(2048, 2)
    root = np.array([[1.0, 0.0], [0.8, 0.6]])
    now = Weighted(now.draws @ root.T, now.weights)
    slopes = np.array([[2.0, 0.0, 1.0], [0.0, 1.0, -1.0]])
    information = slopes @ slopes.T
    found = expected_gain(now, now.draws @ slopes, np.random.default_rng(2))
    assert found.nats == pytest.approx(linear_gain(root @ root.T, [information]), abs=0.03)
    np.testing.assert_allclose(found.sd, linear_sd(root @ root.T, [information]), rtol=0.03)


def test_a_bent_signal_against_quadrature() -> None:
    """The signal is z = x² of a standard normal x: two inputs fit each observation."""
    now = drawn(2048, 1)
    found = expected_gain(now, now.draws**2, np.random.default_rng(4))
    s, x = np.linspace(-6, 40, 2301), np.linspace(-8, 8, 801)
    density = np.trapezoid(norm.pdf(x) * norm.pdf(s[:, None] - x * x), x, axis=1)
    entropy = np.trapezoid(-density * np.log(np.maximum(density, 1e-300)), s)
    assert found.nats == pytest.approx(entropy - 0.5 * np.log(2 * np.pi * np.e), abs=max(4 * found.error, 0.01))


def test_the_bias_of_few_draws_is_removed() -> None:
    """Without the correction, 64 draws overestimate a gain of 1.6 nats by 0.1."""
    gains = []
    for seed in range(200):
        random = np.random.default_rng(seed)
        now = Weighted(random.standard_normal((64, 1)), np.full(64, 1 / 64))
        gains.append(expected_gain(now, 5 * now.draws, random).nats)
    assert np.mean(gains) == pytest.approx(0.5 * np.log(26), abs=0.085)


def test_signals_that_show_nothing_too_much_or_something_odd() -> None:
    """A draw that resembles no other leaves the gain about some inputs finite."""
    now = drawn(1024, 2)

    def gain(signals: np.ndarray, **options: list[int]) -> Gain:
        return expected_gain(now, signals, np.random.default_rng(6), **options)

    nothing = gain(np.zeros((1024, 3)))
    assert nothing.nats == pytest.approx(0.0, abs=1e-5)
    np.testing.assert_allclose(nothing.sd, now.sd, rtol=1e-2)
    assert not gain(1e3 * now.draws).reliable
    usual = gain(now.draws, interest=[0])
    assert usual.reliable
    signals = now.draws.copy()
    signals[10] += 1e3
    odd = gain(signals, interest=[0])
    assert odd.reliable
    assert odd.of_interest == pytest.approx(usual.of_interest, abs=0.02)
