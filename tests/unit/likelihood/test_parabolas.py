"""Means of likelihoods over Gaussian fields, in closed form and by draws, against plain draws and quadrature."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from tests.unit.likelihood.near_arches import ALL, LOCAL, around, by, likelihood, near, widened

from strandline.discrepancy import Currents
from strandline.interface import PointErrors, UnknownErrors
from strandline.likelihood.parabolas import FittedParabola, Parabolas, log_gain, mean_of_draws, numbers
from strandline.surrogate.field import FieldPrediction

LogLikelihood = Callable[..., np.ndarray]
POINTS = 12


def fitted(f: LogLikelihood, modes: int) -> FittedParabola:
    return FittedParabola.fitted(f, np.zeros(modes), 1.0)


def fields(modes: int, variance: float, residual: float) -> FieldPrediction:
    """Return fields at this distance from the best one, in all directions; the noise has variance 1."""
    away = np.random.default_rng(1).standard_normal((POINTS, modes))
    mean = residual * away / np.linalg.norm(away, axis=1)[:, None]
    return FieldPrediction(mean, np.full((POINTS, modes), variance))


def linear(c: np.ndarray, tail: np.ndarray | None = None) -> np.ndarray:
    return np.asarray(-0.5 * (c**2).sum(axis=1))


def curved(c: np.ndarray, tail: np.ndarray | None = None) -> np.ndarray:
    """As if the interface turned while it moves."""
    return linear(c + 0.1 * np.roll(c, 1, axis=1) ** 2)


def saturating(c: np.ndarray, tail: np.ndarray | None = None) -> np.ndarray:
    """As currents do from some standard deviations on."""
    return np.asarray(-25 * -np.expm1(linear(c) / 25))


def plain(f: LogLikelihood, found: FieldPrediction, number: int = 60_000) -> np.ndarray:
    z = np.random.default_rng(2).standard_normal((number, found.mean.shape[1]))
    rows = zip(found.mean, found.variance, strict=True)
    return np.array([logsumexp(f(mean + np.sqrt(variance) * z)) for mean, variance in rows]) - np.log(number)


def drawn(f: LogLikelihood, found: FieldPrediction) -> np.ndarray:
    modes = found.mean.shape[1]
    return np.asarray(mean_of_draws(f, fitted(f, modes).parabolas(found.mean), found, numbers(16, modes, 0)))


def test_every_drawn_field_has_its_opposite() -> None:
    """So that their mean is what is predicted; in the modes and in what they leave, in each half of the draws."""
    for some in numbers(16, 3, 5):
        assert len(np.unique(np.abs(some), axis=0)) == 8
        for half in (some[:8], some[8:]):
            np.testing.assert_array_equal(half[4:], -half[:4])


def test_linear_residuals_have_a_closed_form() -> None:
    """It is exact; draws then are too. Sixteen plain draws were off by 1 and more."""
    for modes, variance in ((6, 1.0), (3, 100.0), (20, 0.3)):
        found = fields(modes, variance, 2.0)
        exact = -0.5 * modes * np.log1p(variance) - 0.5 * 2.0**2 / (1 + variance)
        gain = log_gain(fitted(linear, modes).parabolas(found.mean), found.variance)
        np.testing.assert_allclose(linear(found.mean) + gain, exact)
        np.testing.assert_allclose(drawn(linear, found), exact)
        assert np.abs(plain(linear, found, 16) - exact).max() > 0.3


def test_quadrature_of_one_mode_agrees() -> None:
    found, t = fields(1, 3.0, 2.0), np.linspace(-30, 30, 10001)
    rows = [np.trapezoid(np.exp(saturating(t[:, None]) - (t - m) ** 2 / 6), t) for m in found.mean[:, 0]]
    np.testing.assert_allclose(drawn(saturating, found), np.log(rows) - 0.5 * np.log(6 * np.pi), atol=0.05)


def test_draws_weigh_off_what_the_parabola_misses() -> None:
    found = fields(6, 1.0, 2.0)
    for f in (curved, saturating):
        exact = plain(f, found)
        closed = f(found.mean) + log_gain(fitted(f, 6).parabolas(found.mean), found.variance, f(found.mean))
        assert np.sqrt(np.mean((drawn(f, found) - exact) ** 2)) < 0.05
        assert np.sqrt(np.mean((closed - exact) ** 2)) < 0.15
        assert np.sqrt(np.mean((plain(f, found, 16) - exact) ** 2)) > 0.3


def test_a_parabola_that_is_wrong_does_little_harm() -> None:
    """Planted: its middle is ten standard deviations off; draws of the field itself then tell the mean."""
    found = fields(3, 0.1, 1.0)
    wrong = FittedParabola(np.full(3, 10.0), 0.0, np.zeros(3), np.eye(3)).parabolas(found.mean)
    exact = -1.5 * np.log1p(0.1) - 0.5 / 1.1
    np.testing.assert_allclose(mean_of_draws(linear, wrong, found, numbers(64, 3, 0)), exact, atol=0.15)
    closed = linear(found.mean) + log_gain(wrong, found.variance, linear(found.mean))
    assert (np.abs(closed - exact) < 0.5).all()
    flat = fitted(lambda c: np.where(c[:, 0] > 0.5, -np.inf, linear(c)), 3).parabolas(np.zeros((1, 3)))
    np.testing.assert_allclose(log_gain(flat, np.ones((1, 3)), np.zeros(1)), 0.0, atol=1e-9)


def test_nothing_gains_more_than_its_distance_from_the_top() -> None:
    """Where log L is -3 and the parabola says -1000, the gain is that of -3.

    Where it is -800 and the parabola -60000 and -1300 on average, 98 % of 800 would be more than the best fit.
    """
    far = Parabolas(np.array([1000.0]), np.array([[np.sqrt(2000.0)]]), np.ones((1, 1, 1)))
    variance = np.array([[1e6]])
    assert log_gain(far, variance)[0] > 900
    assert -3 + log_gain(far, variance, np.array([-3.0]))[0] < 0
    far = Parabolas(np.array([60000.0]), np.array([[np.sqrt(2 * 60000.0)]]), np.ones((1, 1, 1)))
    variance = np.array([[58700.0 / 1300.0]])  # of which the mean over fields gains 58700
    shrinks = 0.5 * np.log1p(variance[0, 0])
    np.testing.assert_allclose(log_gain(far, variance)[0] + shrinks, 58700.0)
    np.testing.assert_allclose(log_gain(far, variance, np.array([-800.0]))[0], -shrinks)
    np.testing.assert_allclose(log_gain(far, variance, np.array([-2000.0]))[0] + shrinks, 700.0)


@pytest.mark.parametrize("errors", ALL)
def test_residuals_near_the_best_fit_give_the_same_as_matrices(errors: PointErrors) -> None:
    """N(r; 0, C + JVJᵀ + TTᵀ) / N(0; 0, C), with n × n matrices and numerical derivatives."""
    found, field = likelihood(errors).nearby, near(errors)
    assert found is not None
    random, modes = np.random.default_rng(6), len(field.at)
    at, variance = field.at + 0.01 * random.standard_normal((4, modes)), (0.02 * random.random((4, modes))) ** 2
    parabolas = found.parabola.parabolas(at)
    got = found.log_likelihood(at) + log_gain(parabolas, variance)
    assert np.abs(log_gain(parabolas, variance)).max() > 1
    C = np.diag(field.model.local) + field.model.shared @ field.model.shared.T
    step = 1e-5 * np.eye(modes)
    for value, mean, v in zip(got, at, variance, strict=True):
        J = (field.offsets(mean + step) - field.offsets(mean - step)).T / 2e-5
        r = field.offsets(mean[None])[0]
        whole = C + (J * v) @ J.T + field.tail @ field.tail.T
        exact = multivariate_normal(0 * r, whole).logpdf(r) - multivariate_normal(0 * r, C).logpdf(0 * r)
        gained = exact - found.log_likelihood(mean[None])[0]
        assert value == pytest.approx(exact, abs=0.02 * abs(gained))


def test_measures_average_as_plain_draws_of_the_field_do() -> None:
    """With unknown errors, by a measure that is followed nearby, and by one that is not."""
    x, random = around(LOCAL, 40)[:2], np.random.default_rng(3)
    for known in (
        likelihood(UnknownErrors()),
        by(Currents(0.03), 0.004),
        by(Currents(0.03, quadrature="centre"), 0.004),
    ):
        found = widened(known, 1e7)
        predicted = found.surrogate.predict(x)
        for row, value in enumerate(found.expected(x)):
            noise = random.standard_normal((1000, predicted.mean.shape[1]))
            draws = predicted.mean[row] + np.sqrt(predicted.variance[row]) * noise
            each = found._of(draws, random.standard_normal((1000, len(found.surrogate.modes.tail))))
            exact = logsumexp(each) - np.log(len(each))
            error = np.std(np.exp(each - exact)) / np.sqrt(len(each))
            assert abs(value - exact) < 0.1 + 3 * error
            assert error < 0.15
