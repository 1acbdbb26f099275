"""Integrals over inputs against closed forms: adaptive cubature, and Sobol' indices."""

import math

import numpy as np
import pytest
from tests.densities import banana, gaussian, linear_exponential, truncated_gaussian, uniform

from strandline.foundations import InvalidInput, NumericsError
from strandline.parameters import LogNormal, Parameter, ParameterSpace, Uniform
from strandline.posterior import SobolIndices, sobol_indices
from strandline.posterior.quadrature import _Rule, integrate, mixture

TARGETS = {
    "one dimension": gaussian(np.array([3.0]), np.array([[0.25]])),
    "tilted": gaussian(np.array([1.0, -2.0]), np.array([[1.0, 0.95], [0.95, 1.0]])),
    "banana": banana(centre=0.3, sd=1.0, bend=0.3, width=0.1),
    "narrow banana": banana(centre=1.0, sd=1.0, bend=0.5, width=0.43),
    "uniform": uniform(np.array([1.0, 2.0]), np.array([2.0, 5.0])),
    "cut at its mode": truncated_gaussian(*np.array([[0.0, 1.0], [1.0, 0.1], [0.0, 0.95], [5.0, 3.0]])),
    "corner": linear_exponential(np.array([3.0, 200.0])),
    "three dimensions": gaussian(np.array([1.0, 2.0, 3.0]), np.diag([1.0, 4.0, 9.0]) + 0.8),
}


def found_of(target, log_density=None, **options):
    return integrate(log_density or target.log_posterior, target.low, target.high, **options)


def assert_known(found, target):
    """Compare with the closed form, within the tolerances promised."""
    sd = np.sqrt(np.diagonal(target.covariance))
    assert found.converged
    assert found.log_evidence == pytest.approx(target.log_evidence, abs=1e-3)
    np.testing.assert_allclose(found.mean / sd, target.mean / sd, atol=2e-3)
    np.testing.assert_allclose(found.covariance / np.outer(sd, sd), target.covariance / np.outer(sd, sd), atol=4e-3)


def test_closed_forms_with_errors_that_are_not_underestimated():
    for target in TARGETS.values():
        found, sd = found_of(target), np.sqrt(np.diagonal(target.covariance))
        assert_known(found, target)
        assert abs(found.log_evidence - target.log_evidence) <= found.error_log_evidence + 1e-9
        assert np.abs((found.mean - target.mean) / sd).max() <= found.error_mean + 1e-9
        assert np.abs(found.sd / sd - 1).max() <= found.error_sd + 1e-9
        for d, marginal in enumerate(found.marginals):
            centres, width = 0.5 * (marginal.edges[1:] + marginal.edges[:-1]), np.diff(marginal.edges)
            assert marginal.density @ width == pytest.approx(1.0)
            assert (marginal.density * width) @ centres == pytest.approx(target.mean[d], abs=0.5 * width[0])
        first = found_of(target, maximum_evaluations=1)
        assert (first.converged, first.levels) == (False, 0), "the first grid alone is never called converged"


def test_a_wrong_density_fails_the_same_comparison():
    target = TARGETS["banana"]
    for wrong in (
        lambda x: target.log_posterior(x) + 0.01,
        lambda x: 1.02 * target.log_likelihood(x) + target.log_prior(x),
    ):
        found = found_of(target, wrong)
        assert found.converged
        with pytest.raises(AssertionError):
            assert_known(found, target)


def test_huge_and_tiny_densities_neither_overflow_nor_vanish_and_calls_of_one_size_are_counted():
    target, sizes = TARGETS["tilted"], set()

    def shifted(x, shift):
        sizes.add(len(x))
        return target.log_posterior(x) + shift

    for shift in (-1e5, 1e5):
        found = found_of(target, lambda x, s=shift: shifted(x, s), batch=5000)
        assert found.log_evidence - shift == pytest.approx(target.log_evidence, abs=1e-3)
    assert sizes == {5000}
    asked = []
    rule = _Rule(lambda x: asked.append(len(x)) or -(x**2).sum(axis=1), np.zeros(1), np.ones(1), 1)
    rule.cells(np.zeros((1, 1)), np.ones(1))
    assert rule.evaluations == sum(asked)


def test_a_narrow_ridge_is_found_wherever_it_lies_and_a_jump_that_is_not_resolved_is_reported():
    """The ridge is no wider than a fiftieth of the box."""
    for centre in np.linspace(0.4, 0.43, 4):
        ridge = lambda x, at=centre: -0.5 * ((x[:, 1] - at - 0.3 * x[:, 0] ** 2) / 0.005) ** 2  # noqa: E731
        found = integrate(ridge, np.zeros(2), np.ones(2))
        assert found.converged
        assert found.log_evidence == pytest.approx(math.log(0.005 * math.sqrt(2 * math.pi)), abs=1e-3)
        assert found.mean[1] == pytest.approx(centre + 0.1, abs=1e-4)
    disc = lambda x: np.where((x**2).sum(axis=1) < 0.5, 0.0, -np.inf)  # noqa: E731
    found = integrate(disc, -np.ones(2), np.ones(2), maximum_evaluations=100_000)
    assert not found.converged
    assert found.evaluations <= 100_000
    assert abs(found.log_evidence - math.log(0.5 * math.pi)) < found.error_log_evidence
    node = 0.5 * (np.polynomial.legendre.leggauss(4)[0][1] + 1) / 256
    found = integrate(lambda x: np.where(np.abs(x[:, 0] - node) < 1e-9, 0.0, -1e6), np.zeros(1), np.ones(1))
    assert not found.converged, "only one point of the first grid meets the peak"
    assert np.isfinite(found.log_evidence)


