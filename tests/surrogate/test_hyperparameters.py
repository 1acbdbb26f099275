import math

import numpy as np
import pytest
from scipy.optimize import OptimizeResult
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from strandline.design import sobol
from strandline.errors import InvalidInput, NumericsError, TooFewRuns
from strandline.surrogate import KERNELS, evidence, fit_hyperparameters, hyperparameters
from strandline.surrogate.gaussian_process import standardisation

MATERN = KERNELS["matern32"]


def data(number=70, dim=2):
    u = sobol(number, dim)
    shift, scale = standardisation(u)
    y = np.cos(5 * u[:, 0]) + 4 * (u**2).sum(axis=1)
    return (u - shift) / scale, y - y.mean()


def drawn(number, length, variance, nugget, seed):
    """Return standardised inputs and one draw of a Gaussian process of known hyperparameters."""
    x, _ = data(number)
    s = np.linalg.norm(x[:, None] - x, axis=2) / length
    K = variance * MATERN.correlation(s) + nugget * np.eye(number)
    return x, np.linalg.cholesky(K) @ np.random.default_rng(seed).standard_normal(number)


@pytest.mark.parametrize("number", [5, 64, 65, 150])
@pytest.mark.parametrize("length", [0.3, 1.0, 6.0])
def test_value_and_gradient_equal_another_implementation(number, length):
    x, y = data(number)
    ours = evidence(x, y, kernel=MATERN, length_scale=length, signal_variance=3.0, nugget=1e-3)
    kernel = ConstantKernel(3.0) * Matern(length, nu=1.5)
    other = GaussianProcessRegressor(kernel, alpha=1e-3, optimizer=None).fit(x, y)
    value, (by_variance, by_length) = other.log_marginal_likelihood(kernel.theta, eval_gradient=True)
    assert ours.value == pytest.approx(value, rel=1e-9)
    np.testing.assert_allclose(ours.gradient, [by_variance, 3 * by_variance + by_length], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("length", [0.4, 2.0])
def test_gradient_is_the_finite_difference(length):
    x, y = data()

    def value(log_ratio, log_length):
        variance = math.exp(log_ratio + 3 * log_length)
        options = {"kernel": MATERN, "length_scale": math.exp(log_length), "signal_variance": variance}
        return evidence(x, y, nugget=1e-2, **options).value

    at, step = np.array([math.log(2.0 / length**3), math.log(length)]), 1e-5
    slopes = [(value(*(at + step * e)) - value(*(at - step * e))) / (2 * step) for e in np.eye(2)]
    found = evidence(x, y, kernel=MATERN, length_scale=length, signal_variance=2.0, nugget=1e-2)
    np.testing.assert_allclose(found.gradient, slopes, rtol=1e-6, atol=1e-5)


def test_the_fit_is_a_maximum_within_its_box():
    x, y = drawn(150, length=0.7, variance=2.0, nugget=1e-3, seed=1)
    fit = fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)
    options = {"kernel": MATERN, "nugget": 1e-3}
    for factors in [(1.05, 1.0), (0.95, 1.0), (1.0, 1.1), (1.0, 0.9)]:
        moved = {"length_scale": fit.length_scale * factors[0], "signal_variance": fit.signal_variance * factors[1]}
        assert evidence(x, y, **moved, **options).value < fit.log_evidence
    assert not fit.at_bound
    assert fit.verdict == "converged" or fit.verdict.startswith("accepted")


def test_the_fit_reaches_the_best_that_another_optimiser_finds():
    x, y = drawn(120, length=0.7, variance=2.0, nugget=1e-3, seed=2)
    kernel = ConstantKernel(1.0, (1e-3, 1e5)) * Matern(1.0, (1e-2, 10.0), nu=1.5)
    other = GaussianProcessRegressor(kernel, alpha=1e-3, n_restarts_optimizer=2, random_state=0).fit(x, y)
    fit = fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)
    assert fit.log_evidence == pytest.approx(other.log_marginal_likelihood_value_, abs=1e-3)


