"""Evidence against scikit-learn, and searches for its maximum."""

import math
import warnings
from itertools import product

import numpy as np
import pytest
from scipy.optimize import OptimizeResult
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern
from tests.unit.surrogate.peers import EVERY, FLAT, drawn, hyperparameters, peer, standardised

from strandline.design import sobol
from strandline.errors import InvalidInput, NumericsError, TooFewRuns
from strandline.surrogate import KERNELS, evidence, fit_hyperparameters
from strandline.surrogate import hyperparameters as module
from strandline.surrogate.gaussian_process import standardisation

MATERN, PRODUCT = KERNELS["matern32"], KERNELS["matern32_product"]


def standard(u, y):
    """Return standardised inputs and centred targets."""
    shift, scale = standardisation(u)
    return (u - shift) / scale, y - y.mean()


def ridge(number):
    u = sobol(number, 2)
    return standard(u, -2000 * (u[:, 0] * (1 + u[:, 1] ** 2) - 0.6) ** 2 - 300 * np.abs(u[:, 1] - 0.4) ** 1.5)


def bowl(number):
    u = sobol(number, 7)
    return standard(u, -30 * ((u - 0.5) ** 2).sum(axis=1))


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


@pytest.mark.parametrize(("kernel", "lengths"), [(MATERN, (0.7,)), (PRODUCT, (0.6, 2.0))], ids=["one", "several"])
def test_the_fit_is_the_maximum_that_another_optimiser_finds(kernel, lengths):
    x, y = drawn(kernel.name, 120, lengths, 1e-3, seed=2)
    fit = fit_hyperparameters(x, y, kernel=kernel, nugget=1e-3)
    free, fixed = (1e-2, 10.0), (FLAT, FLAT * (1 + 1e-9))
    several = Matern([1.0, FLAT], [free, fixed], nu=1.5) * Matern([FLAT, 1.0], [fixed, free], nu=1.5)
    correlation = Matern(1.0, free, nu=1.5) if kernel is MATERN else several
    other = GaussianProcessRegressor(ConstantKernel(1.0, (1e-3, 1e5)) * correlation, alpha=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the lengths that are held at their bound
        other.fit(x, y)
    assert fit.log_evidence == pytest.approx(other.log_marginal_likelihood_value_, abs=1e-3)
    assert not fit.at_bound
    assert fit.verdict == "converged" or fit.verdict.startswith("accepted")
    assert np.ptp([a.log_evidence for a in fit.attempts]) < 0.01
    at = {"length_scale": fit.length_scale, "signal_variance": fit.signal_variance}
    best = evidence(x, y, kernel=kernel, nugget=1e-3, **at)
    assert best.value == pytest.approx(fit.log_evidence, abs=1e-6)
    assert np.abs(best.gradient).max() < 0.05


def quadratic(number):
    """Return data of a quadratic log-likelihood, and their nugget."""
    x, _ = standardised(number, 2)
    y = -30 * (x**2).sum(axis=1)
    return (x, y - y.mean()), 1e-5 * float(np.ptp(y))


def test_a_quadratic_log_likelihood_and_an_input_without_influence_end_at_the_bound():
    data, nugget = quadratic(60)
    fit = fit_hyperparameters(*data, kernel=MATERN, nugget=nugget)
    tighter = fit_hyperparameters(*data, kernel=MATERN, nugget=nugget, length_scale_bound=2.0)
    assert fit.at_bound
    assert fit.length_scale == pytest.approx(10.0)
    assert tighter.length_scale == pytest.approx(2.0)
    assert tighter.log_evidence < fit.log_evidence
    x, _ = standardised(80, 3)
    y = np.sin(2 * x[:, 0]) + np.cos(3 * x[:, 2])
    fit = fit_hyperparameters(x, y - y.mean(), kernel=PRODUCT, nugget=1e-4)
    assert fit.at_bound
    assert fit.length_scale[1] == pytest.approx(10.0)
    assert max(fit.length_scale[0], fit.length_scale[2]) < 10.0


def test_long_lengths_of_the_squared_exponential_are_refused_and_the_fit_keeps_off_them():
    data, nugget = quadratic(150)
    long = {"length_scale": 10.0, "signal_variance": 1e16, "nugget": nugget}
    assert np.isfinite(evidence(*data, kernel=MATERN, **long).value)
    for kernel in (KERNELS["squared_exponential"], KERNELS["squared_exponential_ard"]):
        with pytest.raises(NumericsError, match="bound the length scale lower"):
            evidence(*data, kernel=kernel, **long)
        assert np.isfinite(fit_hyperparameters(*data, kernel=kernel, nugget=nugget).log_evidence)
    x, y = ridge(400)  # the starting variance leaves a covariance that can be factorised
    objective = module.Objective(x, y, KERNELS["squared_exponential_ard"], 1e-6 * float(np.ptp(y)))
    assert np.isfinite(objective.evidence(objective.starting_ratio(3.0), [math.log(3.0)] * 2).value)


def stopped(fun, at, x, *, success=False, message="ABNORMAL: "):
    """Return what an optimiser returns that stops at `x` with the value of another place."""
    value, slope = fun(at)
    return OptimizeResult(x=x, fun=value, jac=slope, success=success, nfev=1, message=message)


def test_an_abnormal_stop_is_accepted_at_a_maximum_and_an_error_elsewhere(monkeypatch):
    x, y = drawn("matern32", 80, [0.7], 1e-3, seed=3)
    fit = fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)
    best = np.log([fit.signal_variance / fit.length_scale**3, fit.length_scale])
    climb = module.Objective(x, y, MATERN, 1e-3)
    best = module.minimize(climb.descent, best, jac=True, method="BFGS", options={"gtol": 1e-6}).x
    monkeypatch.setattr(module, "minimize", lambda fun, z0, **_: stopped(fun, best, best))
    again = fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)
    assert again.message == "ABNORMAL: "
    assert again.verdict.startswith("accepted: projected gradient")
    monkeypatch.setattr(module, "minimize", lambda fun, z0, **_: stopped(fun, z0, z0))
    with pytest.raises(NumericsError, match=r"ABNORMAL.*not a maximum"):
        fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)


