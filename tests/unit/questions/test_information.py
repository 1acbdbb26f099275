"""What an experiment is expected to tell of inputs and of models, and what it leaves, against closed forms and sums."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm, qmc

import strandline as sl
from strandline.posterior import Weighted
from strandline.questions import information as discrimination
from strandline.questions.information import (
    CLEAR,
    directions_left,
    expected_discrimination,
    expected_gain,
    in_words,
    linear_outlook,
    scale_of,
)
from strandline.questions.observing import signals_of


def drawn(number, dim):
    x = norm.ppf(qmc.Sobol(dim, seed=np.random.default_rng(0)).random(number))
    return Weighted(x, np.full(number, 1 / number))


def gain(now, signals, seed=1, **options):
    return expected_gain(now, signals, np.random.default_rng(seed), **options)


def test_one_linear_signal_of_a_normal_input():
    """Weights count as copies would: at last, draws of a wide distribution with the weights of a normal one."""
    now = drawn(1024, 1)
    for slope in (0.1, 5.0):
        found = gain(now, slope * now.draws)
        assert found.nats == pytest.approx(0.5 * np.log(1 + slope**2), abs=max(4 * found.error, 0.005))
        assert found.sd[0] == pytest.approx(1 / np.sqrt(1 + slope**2), rel=0.03)
    x = np.linspace(-6, 6, 1501)[:, None]
    found = gain(Weighted(x, norm.pdf(x[:, 0]) / norm.pdf(x).sum()), 2 * x, 3)
    assert found.nats == pytest.approx(0.5 * np.log(5), abs=max(4 * found.error, 0.01))


def test_a_linear_experiment_with_correlated_inputs_has_the_closed_form():
    now, root = drawn(2048, 2), np.array([[1.0, 0.0], [0.8, 0.6]])
    now, covariance = Weighted(now.draws @ root.T, now.weights), root @ root.T
    slopes = np.array([[2.0, 0.0, 1.0], [0.0, 1.0, -1.0]])
    found, information = gain(now, now.draws @ slopes, 2), [slopes @ slopes.T]
    linear = linear_outlook(covariance, information, interest=[0, 1])
    assert found.nats == pytest.approx(linear.gain, abs=0.03)
    np.testing.assert_allclose(found.sd, linear.sd, rtol=0.03)


def test_a_bent_signal_against_quadrature():
    """The signal is z = x² of a standard normal x: two inputs fit each observation."""
    now = drawn(2048, 1)
    found = gain(now, now.draws**2, 4)
    s, x = np.linspace(-6, 40, 2301), np.linspace(-8, 8, 801)
    density = np.trapezoid(norm.pdf(x) * norm.pdf(s[:, None] - x * x), x, axis=1)
    entropy = np.trapezoid(-density * np.log(np.maximum(density, 1e-300)), s)
    assert found.nats == pytest.approx(entropy - 0.5 * np.log(2 * np.pi * np.e), abs=max(4 * found.error, 0.01))


def test_the_bias_of_few_draws_is_removed():
    """Without the correction, 64 draws overestimate a gain of 1.6 nats by 0.1."""
    gains = []
    for seed in range(200):
        random = np.random.default_rng(seed)
        now = Weighted(random.standard_normal((64, 1)), np.full(64, 1 / 64))
        gains.append(expected_gain(now, 5 * now.draws, random).nats)
    assert np.mean(gains) == pytest.approx(0.5 * np.log(26), abs=0.085)


def test_signals_that_show_nothing_too_much_or_something_odd():
    """A draw that resembles no other leaves the gain about some inputs finite."""
    now = drawn(1024, 2)
    assert gain(now, np.zeros((1024, 3)), 6).nats == pytest.approx(0.0, abs=1e-5)
    assert not gain(now, 1e3 * now.draws, 6).reliable
    signals = now.draws.copy()
    signals[10] += 1e3
    usual, odd = (gain(now, some, 6, interest=[0]) for some in (now.draws, signals))
    assert odd.reliable
    assert odd.of_interest == pytest.approx(usual.of_interest, abs=0.02)


def test_distances_of_signals_are_those_of_the_errors_covariance():
    """In the span of the displacements, differences weigh as the projected covariance says."""
    random = np.random.default_rng(0)
    directions = random.standard_normal((3, 40))
    displacements = random.standard_normal((200, 3)) @ directions
    root = random.standard_normal((40, 40)) + 8 * np.eye(40)
    covariance = root @ root.T
    signals = signals_of(displacements, lambda v: v.T @ np.linalg.solve(covariance, v))
    q = np.linalg.qr(directions.T)[0]
    between = (displacements[:100] - displacements[100:]) @ q
    expected = np.einsum("di,ij,dj->d", between, q.T @ np.linalg.solve(covariance, q), between)
    np.testing.assert_allclose(((signals[:100] - signals[100:]) ** 2).sum(axis=1), expected, rtol=1e-8)
    assert not signals_of(np.ones((50, 7)), lambda v: v.T @ v).any(), "equal interfaces are a signal of nothing"


CASES = {
    "uneven": ([(0.0, 0.6), (2.0, 1.5)], [0.8, 0.2]),
    "three": ([(0.0, 1.0), (1.5, 0.7), (-2.0, 1.2)], [0.5, 0.3, 0.2]),
    "alike": ([(0.0, 1.0), (0.0, 1.0)], [0.5, 0.5]),
}
"""Mean and standard deviation of each of three signals under each model, and their probabilities."""


def discriminated(models, shares, number=300, seed=1):
    random = np.random.default_rng(seed)
    draws = [mean + sd * random.standard_normal((number, 3)) for mean, sd in models]
    return expected_discrimination(draws, shares, np.random.default_rng(100 + seed))


def exact(models, shares, number=50_000):
    """Return the information, and how often the right model and a wrong one lead, from the normal densities of s."""
    random, log_prior, total = np.random.default_rng(9), np.log(shares), np.zeros(3)
    normals = [multivariate_normal(np.full(3, m), (1 + sd**2) * np.eye(3)) for m, sd in models]
    for k, share in enumerate(shares):
        s = normals[k].rvs(number, random_state=random)
        odds = log_prior + np.stack([one.logpdf(s) for one in normals], axis=1)
        order = np.sort(odds, axis=1)
        leads, best = order[:, -1] - order[:, -2] >= CLEAR, odds.argmax(axis=1)
        nats = odds[:, k] - np.logaddexp.reduce(odds, axis=1) - log_prior[k]
        total += share * np.mean([nats, leads & (best == k), leads & (best != k)], axis=1)
    return total


@pytest.mark.parametrize("case", CASES)
def test_what_tells_models_apart_is_the_mutual_information(case, monkeypatch):
    """Planted: the truth itself counts among the draws of its model, as if it had been known."""
    nats, clear, wrong = exact(*CASES[case])

    def z(some):
        return abs(np.mean([(one.nats - nats) / max(one.error, 1e-3) for one in some]))

    right = [discriminated(*CASES[case], seed=k) for k in range(12)]
    assert z(right) < 0.8
    assert np.mean([one.clear for one in right]) == pytest.approx(clear, abs=0.03)
    assert np.mean([one.wrong for one in right]) == pytest.approx(wrong, abs=0.03)
    assert all(one.reliable for one in right)
    if case == "alike":
        assert not discriminated(*CASES[case], number=12).reliable
        whole = discrimination._log_densities
        monkeypatch.setattr(discrimination, "_log_densities", lambda seen, draws, *, own: whole(seen, draws, own=False))
        assert z([discriminated(*CASES[case], seed=k) for k in range(12)]) > 1.0


SPACE = sl.ParameterSpace((
    sl.Parameter("E", sl.LogNormal(6.0, 0.5), "Pa", box=(10.0, 10000.0)),
    sl.Parameter("V", sl.LogNormal(3.0, 0.5), box=(1.0, 1000.0)),
    sl.Parameter("nu", sl.Normal(0.0, 0.2), box=(-1.0, 0.5)),
))  # fmt: skip


def test_a_common_factor_of_stiffness_and_load_is_left_unknown_wherever_the_draws_are():
    """The interface shows V/E and ν only, each to a hundredth."""

    def information(x):
        rows = np.array([[-x[1] / x[0] ** 2, 1 / x[0], 0.0], [0.0, 0.0, 1.0]]) / [[0.01 * x[1] / x[0]], [0.01]]
        return rows.T @ rows

    scale, x = scale_of(SPACE), SPACE.prior_quantiles(sl.sobol(8, 3, scramble=0))
    worst, *others = directions_left(scale, x, [information(row) for row in x])
    assert worst.left == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(worst.weights, [0.5**0.5, 0.5**0.5, 0.0], atol=0.02)
    assert max(one.left for one in others) < 0.06
    assert in_words(worst, SPACE.names) == "E up and V up (1 : 1)"