def test_known_hyperparameters_are_found_again_on_average():
    fits = [
        fit_hyperparameters(*drawn(150, 0.5, 2.0, 1e-4, seed), kernel=MATERN, nugget=1e-4, starting_lengths=(1.0,))
        for seed in range(8)
    ]
    log_ratio = [math.log(f.signal_variance / f.length_scale**3) for f in fits]
    assert np.mean(log_ratio) == pytest.approx(math.log(2.0 / 0.5**3), abs=4 * np.std(log_ratio) / math.sqrt(8))


def test_a_quadratic_log_likelihood_ends_at_the_bound_and_says_so():
    x, _ = data(100)
    y = -30 * (x**2).sum(axis=1)
    fit = fit_hyperparameters(x, y - y.mean(), kernel=MATERN, nugget=1e-5 * np.ptp(y))
    assert fit.at_bound
    assert fit.length_scale == pytest.approx(10.0)
    tighter = fit_hyperparameters(x, y - y.mean(), kernel=MATERN, nugget=1e-5 * np.ptp(y), length_scale_bound=2.0)
    assert tighter.length_scale == pytest.approx(2.0)
    assert tighter.log_evidence < fit.log_evidence


def test_duplicate_points_are_fitted():
    x, y = data(30)
    fit = fit_hyperparameters(np.repeat(x, 2, axis=0), np.repeat(y, 2), kernel=MATERN, nugget=1e-4)
    assert np.isfinite(fit.log_evidence)


def abnormal_stop(at):
    """Return a stand-in for the optimiser that gives up at the point `at`(objective's start)."""

    def minimise(fun, z0, **_):
        z = at(z0)
        value, slope = fun(z)
        return OptimizeResult(x=z, fun=value, jac=slope, success=False, nfev=1, message="ABNORMAL: ")

    return minimise


def test_an_abnormal_stop_at_a_maximum_is_accepted_and_recorded(monkeypatch):
    x, y = drawn(80, length=0.7, variance=2.0, nugget=1e-3, seed=3)
    fit = fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)
    best = np.log([fit.signal_variance / fit.length_scale**3, fit.length_scale])
    monkeypatch.setattr(hyperparameters, "minimize", abnormal_stop(lambda _: best))
    monkeypatch.setattr(hyperparameters, "_STEP", 1e-3)
    again = fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)
    assert again.message == "ABNORMAL: "
    assert again.verdict.startswith("accepted: projected gradient")


def test_an_abnormal_stop_elsewhere_is_an_error(monkeypatch):
    x, y = drawn(80, length=0.7, variance=2.0, nugget=1e-3, seed=3)
    monkeypatch.setattr(hyperparameters, "minimize", abnormal_stop(lambda z0: z0))
    with pytest.raises(NumericsError, match=r"ABNORMAL.*not a maximum"):
        fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)


def test_a_stop_where_the_covariance_breaks_down_is_refused_whatever_the_optimiser_says(monkeypatch):
    x, y = drawn(80, length=0.7, variance=2.0, nugget=1e-6, seed=3)
    smooth, search = KERNELS["squared_exponential"], hyperparameters.minimize

    def one_in_the_wall(fun, z0, **options):
        if z0[1] < math.log(1.0):
            return search(fun, z0, **options)
        value, slope = fun(np.array([30.0, math.log(10.0)]))
        return OptimizeResult(x=z0, fun=value, jac=slope, success=True, nfev=1, message="CONVERGENCE: ")

    monkeypatch.setattr(hyperparameters, "minimize", one_in_the_wall)
    fit = fit_hyperparameters(x, y, kernel=smooth, nugget=1e-6)
    assert [a.accepted for a in fit.attempts] == [True, False]
    assert "never positive definite" in fit.attempts[1].verdict
    with pytest.raises(NumericsError, match="never positive definite"):
        fit_hyperparameters(x, y, kernel=smooth, nugget=1e-6, starting_lengths=(3.0,))


def test_the_starting_variance_leaves_a_covariance_that_can_be_factorised():
    x, y = ridge(400)
    objective = hyperparameters.Objective(x, y, KERNELS["squared_exponential_ard"], 1e-6 * float(np.ptp(y)))
    found = objective.evidence(objective.starting_ratio(3.0), [math.log(3.0)] * 2)
    assert np.isfinite(found.value)


