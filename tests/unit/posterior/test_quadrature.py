"""Adaptive cubature against closed forms, and at its limits."""

import math

import numpy as np
import pytest

from strandline.errors import InvalidInput, NumericsError
from strandline.posterior.quadrature import _Cells, integrate, mixture
from strandline.testing import densities

TARGETS = {
    "one dimension": densities.gaussian(np.array([3.0]), np.array([[0.25]])),
    "tilted": densities.gaussian(np.array([1.0, -2.0]), np.array([[1.0, 0.95], [0.95, 1.0]])),
    "banana": densities.banana(centre=0.3, sd=1.0, bend=0.3, width=0.1),
    "narrow banana": densities.banana(centre=1.0, sd=1.0, bend=0.5, width=0.43),
    "uniform": densities.uniform(np.array([1.0, 2.0]), np.array([2.0, 5.0])),
    "cut at its mode": densities.truncated_gaussian(
        np.array([0.0, 1.0]), np.array([1.0, 0.1]), np.array([0.0, 0.95]), np.array([5.0, 3.0])
    ),
    "corner": densities.linear_exponential(np.array([3.0, 200.0])),
    "three dimensions": densities.gaussian(np.array([1.0, 2.0, 3.0]), np.diag([1.0, 4.0, 9.0]) + 0.8),
    "three, corner": densities.linear_exponential(np.array([3.0, 50.0, 0.1])),
}


def assert_known(found, target):
    """Compare with the closed form, within the tolerances promised."""
    sd = np.sqrt(np.diagonal(target.covariance))
    assert found.log_evidence == pytest.approx(target.log_evidence, abs=1e-3)
    np.testing.assert_allclose(found.mean / sd, target.mean / sd, atol=2e-3)
    np.testing.assert_allclose(found.sd / sd, 1.0, atol=2e-3)
    np.testing.assert_allclose(found.covariance / np.outer(sd, sd), target.covariance / np.outer(sd, sd), atol=4e-3)


def test_closed_forms_with_errors_that_are_not_underestimated():
    for target in TARGETS.values():
        found = integrate(target.log_posterior, target.low, target.high)
        assert found.converged
        assert_known(found, target)
        sd = np.sqrt(np.diagonal(target.covariance))
        assert abs(found.log_evidence - target.log_evidence) <= found.error_log_evidence + 1e-9
        assert np.abs((found.mean - target.mean) / sd).max() <= found.error_mean + 1e-9
        assert np.abs(found.sd / sd - 1).max() <= found.error_sd + 1e-9
        for d, marginal in enumerate(found.marginals):
            centres, width = 0.5 * (marginal.edges[1:] + marginal.edges[:-1]), np.diff(marginal.edges)
            assert marginal.density @ width == pytest.approx(1.0)
            assert (marginal.density * width) @ centres == pytest.approx(target.mean[d], abs=0.5 * width[0])
        first = integrate(target.log_posterior, target.low, target.high, maximum_evaluations=1)
        assert (first.converged, first.levels) == (False, 0), "the first grid alone is never called converged"


def test_a_wrong_density_fails_the_same_comparison():
    target = TARGETS["banana"]
    for wrong in (
        lambda x: target.log_posterior(x) + 0.01,
        lambda x: target.log_posterior(x) + 0.01 * x[:, 0],
        lambda x: 1.02 * target.log_likelihood(x) + target.log_prior(x),
    ):
        found = integrate(wrong, target.low, target.high)
        assert found.converged
        with pytest.raises(AssertionError):
            assert_known(found, target)


def test_a_ridge_no_wider_than_a_fiftieth_of_the_box_is_found_wherever_it_lies():
    for centre in np.linspace(0.4, 0.43, 4):

        def ridge(x, centre=centre):
            return -0.5 * ((x[:, 1] - centre - 0.3 * x[:, 0] ** 2) / 0.005) ** 2

        found = integrate(ridge, np.zeros(2), np.ones(2))
        assert found.converged
        assert found.log_evidence == pytest.approx(math.log(0.005 * math.sqrt(2 * math.pi)), abs=1e-3)
        assert found.mean[1] == pytest.approx(centre + 0.1, abs=1e-4)


