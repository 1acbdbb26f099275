"""Residuals near the best fit as polynomials of the field, and means of likelihoods over fields that follow."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from tests.unit.calibration.arches import SD, SPACE, TRUTH, arch
from tests.unit.discrepancy.curves import graph
from tests.unit.likelihood.near_arches import ALL, GLOBAL, LOCAL, around, by, joint, likelihood, near, widened

from strandline.discrepancy import ClosestPoint, Currents, JointErrors, NormalOffset, residuals_of, signed_distances
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
from strandline.likelihood import FieldLikelihood, compared
from strandline.likelihood.linearised_residuals import BENT, TRUSTED, linearise, near_field
from strandline.likelihood.local_likelihood import (
    FittedParabola,
    NearParabola,
    OfStatedErrors,
    _ByOffsets,
    log_gain,
    mean_of_draws,
    numbers,
)
from strandline.surrogate.field import FieldPrediction, FieldSurrogate

WIDENING = {LOCAL: 1e7, GLOBAL: 1e8}
"""Makes the variance of the field count for as much as the noise."""


def of_points(errors: PointErrors, seen: Interface) -> JointErrors:
    return JointErrors((Observation(seen, errors),), (errors,))


def residuals_at(errors: JointErrors, surrogate: FieldSurrogate, *fields: np.ndarray) -> np.ndarray:
    """Return the residuals of these coefficients of modes, and of what the modes leave."""
    templates = {name: layout.template for name, layout in surrogate.layouts.items()}
    return residuals_of(errors, surrogate.points(*fields), templates)


@pytest.mark.parametrize("errors", ALL)
def test_slopes_are_those_of_the_residuals(errors):
    """At smooth observed points: elsewhere the registration itself depends a little on the field."""
    smooth, surrogate, at = of_points(errors, arch(TRUTH)), likelihood(errors).surrogate, near(errors).at
    found, step = near_field(surrogate, smooth, at), 1e-3 * np.eye(len(at))
    ahead, back = (residuals_at(smooth, surrogate, found.at + sign * step) for sign in (1, -1))
    tolerance = 0.05 if errors is GLOBAL else 1e-3
    np.testing.assert_allclose(found.slopes.T, (ahead - back) / 2e-3, atol=tolerance * np.abs(found.slopes).max())
    np.testing.assert_allclose(found.residuals, residuals_at(smooth, surrogate, found.at[None])[0], atol=0.02 * SD)


def test_what_the_modes_leave_has_slopes_of_its_own():
    """Between the ends: beyond them the outline goes on straight, and turns with what is random from node to node."""
    found, smooth, at = likelihood(LOCAL).surrogate, of_points(LOCAL, arch(TRUTH)), near(LOCAL).at
    rows = np.random.default_rng(3).standard_normal((3, found.modes.basis.shape[1]))
    surrogate = replace(found, modes=replace(found.modes, tail=0.01 * np.linalg.qr(rows.T)[0].T))
    ahead, back = (residuals_at(smooth, surrogate, np.tile(at, (3, 1)), step * np.eye(3)) for step in (1e-2, -1e-2))
    slopes, differences = near_field(surrogate, smooth, at).tail.T, (ahead - back) / 2e-2
    assert slopes.shape[0] == 3
    np.testing.assert_allclose(slopes[:, 1:-1], differences[:, 1:-1], atol=1e-3 * np.abs(slopes).max())


def test_bends_are_second_derivatives():
    """On average: those of the polyline itself are nothing but kinks at its nodes."""
    surrogate, smooth = likelihood(LOCAL).surrogate, of_points(LOCAL, arch(TRUTH).resampled(1201))
    found = near_field(surrogate, smooth, near(LOCAL).at)
    step, (one, other) = 0.04 * np.eye(len(found.at)), np.triu_indices(len(found.at))

    def off(z):
        return residuals_at(smooth, surrogate, found.at + z) - found.residuals - z @ found.slopes.T

    pairs = step[one] + step[other]
    expected = np.array([found.bends @ [a * b for k, a in enumerate(z) for b in z[k:]] for z in pairs])
    differences = 0.5 * (off(pairs) + off(-pairs))[:, 60:-60]
    assert np.abs(differences - expected[:, 60:-60]).mean() < 0.15 * np.abs(differences).mean()


def test_bends_count_by_half_where_they_are_as_large_as_is_trusted():
    found = near(LOCAL)
    z = np.random.default_rng(6).standard_normal(len(found.at))
    one, other = np.triu_indices(min(len(found.at), BENT))
    ahead, bent = found.slopes @ z, found.bends @ (z[one] * z[other])
    size = TRUSTED * np.sqrt((ahead**2 @ (1 / found.model.local)) / (bent**2 @ (1 / found.model.local)))
    _, share = found.bending(np.array([size * z, 1e-3 * size * z]))
    np.testing.assert_allclose(share, [0.5, 1.0], atol=1e-5)


@pytest.mark.parametrize("errors", ALL)
def test_fields_drawn_nearby_are_as_good(errors):
    found, x = widened(likelihood(errors), WIDENING[errors]), around(errors)
    some, exact = found.expected(x, plug_in=found.plug_in(x)), found.expected(x)
    assert np.abs(exact - found.plug_in(x)).max() > 0.5
    assert (some != exact).all()
    assert (np.abs(some - exact) <= 0.1 + 0.1 * (exact.max() - exact)).all()


def test_a_neighbour_that_is_wrong_is_noticed(monkeypatch):
    """Planted: slopes that are half as large again."""
    found, x, right = widened(likelihood(LOCAL), WIDENING[LOCAL]), around(LOCAL), near(LOCAL)
    wrong = OfStatedErrors(replace(right, slopes=1.5 * right.slopes), right.model)
    monkeypatch.setattr(FieldLikelihood, "nearby", wrong)
    np.testing.assert_array_equal(found.expected(x, plug_in=found.plug_in(x)), found.expected(x))


def test_it_leads_to_the_posterior_also_by_other_measures_which_follow_offsets():
    """How much log L nearby is off, but for a constant."""

    def off(found, x):
        return np.ptp(found.nearby.log_likelihood(found.surrogate.mean(x)) - found.plug_in(x))

    for errors in (LOCAL, GLOBAL, UnknownErrors()):
        assert off(likelihood(errors), around(errors if errors is GLOBAL else LOCAL, 100)) < 1.0
    closest, x = (ClosestPoint(weighting="length"), ClosestPoint(direction="symmetric")), around(LOCAL, 60)
    for measure in (Currents(0.03), *closest, NormalOffset()):
        values = by(measure).plug_in(x)
        near_best = values > values.max() - 6
        assert near_best.sum() > 10
        assert np.ptp(values[near_best]) > 2
        assert off(by(measure), x[near_best]) < 0.2 * np.ptp(values[near_best])
    assert by(Currents(0.03, quadrature="centre")).nearby is None


def test_fields_of_another_measure_are_drawn_nearby(monkeypatch):
    """Planted: forty times the squares of offsets, which shows."""
    found, x = widened(by(Currents(0.03), 0.004), 1e7), around(LOCAL, 60)
    some = found.expected(x, plug_in=found.plug_in(x))
    exact = found._drawn(found.surrogate.predict(x))
    assert np.abs(exact - found.plug_in(x)).max() > 0.2
    assert (some != exact).any()
    np.testing.assert_allclose(some[exact > exact.max() - 6], exact[exact > exact.max() - 6], atol=0.2)
    monkeypatch.setattr(Currents, "of_offsets", lambda *given: 40 * (given[1] ** 2).sum(axis=1))
    planted = replace(found)
    np.testing.assert_array_equal(planted.expected(x, plug_in=found.plug_in(x)), planted.expected(x))


def test_the_best_inputs_fit_best():
    lin = linearise(likelihood(GLOBAL).surrogate, joint(GLOBAL))
    grid = SPACE.prior_quantiles(np.random.default_rng(6).random((2000, 2)))
    assert joint(GLOBAL).model.square(lin.residuals) <= -2 * likelihood(GLOBAL).plug_in(grid).max() + 0.1
    at = near_field(likelihood(GLOBAL).surrogate, joint(GLOBAL), lin.field.at)
    np.testing.assert_array_equal(at.slopes, lin.field.slopes)


def test_weights_of_offsets_do_not_depend_on_their_side_and_small_ones_take_the_typical_size():
    """The norm of currents of width σ grows with each offset r as 1 - exp(-r²/2σ²)."""
    width, line = 0.05, graph(np.linspace(0.0, 2.0, 41), 0.0)
    of = _ByOffsets(compared(Observation(line, 1e-4), Currents(width), 41), 41)
    r = np.zeros(41)
    r[10], r[30] = 0.12, -0.12
    found, typical = of.weights(r), float(np.sqrt(np.mean(r**2)))
    np.testing.assert_allclose(found, of.weights(-r))
    assert found[10] == pytest.approx(found[30])
    share = [(1 - np.exp(-(size**2) / (2 * width**2))) / size**2 for size in (typical, 0.12)]
    assert found[20] / found[10] == pytest.approx(share[0] / share[1], rel=1e-3)


def test_a_shifted_observation_is_followed_even_if_some_points_do_not_feel_the_shift():
    """Half of the interface is flat: its signed distances do not change with a shift along it."""
    s = np.linspace(0.0, 2.0, 401)
    y = np.where(s > 1, 0.3 * np.sin(np.pi * np.maximum(s - 1, 0.0)) ** 2, 0.0)
    true = graph(s, y)
    errors, shift = PointErrors(1e-3, shift=0.05), np.array([0.05, 0.0])
    seen = Interface.polyline(true.points[40:-40] + shift)
    found = of_points(errors, seen)
    (r,) = residuals_of(found, {"": true.points[None]}, {"": true})
    assert not found.model.shared.all()
    by_shift = found.model.shared @ np.array([1.0, 0.0])
    np.testing.assert_allclose(r, by_shift, atol=2e-3)
    assert np.abs(signed_distances(seen.points, true) - by_shift).max() > 4e-3


def fields(modes: int, variance: float, residual: float) -> FieldPrediction:
    """Return fields at this distance from the best one, in all directions; the noise has variance 1."""
    away = np.random.default_rng(1).standard_normal((12, modes))
    mean = residual * away / np.linalg.norm(away, axis=1)[:, None]
    return FieldPrediction(mean, np.full((12, modes), variance))


def linear(c, tail=None):
    return -0.5 * (c**2).sum(axis=1)


def test_every_drawn_field_has_its_opposite():
    """So that their mean is what is predicted; in the modes and in what they leave, in each half of the draws."""
    for some in numbers(16, 3, 5):
        assert len(np.unique(np.abs(some), axis=0)) == 8
        for half in (some[:8], some[8:]):
            np.testing.assert_array_equal(half[4:], -half[:4])


def test_quadrature_of_one_mode_agrees():
    """Of a function that saturates, as currents do from some standard deviations on."""

    def saturating(c, tail=None):
        return 25 * np.expm1(linear(c) / 25)

    found, t = fields(1, 3.0, 2.0), np.linspace(-30, 30, 10001)
    rows = [np.trapezoid(np.exp(saturating(t[:, None]) - (t - m) ** 2 / 6), t) for m in found.mean[:, 0]]
    parabolas = FittedParabola.fitted(saturating, np.zeros(1), 1.0).parabolas(found.mean)
    drawn = mean_of_draws(saturating, parabolas, found, numbers(16, 1, 0))
    np.testing.assert_allclose(drawn, np.log(rows) - 0.5 * np.log(6 * np.pi), atol=0.05)


def test_a_parabola_that_is_wrong_does_little_harm():
    """Planted: its middle is ten standard deviations off; draws of the field itself then tell the mean."""
    found = fields(3, 0.1, 1.0)
    wrong = FittedParabola(np.full(3, 10.0), 0.0, np.zeros(3), np.eye(3)).parabolas(found.mean)
    exact = -1.5 * np.log1p(0.1) - 0.5 / 1.1
    np.testing.assert_allclose(mean_of_draws(linear, wrong, found, numbers(64, 3, 0)), exact, atol=0.15)
    closed = linear(found.mean) + log_gain(wrong, found.variance, linear(found.mean))
    assert (np.abs(closed - exact) < 0.5).all()


@pytest.mark.parametrize("errors", ALL)
def test_residuals_near_the_best_fit_give_the_same_as_matrices(errors):
    """N(r; 0, C + JVJᵀ + TTᵀ) / N(0; 0, C), with n × n matrices and numerical derivatives."""
    found, field = likelihood(errors).nearby, near(errors)
    random, modes = np.random.default_rng(6), len(field.at)
    at, variance = field.at + 0.01 * random.standard_normal((4, modes)), (0.02 * random.random((4, modes))) ** 2
    parabolas = found.parabola.parabolas(at)
    got = found.log_likelihood(at) + log_gain(parabolas, variance)
    C = np.diag(field.model.local) + field.model.shared @ field.model.shared.T
    step = 1e-5 * np.eye(modes)
    for value, mean, v in zip(got, at, variance, strict=True):
        J = (field.offsets(mean + step) - field.offsets(mean - step)).T / 2e-5
        r = field.offsets(mean[None])[0]
        whole = C + (J * v) @ J.T + field.tail @ field.tail.T
        expected = multivariate_normal(0 * r, whole).logpdf(r) - multivariate_normal(0 * r, C).logpdf(0 * r)
        gained = expected - found.log_likelihood(mean[None])[0]
        assert value == pytest.approx(expected, abs=0.02 * abs(gained))


def test_measures_average_as_plain_draws_of_the_field_do():
    """With unknown errors, by a measure that is followed nearby, and by one that is not."""
    x, random = around(LOCAL, 40)[:2], np.random.default_rng(3)
    currents = by(Currents(0.03), 0.004), by(Currents(0.03, quadrature="centre"), 0.004)
    for known in (likelihood(UnknownErrors()), *currents):
        found = widened(known, 1e7)
        predicted = found.surrogate.predict(x)
        for row, value in enumerate(found.expected(x)):
            noise = random.standard_normal((1000, predicted.mean.shape[1]))
            draws = predicted.mean[row] + np.sqrt(predicted.variance[row]) * noise
            each = found._of(draws, random.standard_normal((1000, len(found.surrogate.modes.tail))))
            mean = logsumexp(each) - np.log(len(each))
            error = np.std(np.exp(each - mean)) / np.sqrt(len(each))
            assert abs(value - mean) < 0.1 + 3 * error
            assert error < 0.15


def test_the_parabola_of_unknown_errors_touches_the_likelihood_at_the_best_fit():
    found = likelihood(UnknownErrors()).nearby
    at = found.field.at[None]
    parabola = found.parabola.parabolas(at)
    assert parabola.top - parabola.below[0] == pytest.approx(found.log_likelihood(at)[0], abs=1e-8)
    assert parabola.below[0] != pytest.approx(0.5, abs=0.1)


def test_a_fitted_parabola_is_one_of_quadratics_and_never_bends_upwards():
    A, b, at = np.array([[3.0, 1.0], [1.0, 2.0]]), np.array([0.7, -0.4]), np.array([0.2, 0.5])
    quadratic = lambda c: 1.0 + c @ b - 0.5 * np.einsum("ki,ij,kj->k", c, A, c)  # noqa: E731
    found = FittedParabola.fitted(quadratic, at, 0.1)
    np.testing.assert_allclose(found.slopes, b - A @ at, atol=1e-9)
    np.testing.assert_allclose(found.information, A, atol=1e-8)
    saddle = FittedParabola.fitted(lambda c: c[:, 0] ** 2 - c[:, 1] ** 2, np.zeros(2), 0.1)
    assert (np.linalg.eigvalsh(saddle.information) > 0).all()


@pytest.mark.stand_in
def test_what_modes_leave_over_is_integrated_out():
    """∫ exp(-½ rᵀWr) N(t; 0, I) dt for r = (1, z, t), by the formula for a Gaussian of all of them."""
    W = np.cov(np.random.default_rng(3).normal(size=(4, 30)))  # of 1, one mode, two of what they leave
    field = SimpleNamespace(tail=np.zeros((5, 2)))
    weights, log_factor = NearParabola(field, W)._integrated
    for z in (0.0, 0.8):
        r = np.array([1.0, z])
        g = np.linspace(-6, 6, 121)
        t = np.stack([one.ravel() for one in np.meshgrid(g, g)], axis=1)
        terms = np.hstack([np.tile(r, (len(t), 1)), t])
        values = np.exp(-0.5 * np.einsum("ki,ij,kj->k", terms, W, terms) - 0.5 * (t**2).sum(axis=1)) / (2 * np.pi)
        assert -0.5 * r @ weights @ r + log_factor == pytest.approx(np.log(values.sum() * 0.1**2), abs=1e-6)


def plain(f, found: FieldPrediction, number: int = 60_000) -> np.ndarray:
    z = np.random.default_rng(2).standard_normal((number, found.mean.shape[1]))
    rows = zip(found.mean, found.variance, strict=True)
    return np.array([logsumexp(f(mean + np.sqrt(variance) * z)) for mean, variance in rows]) - np.log(number)


def drawn(f, found: FieldPrediction) -> np.ndarray:
    modes = found.mean.shape[1]
    return mean_of_draws(f, fitted(f, modes).parabolas(found.mean), found, numbers(16, modes, 0))


def fitted(f, modes: int) -> FittedParabola:
    return FittedParabola.fitted(f, np.zeros(modes), 1.0)


def test_linear_residuals_have_a_closed_form():
    """It is exact; draws then are too. Sixteen plain draws were off by 1 and more."""
    for modes, variance in ((6, 1.0), (3, 100.0), (20, 0.3)):
        found = fields(modes, variance, 2.0)
        exact = -0.5 * modes * np.log1p(variance) - 0.5 * 2.0**2 / (1 + variance)
        gain = log_gain(fitted(linear, modes).parabolas(found.mean), found.variance)
        np.testing.assert_allclose(linear(found.mean) + gain, exact)
        np.testing.assert_allclose(drawn(linear, found), exact)
        assert np.abs(plain(linear, found, 16) - exact).max() > 0.3
