"""Residuals that are linear in the field: slopes, sums, and the expected likelihood in closed form."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from tests.calibration.arches import SD, SPACE, TRUTH, arch, knowledge, seen

from strandline.discrepancy import NormalOffset
from strandline.interface import Observation, PointErrors, UnknownErrors
from strandline.likelihood import FieldLikelihood
from strandline.likelihood import field as module
from strandline.likelihood.joint_errors import JointErrors
from strandline.likelihood.linearised import linearise
from strandline.likelihood.near_field import NearField, near_field
from strandline.likelihood.residuals import residuals_of

LOCAL = PointErrors(SD)
GLOBAL = PointErrors(SD, 0.05, shift=0.02, rotation=1.0, scale=0.01, offset=0.01)
ALL = [pytest.param(LOCAL, id="local"), pytest.param(GLOBAL, id="global")]
RANDOM = np.random.default_rng(4)


@cache
def likelihood(errors: PointErrors | UnknownErrors) -> FieldLikelihood:
    known = errors if isinstance(errors, PointErrors) else LOCAL
    return knowledge(NormalOffset(), {"": Observation(seen(known), errors)}).likelihood


def joint(errors: PointErrors) -> JointErrors:
    return JointErrors(likelihood(errors).observations, (errors,))


def near(errors: PointErrors) -> NearField:
    found = likelihood(errors).near_fit
    assert found is not None
    return found


@pytest.mark.parametrize("errors", ALL)
def test_slopes_are_those_of_the_residuals(errors: PointErrors) -> None:
    """At smooth observed points: elsewhere the registration itself depends a little on the field."""
    smooth, surrogate = JointErrors((Observation(arch(TRUTH), errors),), (errors,)), likelihood(errors).surrogate
    found, size = near_field(surrogate, smooth, near(errors).at), 1e-3

    def exact(coefficients: np.ndarray) -> np.ndarray:
        templates = {name: layout.template for name, layout in surrogate.layouts.items()}
        return residuals_of(smooth, surrogate.points(coefficients), templates)

    steps = np.concatenate([size * np.eye(len(found.at)), -size * np.eye(len(found.at))])
    moved = exact(found.at + steps)
    differences = (moved[: len(found.at)] - moved[len(found.at) :]) / (2 * size)
    tolerance = 0.05 if errors is GLOBAL else 1e-3
    np.testing.assert_allclose(found.slopes.T, differences, atol=tolerance * np.abs(found.slopes).max())
    np.testing.assert_allclose(found.residuals, exact(found.at[None])[0], atol=0.02 * SD)


@pytest.mark.parametrize("errors", ALL)
def test_sums_are_those_of_the_linear_residuals(errors: PointErrors) -> None:
    found = near(errors)
    z = 1e-5 * RANDOM.standard_normal((5, len(found.at)))
    pairs = np.array([[a * b for k, a in enumerate(row) for b in row[k:]] for row in z])
    r = found.residuals + z @ found.slopes.T + pairs @ found.bends.T
    squares, products = found.sums(found.at + z)
    assert np.abs(pairs @ found.bends.T).max() > 1e-10
    np.testing.assert_allclose(squares, (r**2 / found.model.local).sum(axis=1))
    np.testing.assert_allclose(products, r @ found.model.features, rtol=1e-9, atol=1e-9)


def test_bends_are_second_derivatives() -> None:
    """On average: those of the polyline itself are nothing but kinks at its nodes."""
    surrogate = likelihood(LOCAL).surrogate
    templates = {name: layout.template for name, layout in surrogate.layouts.items()}
    smooth = JointErrors((Observation(arch(TRUTH).resampled(1201), LOCAL),), (LOCAL,))
    found, size = near_field(surrogate, smooth, near(LOCAL).at), 0.04
    one, other = np.triu_indices(len(found.at))
    step = size * np.eye(len(found.at))

    def off(z: np.ndarray) -> np.ndarray:
        r = residuals_of(smooth, surrogate.points(found.at + z), templates)
        return np.asarray(r - found.residuals - z @ found.slopes.T)

    plus, minus = (off(sign * (step[one] + step[other])) for sign in (1, -1))
    pairs = step[one] + step[other]
    expected = np.array([found.bends @ [a * b for k, a in enumerate(z) for b in z[k:]] for z in pairs])
    middle = slice(60, -60)
    differences = (0.5 * (plus + minus))[:, middle]
    assert np.abs(differences - expected[:, middle]).mean() < 0.15 * np.abs(differences).mean()


def with_tail(found: NearField) -> NearField:
    return replace(found, tail=0.5 * SD * RANDOM.standard_normal((len(found.residuals), 2)))


@pytest.mark.parametrize("errors", ALL)
def test_the_gain_is_that_of_a_wider_normal_distribution(errors: PointErrors) -> None:
    """E[N(y; r(c), C)] = N(y; r̄, C + AVAᵀ), by dense matrices."""
    found = with_tail(near(errors))
    C = np.diag(found.model.local) + found.model.shared @ found.model.shared.T
    A = np.hstack([found.slopes, found.tail])
    mean = found.at + 0.01 * RANDOM.standard_normal((3, len(found.at)))
    variance = (0.02 * RANDOM.random((3, len(found.at)))) ** 2
    for c, v, gain in zip(mean, variance, found.gain(mean, variance), strict=True):
        r = found.residuals + found.slopes @ (c - found.at)
        wider = C + A @ np.diag([*v, 1.0, 1.0]) @ A.T
        logs = [multivariate_normal.logpdf(r, cov=one) for one in (wider, C)]
        dets = np.linalg.slogdet(C)[1]
        assert dets < 0
        assert gain == pytest.approx(logs[0] - logs[1], abs=1e-6)


def test_likely_draws_are_those_of_the_field_given_the_observation() -> None:
    found = with_tail(near(LOCAL))
    number, modes = 20_000, len(found.at)
    mean, variance = np.repeat(found.at[None] + 0.01, number, axis=0), np.full((number, modes), 0.02**2)
    c, t, change = found.likely(mean, variance, RANDOM.standard_normal((number, modes + 2)))
    A = np.hstack([found.slopes * 0.02, found.tail])
    precision = np.eye(modes + 2) + A.T @ found.model.solved(A.T).T
    r = found.residuals + found.slopes @ (mean[0] - found.at)
    centre = -np.linalg.solve(precision, A.T @ found.model.solved(r))
    u = np.hstack([(c - mean) / 0.02, t])
    spread = np.linalg.inv(precision)
    assert np.abs((u.mean(axis=0) - centre) / np.sqrt(np.diag(spread) / number)).max() < 4.5
    np.testing.assert_allclose(np.cov(u.T), spread, atol=5 * np.diag(spread).max() / np.sqrt(number))
    some = r + u[:3] @ A.T
    squares = [one @ found.model.solved(one) for one in (*some, r)]
    np.testing.assert_allclose(change[:3], -0.5 * (np.array(squares[:3]) - squares[3]), rtol=1e-6, atol=1e-8)


def wide(errors: PointErrors, widening: float) -> FieldLikelihood:
    """Return the likelihood with a surrogate that is so unsure that it counts for as much as the noise."""
    found = likelihood(errors)
    processes = tuple(replace(one, widening=widening) for one in found.surrogate.processes)
    return replace(found, surrogate=replace(found.surrogate, processes=processes))


def around(errors: PointErrors, number: int = 20) -> np.ndarray:
    lin = linearise(likelihood(errors).surrogate, joint(errors))
    step = RANDOM.multivariate_normal(np.zeros(2), lin.covariance(joint(errors).model), number)
    return np.clip(lin.at + step, SPACE.low, SPACE.high)


def by_draws(found: FieldLikelihood, x: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    monkeypatch.setattr(module, "TOLERATED", -1.0)
    monkeypatch.setattr(module, "DRAWS", 4096)
    return replace(found).expected(x)


@pytest.mark.parametrize("errors", ALL)
def test_the_closed_form_is_the_mean_over_many_fields(errors: PointErrors, monkeypatch: pytest.MonkeyPatch) -> None:
    found, x = wide(errors, WIDENING[errors]), around(errors)
    closed = found.expected(x)
    assert np.abs(closed - found.plug_in(x)).max() > 0.5
    off = np.abs(closed - by_draws(found, x, monkeypatch))
    assert (off <= 0.1 + 0.1 * (closed.max() - closed)).all()


WIDENING = {LOCAL: 1e7, GLOBAL: 1e8}
"""Makes the variance of the field count for as much as the noise."""


def test_slopes_that_are_wrong_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: slopes that are half as large again; the mean over draws takes the place of the closed form."""
    found, x = wide(LOCAL, WIDENING[LOCAL]), around(LOCAL)
    right = near(LOCAL)
    monkeypatch.setattr(FieldLikelihood, "near_fit", replace(right, slopes=1.5 * right.slopes))
    closed = found.expected(x)
    np.testing.assert_array_equal(closed, replace(found)._drawn(found.surrogate.predict(x)))


@pytest.mark.parametrize("errors", [*ALL, pytest.param(UnknownErrors(), id="unknown")])
def test_linear_residuals_lead_to_the_posterior(errors: PointErrors | UnknownErrors) -> None:
    found, x = likelihood(errors), around(errors if isinstance(errors, PointErrors) else LOCAL, 200)
    off = found.plug_in(x, rough=True) - found.plug_in(x)
    assert np.ptp(off) < 1.0


def test_the_best_inputs_fit_best() -> None:
    lin = linearise(likelihood(GLOBAL).surrogate, joint(GLOBAL))
    grid = SPACE.prior_quantiles(RANDOM.random((2000, 2)))
    assert joint(GLOBAL).model.square(lin.residuals) <= -2 * likelihood(GLOBAL).plug_in(grid).max() + 0.1
    at = near_field(likelihood(GLOBAL).surrogate, joint(GLOBAL), lin.field.at)
    np.testing.assert_array_equal(at.slopes, lin.field.slopes)