def test_huge_and_tiny_densities_neither_overflow_nor_vanish_and_every_call_has_the_same_size():
    target, sizes = TARGETS["tilted"], set()

    def shifted(x, shift):
        sizes.add(len(x))
        return target.log_posterior(x) + shift

    for shift in (-1e5, 1e5):
        found = integrate(lambda x, s=shift: shifted(x, s), target.low, target.high, batch=5000)
        assert found.log_evidence - shift == pytest.approx(target.log_evidence, abs=1e-3)
    assert sizes == {5000}


def test_tighter_tolerances_cost_more_and_give_more():
    target = TARGETS["narrow banana"]
    options = [{"rtol": t, "mean_tolerance": t, "sd_tolerance": t} for t in (1e-2, 1e-4, 1e-6)]
    found = [integrate(target.log_posterior, target.low, target.high, **o) for o in options]
    assert found[0].evaluations < found[1].evaluations < found[2].evaluations
    assert found[2].error_log_evidence <= 1e-6
    assert found[2].log_evidence == pytest.approx(target.log_evidence, abs=1e-7)


def test_a_jump_that_is_not_resolved_is_reported():
    def disc(x):
        return np.where((x**2).sum(axis=1) < 0.5, 0.0, -np.inf)

    found = integrate(disc, -np.ones(2), np.ones(2), maximum_evaluations=100_000)
    assert not found.converged
    assert found.evaluations <= 100_000
    assert abs(found.log_evidence - math.log(0.5 * math.pi)) < found.error_log_evidence


def test_a_marginal_is_the_known_density():
    target = TARGETS["banana"]
    marginal = integrate(target.log_posterior, target.low, target.high).marginals[0]
    cumulative = [0.5 * (1 + math.erf((e - 0.3) / math.sqrt(2))) for e in marginal.edges]
    np.testing.assert_allclose(marginal.density * np.diff(marginal.edges), np.diff(cumulative), atol=1e-4)


def test_what_is_refused():
    for low, high, words in (
        (np.zeros(4), np.ones(4), "Sequential Monte Carlo"),
        (np.zeros(2), np.array([1.0, 0.0]), "box"),
        (np.zeros(1), np.array([np.inf]), "box"),
    ):
        with pytest.raises(InvalidInput, match=words):
            integrate(lambda x: 0 * x[:, 0], low, high)
    for value, words in ((np.nan, "is nan at"), (np.inf, "is inf at"), (-np.inf, "zero at all")):
        with pytest.raises(NumericsError, match=words):
            integrate(lambda x, value=value: np.full(len(x), value), np.zeros(1), np.ones(1))
    with pytest.raises(NumericsError, match=r"is nan at \[1\.9[0-9]*, 3"):
        integrate(lambda x: np.where(x[:, 0] > 1.9, np.nan, 0.0), np.array([0.0, 3.0]), np.array([2.0, 4.0]))


def test_another_unit_leaves_integrals_and_their_errors_what_they_are():
    random = np.random.default_rng(1)
    cells = _Cells(np.zeros((3, 1)), np.ones(3), random.random((3, 3)), random.random((3, 3)), 0.7)
    found = cells.rescaled(2.0)
    for one, other in ((cells.integral, found.integral), (cells.difference, found.difference)):
        np.testing.assert_allclose(one * math.exp(0.7), other * math.exp(2.0))


def test_a_mixture_has_the_moments_of_its_parts():
    """Two normals of equal weight, against their closed form; leaving out how far apart they lie must be caught."""
    first = densities.gaussian(np.array([1.0, -2.0]), np.array([[1.0, 0.5], [0.5, 1.0]]))
    second = densities.gaussian(np.array([3.0, -1.0]), np.diag([0.5, 2.0]))
    low, high = np.minimum(first.low, second.low), np.maximum(first.high, second.high)
    parts = [integrate(t.log_likelihood, low, high) for t in (first, second)]
    found = mixture(parts)
    apart = second.mean - first.mean
    within = 0.5 * (first.covariance + second.covariance)
    np.testing.assert_allclose(found.mean, 0.5 * (first.mean + second.mean), atol=0.005)
    np.testing.assert_allclose(found.covariance, within + 0.25 * np.outer(apart, apart), atol=0.01)
    assert np.abs(found.covariance - within).max() > 0.2
    evidence = 0.5 * sum(math.exp(part.log_evidence) for part in parts)
    assert found.log_evidence == pytest.approx(math.log(evidence))
    assert found.evaluations == sum(part.evaluations for part in parts)
    assert found.converged
    for marginal in found.marginals:
        assert marginal.density @ np.diff(marginal.edges) == pytest.approx(1.0)