def test_a_stop_where_the_covariance_breaks_down_is_refused_whatever_the_optimiser_says(monkeypatch):
    x, y = drawn("matern32", 80, [0.7], 1e-6, seed=3)
    smooth, search = KERNELS["squared_exponential"], module.minimize

    def one_in_the_wall(fun, z0, **options):
        if z0[1] < math.log(1.0):
            return search(fun, z0, **options)
        return stopped(fun, np.array([30.0, math.log(10.0)]), z0, success=True, message="CONVERGENCE: ")

    monkeypatch.setattr(module, "minimize", one_in_the_wall)
    fit = fit_hyperparameters(x, y, kernel=smooth, nugget=1e-6)
    assert [a.accepted for a in fit.attempts] == [True, False]
    assert "never positive definite" in fit.attempts[1].verdict
    with pytest.raises(NumericsError, match="never positive definite"):
        fit_hyperparameters(x, y, kernel=smooth, nugget=1e-6, starting_lengths=(3.0,))


def test_a_success_of_the_optimiser_on_a_slope_is_no_maximum_and_the_search_goes_on(monkeypatch):
    """Planted: from one of the starts a gain of 5 % counts as none, which the optimiser calls convergence."""
    u = sobol(120, 7)
    y = -40 * (u[:, 0] - 0.3 - 0.3 * u[:, 1] ** 2) ** 2 - 10 * (u[:, 2] * u[:, 3] - 0.2) ** 2
    x, y = standard(u, y - 0.5 * u[:, 4] - 0.1 * u[:, 5] - np.sin(3 * u[:, 6]))
    options = {"kernel": PRODUCT, "nugget": 1e-5 * float(np.ptp(y)), "starting_lengths": (0.5, 3.0)}
    expected, optimise, stops = fit_hyperparameters(x, y, **options).log_evidence, module.minimize, []

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


@pytest.mark.parametrize(
    ("data", "name", "better"), [(ridge(60), "squared_exponential", 0), (bowl(50), "matern52_ard", 1)]
)
def test_neither_start_suffices_alone(data, name, better):
    nugget = 1e-5 * float(np.ptp(data[1]))
    fit = fit_hyperparameters(*data, kernel=KERNELS[name], nugget=nugget)
    ends = [a.log_evidence for a in fit.attempts]
    assert all(a.accepted for a in fit.attempts)
    assert ends[better] > ends[1 - better] + 5
    assert fit.log_evidence == ends[better]


def test_data_that_teach_nothing_are_refused():
    x, y = standardised(20, 2)
    lost = np.where(np.arange(20) == 7, -np.inf, y)
    for data, error, words in (
        (standardised(3, 2), TooFewRuns, "at least 4 for 2"),
        ((x, 0 * y), NumericsError, "nothing to learn"),
        ((x, lost), InvalidInput, "training run 7"),
    ):
        with pytest.raises(error, match=words):
            fit_hyperparameters(*data, kernel=MATERN, nugget=1e-3)
    assert fit_hyperparameters(*standardised(4, 2), kernel=MATERN, nugget=1e-3).length_scale > 0