def test_tighter_tolerances_cost_more_and_give_more_and_a_marginal_is_the_known_density():
    target = TARGETS["narrow banana"]
    found = [found_of(target, rtol=t, mean_tolerance=t, sd_tolerance=t) for t in (1e-2, 1e-4, 1e-6)]
    assert found[0].evaluations < found[1].evaluations < found[2].evaluations
    assert found[2].log_evidence == pytest.approx(target.log_evidence, abs=1e-7)
    marginal = found_of(TARGETS["banana"]).marginals[0]
    cumulative = [0.5 * (1 + math.erf((e - 0.3) / math.sqrt(2))) for e in marginal.edges]
    np.testing.assert_allclose(marginal.density * np.diff(marginal.edges), np.diff(cumulative), atol=1e-4)


def test_what_is_refused():
    for low, high, words in (([0] * 4, [1] * 4, "Sequential"), ([0, 0], [1, 0], "box"), ([0], [np.inf], "box")):
        with pytest.raises(InvalidInput, match=words):
            integrate(lambda x: 0 * x[:, 0], np.array(low, float), np.array(high, float))
    for value, words in ((np.nan, r"is nan at \[1\.9[0-9]*, 3"), (np.inf, "is inf at"), (-np.inf, "zero at all")):
        density = lambda x, value=value: np.where((x[:, 0] > 1.9) | (value < 0), value, 0.0)  # noqa: E731
        with pytest.raises(NumericsError, match=words):
            integrate(density, np.array([0.0, 3.0]), np.array([2.0, 4.0]))


def test_a_mixture_has_the_moments_of_its_parts():
    """Two normals of equal weight, against their closed form; leaving out how far apart they lie must be caught."""
    first = gaussian(np.array([1.0, -2.0]), np.array([[1.0, 0.5], [0.5, 1.0]]))
    second = gaussian(np.array([3.0, -1.0]), np.diag([0.5, 2.0]))
    low, high = np.minimum(first.low, second.low), np.maximum(first.high, second.high)
    found = mixture([integrate(one.log_likelihood, low, high) for one in (first, second)])
    apart, within = second.mean - first.mean, 0.5 * (first.covariance + second.covariance)
    np.testing.assert_allclose(found.mean, 0.5 * (first.mean + second.mean), atol=0.005)
    np.testing.assert_allclose(found.covariance, within + 0.25 * np.outer(apart, apart), atol=0.01)
    assert np.abs(found.covariance - within).max() > 0.2


CUBE = ParameterSpace(tuple(Parameter(name, Uniform(-math.pi, math.pi)) for name in "abc"))
ONE, TWO, TOGETHER = 0.5 * (1 + 0.1 * math.pi**4 / 5) ** 2, 7.0**2 / 8, 8 * 0.1**2 * math.pi**8 / 225
FIRST, TOTAL = np.array([[ONE, TWO, 0.0], [ONE + TOGETHER, TWO, TOGETHER]]) / (ONE + TWO + TOGETHER)
"""Ishigami and Homma's closed form of the first-order and the total indices of their function with 7 and 0.1."""


def ishigami(x):
    return np.sin(x[:, 0]) * (1 + 0.1 * x[:, 2] ** 4) + 7.0 * np.sin(x[:, 1]) ** 2


def misses(found):
    """Tell for each index whether it lies further from the known one than twice its bootstrap interval reaches."""
    half = 0.5 * np.array([found.first_high - found.first_low, found.total_high - found.total_low])
    return (np.abs([found.first - FIRST, found.total - TOTAL]) > 2.0 * half).ravel().tolist()


def test_the_function_of_ishigami_and_homma():
    """Planted: first-order and total indices interchanged."""
    found = sobol_indices(ishigami, CUBE, resamples=50)
    assert misses(found) == [False] * 6
    assert max(*(found.first_high - found.first_low), *(found.total_high - found.total_low)) < 0.15
    low, high, total = found.first_low, found.first_high, found.total
    missed = misses(SobolIndices(total, found.total_low, found.total_high, found.first, low, high, 0))
    assert [missed[0], missed[2], missed[5]] == [True] * 3


def test_inputs_vary_by_their_priors_and_a_function_without_variance_has_no_indices():
    """Of log a + b the shares are the variances: a is log-normal, b uniform."""
    space = ParameterSpace((Parameter("a", LogNormal(1.0, 0.3), box=(0.01, 100.0)), Parameter("b", Uniform(0.0, 0.6))))
    found = sobol_indices(lambda x: np.log(x[:, 0]) + x[:, 1], space, resamples=2)
    share = 0.09 / (0.09 + 0.36 / 12)
    np.testing.assert_allclose([found.first, found.total], [[share, 1 - share]] * 2, atol=0.01)
    for value in (1.0, np.nan):
        with pytest.raises(NumericsError, match="constant or not finite under the prior"):
            sobol_indices(lambda x, value=value: np.full(len(x), value), CUBE)