def unlike(number):
    """Return standardised inputs and a function of them in which the inputs matter unlike, as in a log-likelihood."""
    u = sobol(number, 7)
    shift, scale = standardisation(u)
    y = -40 * (u[:, 0] - 0.3 - 0.3 * u[:, 1] ** 2) ** 2 - 10 * (u[:, 2] * u[:, 3] - 0.2) ** 2
    y = y - 0.5 * u[:, 4] - 0.1 * u[:, 5] - np.sin(3 * u[:, 6])
    return (u - shift) / scale, y - y.mean()


def test_a_success_of_the_optimiser_on_a_slope_is_no_maximum_and_the_search_goes_on(monkeypatch):
    """Planted: from one of the starts a gain of 5 % counts as none, which the optimiser calls convergence."""
    x, y = unlike(250)
    options = {"kernel": KERNELS["matern32_product"], "nugget": 1e-5 * float(np.ptp(y)), "starting_lengths": (0.5, 3.0)}
    expected, optimise = fit_hyperparameters(x, y, **options), hyperparameters.minimize

    def hasty(function, z, *, options, **others):
        first = np.allclose(z[1:], np.log(0.5))
        return optimise(function, z, options={**options, "ftol": 0.05} if first else options, **others)

    monkeypatch.setattr(hyperparameters, "minimize", hasty)
    found = fit_hyperparameters(x, y, **options)
    assert [a.accepted for a in found.attempts] == [True, True]
    assert np.ptp([a.log_evidence for a in found.attempts]) < 0.01
    assert found.log_evidence == pytest.approx(expected.log_evidence, abs=0.01)
    monkeypatch.setattr(hyperparameters, "_TRIES", 1)
    short, _ = fit_hyperparameters(x, y, **options).attempts
    assert short.message.startswith("CONVERGENCE")
    assert short.verdict.startswith("not a maximum")
    assert short.log_evidence < expected.log_evidence - 100


def ridge(number):
    u = sobol(number, 2)
    shift, scale = standardisation(u)
    y = -2000 * (u[:, 0] * (1 + u[:, 1] ** 2) - 0.6) ** 2 - 300 * np.abs(u[:, 1] - 0.4) ** 1.5
    return (u - shift) / scale, y - y.mean()


def bowl(number):
    u = sobol(number, 7)
    shift, scale = standardisation(u)
    y = -30 * ((u - 0.5) ** 2).sum(axis=1)
    return (u - shift) / scale, y - y.mean()


@pytest.mark.parametrize(
    ("x_y", "name", "better"), [(ridge(60), "squared_exponential", 0), (bowl(50), "matern52_ard", 1)]
)
def test_neither_start_suffices_alone(x_y, name, better):
    nugget = 1e-5 * float(np.ptp(x_y[1]))
    fit = fit_hyperparameters(*x_y, kernel=KERNELS[name], nugget=nugget)
    ends = [a.log_evidence for a in fit.attempts]
    assert all(a.accepted for a in fit.attempts)
    assert ends[better] > ends[1 - better] + 5
    assert fit.log_evidence == ends[better]
    for a in fit.attempts:
        for factor in (0.9, 1.1):  # a maximum in the variance, and in all lengths inside their bounds
            same = {"length_scale": a.length_scale, "signal_variance": factor * a.signal_variance}
            moved = {**same, "length_scale": np.clip(factor * a.length_scale, 0.01, 10.0)}
            for at in (same, moved | {"signal_variance": a.signal_variance}):
                assert evidence(*x_y, kernel=KERNELS[name], nugget=nugget, **at).value < a.log_evidence + 1e-3


def test_too_few_runs():
    x, y = data(3)
    with pytest.raises(TooFewRuns, match="at least 4 for 2"):
        fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)
    assert fit_hyperparameters(*data(4), kernel=MATERN, nugget=1e-3).length_scale > 0


def test_constant_targets_have_nothing_to_teach():
    x, y = data(20)
    with pytest.raises(NumericsError, match="nothing to learn"):
        fit_hyperparameters(x, 0 * y, kernel=MATERN, nugget=0.0)


def test_a_value_that_is_not_finite_is_named():
    x, y = data(20)
    y[7] = -np.inf
    with pytest.raises(InvalidInput, match="training run 7"):
        fit_hyperparameters(x, y, kernel=MATERN, nugget=1e-3)
