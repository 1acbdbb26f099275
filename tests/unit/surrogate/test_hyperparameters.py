"""Evidence against scikit-learn, and searches for its maximum."""

import warnings
from itertools import product

import numpy as np
import pytest
from scipy.optimize import OptimizeResult
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern
from tests.unit.surrogate.peers import EVERY, FLAT, drawn, hyperparameters, peer, standardised

from strandline.design import sobol
from strandline.foundations import NumericsError
from strandline.surrogate import KERNELS, evidence, fit_hyperparameters
from strandline.surrogate import hyperparameters as module
from strandline.surrogate.gaussian_process import standardisation

MATERN, PRODUCT = KERNELS["matern32"], KERNELS["matern32_product"]


@EVERY
def test_evidence_and_gradient_equal_another_implementation(names):
    for (number, dim), name in product([(5, 2), (65, 1), (110, 4), (290, 2)], names):
        x, y = standardised(number, dim)
        ours, other = evidence(x, y, **hyperparameters(name, dim)), peer(name, dim).fit(x, y)
        value, slopes = other.log_marginal_likelihood(other.kernel_.theta, eval_gradient=True)
        by_lengths = np.diagonal(slopes[1:].reshape(dim, dim)) if name.endswith("_product") else slopes[1:]
        assert ours.value == pytest.approx(value, rel=1e-9)
        expected = [slopes[0], *(by_lengths + 3 / len(by_lengths) * slopes[0])]
        np.testing.assert_allclose(ours.gradient, expected, rtol=1e-6, atol=1e-6)


def test_the_fit_is_the_maximum_that_another_optimiser_finds():
    x, y = drawn(PRODUCT.name, 120, (0.6, 2.0), 1e-3, seed=2)
    fit = fit_hyperparameters(x, y, kernel=PRODUCT, nugget=1e-3)
    free, fixed = (1e-2, 10.0), (FLAT, FLAT * (1 + 1e-9))
    correlation = Matern([1.0, FLAT], [free, fixed], nu=1.5) * Matern([FLAT, 1.0], [fixed, free], nu=1.5)
    other = GaussianProcessRegressor(ConstantKernel(1.0, (1e-3, 1e5)) * correlation, alpha=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the lengths that are held at their bound
        other.fit(x, y)
    assert fit.log_evidence == pytest.approx(other.log_marginal_likelihood_value_, abs=1e-3)
    assert not fit.at_bound
    assert np.ptp([a.log_evidence for a in fit.attempts]) < 0.01
    at = {"length_scale": fit.length_scale, "signal_variance": fit.signal_variance}
    best = evidence(x, y, kernel=PRODUCT, nugget=1e-3, **at)
    assert best.value == pytest.approx(fit.log_evidence, abs=1e-6)
    assert np.abs(best.gradient).max() < 0.05


def quadratic(number):
    """Return data of a quadratic log-likelihood, and their nugget."""
    x, _ = standardised(number, 2)
    y = -30 * (x**2).sum(axis=1)
    return (x, y - y.mean()), 1e-5 * float(np.ptp(y))


def test_a_quadratic_log_likelihood_and_an_input_without_influence_end_at_the_bound():
    data, nugget = quadratic(60)
    for options, bound in (({}, 10.0), ({"length_scale_bound": 2.0}, 2.0)):
        fit = fit_hyperparameters(*data, kernel=MATERN, nugget=nugget, **options)
        assert (fit.at_bound, fit.length_scale) == (True, pytest.approx(bound))
    x, _ = standardised(80, 3)
    y = np.sin(2 * x[:, 0]) + np.cos(3 * x[:, 2])
    fit = fit_hyperparameters(x, y - y.mean(), kernel=PRODUCT, nugget=1e-4)
    assert fit.at_bound
    assert fit.length_scale[1] == pytest.approx(10.0)
    assert max(fit.length_scale[0], fit.length_scale[2]) < 10.0


def test_long_lengths_of_the_squared_exponential_are_refused_and_the_fit_keeps_off_them():
    data, nugget = quadratic(150)
    long = {"length_scale": 10.0, "signal_variance": 1e16, "nugget": nugget}
    for kernel in (KERNELS["squared_exponential"], KERNELS["squared_exponential_ard"]):
        with pytest.raises(NumericsError, match="bound the length scale lower"):
            evidence(*data, kernel=kernel, **long)
        assert np.isfinite(fit_hyperparameters(*data, kernel=kernel, nugget=nugget).log_evidence)


def stopped(fun, x):
    """Return what an optimiser returns that stops at `x` without success."""
    value, slope = fun(x)
    return OptimizeResult(x=x, fun=value, jac=slope, success=False, nfev=1, message="ABNORMAL: ")


def test_an_abnormal_stop_is_accepted_at_a_maximum_and_an_error_elsewhere(monkeypatch):
    x, y = drawn("matern32", 80, [0.7], 1e-3, seed=3)
    fit = fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)
    best = np.log([fit.signal_variance / fit.length_scale**3, fit.length_scale])
    climb = module.Objective(x, y, MATERN, 1e-3)
    best = module.minimize(climb.descent, best, jac=True, method="BFGS", options={"gtol": 1e-6}).x
    monkeypatch.setattr(module, "minimize", lambda fun, z0, **_: stopped(fun, best))
    again = fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)
    assert again.message == "ABNORMAL: "
    assert again.verdict.startswith("accepted: projected gradient")
    monkeypatch.setattr(module, "minimize", lambda fun, z0, **_: stopped(fun, z0))
    with pytest.raises(NumericsError, match=r"ABNORMAL.*not a maximum"):
        fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)


def test_a_success_of_the_optimiser_on_a_slope_is_no_maximum_and_the_search_goes_on(monkeypatch):
    """Planted: from one of the starts a gain of 5 % counts as none, which the optimiser calls convergence."""
    u = sobol(120, 7)
    y = -40 * (u[:, 0] - 0.3 - 0.3 * u[:, 1] ** 2) ** 2 - 10 * (u[:, 2] * u[:, 3] - 0.2) ** 2
    y += -0.5 * u[:, 4] - 0.1 * u[:, 5] - np.sin(3 * u[:, 6])
    (shift, scale), y = standardisation(u), y - y.mean()
    options = {"kernel": PRODUCT, "nugget": 1e-5 * float(np.ptp(y)), "starting_lengths": (0.5, 3.0)}
    x, optimise, stops = (u - shift) / scale, module.minimize, []
    expected = fit_hyperparameters(x, y, **options).log_evidence

    def hasty(function, z, *, options, **others):
        first = np.allclose(z[1:], np.log(0.5))
        stops.append(optimise(function, z, options={**options, "ftol": 0.05} if first else options, **others))
        return stops[-1]

    monkeypatch.setattr(module, "minimize", hasty)
    found = fit_hyperparameters(x, y, **options)
    assert stops[0].success
    assert -stops[0].fun < expected - 10
    assert [a.accepted for a in found.attempts] == [True, True]
    assert [a.log_evidence for a in found.attempts] == pytest.approx([expected] * 2, abs=0.01)
