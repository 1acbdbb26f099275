"""The log-evidence against quadrature of the surrogate and of the true model, and its errors."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.special import logsumexp, softmax
from tests.unit.calibration.arches import SD, SPACE, arch, knowledge, seen

from strandline.calibration import evidence
from strandline.calibration.evidence import Evidence, log_evidence, surrogate_error
from strandline.calibration.importance_sampler import Pool
from strandline.design.active import Knowledge
from strandline.discrepancy import NormalOffset
from strandline.interface import Observation, PointErrors
from strandline.likelihood import InterfaceLikelihood
from strandline.posterior import systematic_indices
from strandline.posterior.quadrature import QuadratureResult, integrate
from strandline.posterior.weighted import Weighted


@cache
def learnt(runs: int = 24, scramble: int = 3, sd: float = SD) -> Knowledge:
    return knowledge(
        NormalOffset(), {"": Observation(seen(PointErrors(sd)), PointErrors(sd))}, runs=runs, scramble=scramble
    )


def rough(log_likelihood: Callable[[np.ndarray], np.ndarray], number: int = 2000) -> Weighted:
    """Return weighted draws of the prior as a posterior."""
    x = SPACE.prior_quantiles(np.random.default_rng(0).random((number, 2)))
    return Weighted(x, np.asarray(softmax(log_likelihood(x))))


def found_by(knowledge: Knowledge, seed: int) -> Evidence:
    return log_evidence(knowledge, SPACE, rough(knowledge.plug_in), np.random.default_rng(seed))


def quadrature(knowledge: Knowledge) -> QuadratureResult:
    """Return the integral of log L p by other functions than those that importance sampling calls."""

    def log_density(x: np.ndarray) -> np.ndarray:
        plug_in = knowledge.likelihood.plug_in(x)
        expected = plug_in + knowledge.likelihood.gain(x, plug_in) + knowledge.log_feasibility(x)
        return np.asarray(expected - np.log(np.prod(SPACE.high - SPACE.low)))

    return integrate(log_density, SPACE.low, SPACE.high)


def true_log_evidence(knowledge: Knowledge) -> float:
    """Return the log-evidence of the arches themselves, by Gauss–Legendre quadrature where the posterior lies."""
    likelihood, where = InterfaceLikelihood(knowledge.likelihood.observations, NormalOffset()), quadrature(knowledge)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    low, high = (SPACE.to_unit(where.mean + side * where.sd) for side in (-6, 6))
    assert (low > 0).all()
    assert (high < 1).all()
    u = [a + (b - a) * 0.5 * (nodes + 1) for a, b in zip(low, high, strict=True)]
    values = np.array([[likelihood(arch(SPACE.to_physical(np.array([a, b])))) for b in u[1]] for a in u[0]])
    return float(logsumexp(values + np.log(0.25 * np.prod(high - low) * np.outer(weights, weights))))


def test_sampling_errors_are_what_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against quadrature of the same surrogate. Planted: the prior is not counted; draws are counted twice."""
    good, exact = learnt(), quadrature(learnt()).log_evidence

    def z(seeds: int) -> np.ndarray:
        found = [found_by(good, seed) for seed in range(seeds)]
        return np.array([(one.log - exact) / one.sampling for one in found])

    right = z(5)
    assert abs(right.mean()) < 1.2
    assert 0.3 < right.std() < 2.0
    plain, ratios = Knowledge.nearly_expected, Pool.log_ratios.fget
    assert ratios is not None
    with monkeypatch.context() as planted:
        planted.setattr(Knowledge, "nearly_expected", lambda self, x: plain(self, x) - np.asarray(SPACE.log_prior(x)))
        assert abs(z(2).mean()) > 3
    monkeypatch.setattr(Pool, "log_ratios", property(lambda self: ratios(self) + np.log1p(1 / 5)))
    assert abs(z(2).mean()) > 3


def test_it_is_that_of_the_true_model() -> None:
    found = found_by(learnt(), 1)
    assert found.log == pytest.approx(true_log_evidence(learnt()), abs=3 * found.error + 0.01)
    assert found.error < 0.1
    assert found.error == pytest.approx(np.sqrt(found.sampling**2 + found.surrogate**2 + found.failing**2))
    assert repr(Evidence(-4.3839, 0.011, 0.0, 0.027)) == "<Evidence: log -4.384 ± 0.029>"


def test_a_poor_surrogate_says_how_far_the_evidence_may_be_off() -> None:
    """Of few runs, for small errors of the data. Planted: only the finite number of draws counts."""
    true = true_log_evidence(learnt(24, 3, 0.0005))
    found = [found_by(learnt(6, scramble, 0.0005), scramble) for scramble in range(5)]
    off = np.array([one.log - true for one in found])
    assert np.sqrt(np.mean((off / [one.error for one in found]) ** 2)) < 2.0
    assert np.sqrt(np.mean((off / [one.sampling for one in found]) ** 2)) > 2.0
    assert np.median([one.surrogate for one in found]) < 1.0, "no error is so large that it says nothing"


def test_the_error_grows_with_the_square_root_of_the_variance(monkeypatch: pytest.MonkeyPatch) -> None:
    """For small errors, the sd of ln Z is proportional to that of the field."""
    some = rough(learnt().plug_in)
    chosen, counts = np.unique(systematic_indices(some.weights, 60, np.random.default_rng(1)), return_counts=True)
    given = learnt(), some.draws[chosen], counts / 60
    small, root = surrogate_error(*given, np.random.default_rng(2)), evidence._root
    monkeypatch.setattr(evidence, "_root", lambda covariance: 2 * root(covariance))
    assert surrogate_error(*given, np.random.default_rng(2)) == pytest.approx(2 * small, rel=0.1)
