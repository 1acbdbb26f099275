"""Adaptive importance sampling, the log-evidence with its errors, and models compared by it, against quadrature."""

import math
from functools import cache

import numpy as np
import pytest
from scipy.special import logsumexp, softmax
from scipy.stats import multivariate_normal
from tests.unit.calibration.arches import SD, SPACE, TRACKED, Exact, arch, knowledge, seen

from strandline.calibration import importance_sampler
from strandline.calibration.evidence import CANNOT_TELL, Evidence, ModelComparison, averaged, in_words, log_evidence
from strandline.calibration.importance_sampler import Pool, followed
from strandline.calibration.what_if import interim_posterior
from strandline.design import sobol
from strandline.design.active import Knowledge
from strandline.discrepancy import NormalOffset
from strandline.interface import GaussianNoise, Observation, PointErrors
from strandline.likelihood import InterfaceLikelihood
from strandline.posterior import Weighted
from strandline.posterior.quadrature import integrate

MEAN, COVARIANCE = np.array([0.4, 0.55]), np.array([[0.0004, 0.0003], [0.0003, 0.0009]])


def gaussian(mean, covariance):
    return lambda x: np.asarray(multivariate_normal(mean, covariance).logpdf(x), float).reshape(len(x))


def sampled(target, *, seed=1, enough=400.0):
    """Sample a target on the unit cube."""

    def log_densities(x):
        inside = ((x >= 0) & (x <= 1)).all(axis=1)
        return np.where(inside, 0.0, -np.inf), np.where(inside, target(x), -np.inf)

    x = sobol(1024, 2, scramble=seed)
    pool = Pool(x, np.zeros(1024), np.zeros(1024), target(x), 1024)
    found = followed(pool, log_densities, np.random.default_rng(seed), enough=enough)
    return None if found is None else found.weighted


def scores(seeds):
    """Return errors of means and of standard deviations in units of what their effective sizes allow."""
    out, sd = [], np.sqrt(np.diag(COVARIANCE))
    for seed in range(seeds):
        found = sampled(gaussian(MEAN, COVARIANCE), seed=seed)
        size = 1 / np.sum(found.weights**2)
        out.append([*(found.mean - MEAN) / sd * np.sqrt(size), *(found.sd / sd - 1) * np.sqrt(2 * size)])
    return np.array(out)


def test_moments_of_a_narrow_gaussian(monkeypatch):
    """Planted: draws of the fitted mixtures weighted as if they came from the prior."""
    found = scores(12)
    assert np.abs(found.mean(axis=0)).max() < 1.0
    assert np.sqrt(np.mean(found**2)) < 1.5
    np.testing.assert_array_equal(scores(1), found[:1])
    wrong = property(lambda pool: pool.log_target - logsumexp(pool.log_target))
    monkeypatch.setattr(Pool, "log_weights", wrong)
    assert np.abs(scores(4)[:, 2:].mean(axis=0)).max() > 3.0


def test_two_modes_keep_their_shares():
    """Modes 20 standard deviations apart, the narrower one with 30 % of the mass."""
    one, other = (gaussian(np.array(at), sd**2 * np.eye(2)) for at, sd in (([0.25, 0.3], 0.01), ([0.7, 0.6], 0.025)))
    found = [sampled(lambda x: np.logaddexp(np.log(0.3) + one(x), np.log(0.7) + other(x)), seed=k) for k in range(8)]
    shares = [one.weights[one.draws[:, 0] < 0.45].sum() for one in found]
    assert np.mean(shares) == pytest.approx(0.3, abs=0.03)


def test_what_is_wide_needs_no_round_and_what_is_not_reached_is_said(monkeypatch):
    assert sampled(gaussian(MEAN, COVARIANCE), enough=1e7) is None
    monkeypatch.setattr(importance_sampler, "fitted", None)
    assert len(sampled(gaussian(np.full(2, 0.5), 0.2**2 * np.eye(2))).draws) == 1024


@cache
def learnt(runs=24, scramble=3, sd=SD):
    observation = Observation(seen(PointErrors(sd)), PointErrors(sd))
    return knowledge(NormalOffset(), {"": observation}, runs=runs, scramble=scramble)


def rough(known):
    """Return weighted draws of the prior as a posterior."""
    x = SPACE.prior_quantiles(np.random.default_rng(0).random((2000, 2)))
    return Weighted(x, np.asarray(softmax(known.plug_in(x))))


def found_by(known, seed):
    return log_evidence(known, SPACE, rough(known), np.random.default_rng(seed))


def quadrature(known):
    """Return the integral of log L p by other functions than those that importance sampling calls."""

    def log_density(x):
        plug_in = known.likelihood.plug_in(x)
        expected = plug_in + known.likelihood.gain(x, plug_in) + known.log_feasibility(x)
        return np.asarray(expected - np.log(np.prod(SPACE.high - SPACE.low)))

    return integrate(log_density, SPACE.low, SPACE.high)


def true_log_evidence(known):
    """Return the log-evidence of the arches themselves, by Gauss–Legendre quadrature where the posterior lies."""
    likelihood, where = InterfaceLikelihood(known.likelihood.observations, NormalOffset()), quadrature(known)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    low, high = (SPACE.to_unit(where.mean + side * where.sd) for side in (-6, 6))
    assert 0 < low.min() < high.max() < 1
    u = [a + (b - a) * 0.5 * (nodes + 1) for a, b in zip(low, high, strict=True)]
    values = np.array([[likelihood(arch(SPACE.to_physical(np.array([a, b])))) for b in u[1]] for a in u[0]])
    return float(logsumexp(values + np.log(0.25 * np.prod(high - low) * np.outer(weights, weights))))


@pytest.mark.repeats
def test_sampling_errors_are_what_they_say(monkeypatch):
    """Against quadrature of the same surrogate. Planted: the prior is not counted; draws are counted twice."""
    good, exact = learnt(), quadrature(learnt()).log_evidence

    def z(seeds):
        found = [found_by(good, seed) for seed in range(seeds)]
        return np.array([(one.log - exact) / one.sampling for one in found])

    right = z(5)
    assert abs(right.mean()) < 1.2
    assert 0.3 < right.std() < 2.0
    plain, ratios = Knowledge.nearly_expected, Pool.log_ratios.fget
    with monkeypatch.context() as planted:
        planted.setattr(Knowledge, "nearly_expected", lambda self, x: plain(self, x) - np.asarray(SPACE.log_prior(x)))
        assert abs(z(2).mean()) > 3
    monkeypatch.setattr(Pool, "log_ratios", property(lambda self: ratios(self) + np.log1p(1 / 5)))
    assert abs(z(2).mean()) > 3


def test_it_is_that_of_the_true_model_and_a_poor_surrogate_says_how_far_it_may_be_off():
    """Of few runs, for small errors of the data. Planted: only the finite number of draws counts."""
    found = found_by(learnt(), 1)
    assert found.log == pytest.approx(true_log_evidence(learnt()), abs=3 * found.error + 0.01)
    assert found.error < 0.1
    true = true_log_evidence(learnt(24, 3, 0.0005))
    found = [found_by(learnt(6, scramble, 0.0005), scramble) for scramble in range(5)]
    off = np.array([one.log - true for one in found])
    assert np.sqrt(np.mean((off / [one.error for one in found]) ** 2)) < 2.0
    assert np.sqrt(np.mean((off / [one.sampling for one in found]) ** 2)) > 2.0
    assert np.median([one.surrogate for one in found]) < 1.0, "no error is so large that it says nothing"


def test_the_posterior_so_far_is_that_of_the_true_model():
    observation = Observation(seen(PointErrors(SD)), GaussianNoise((5 * SD) ** 2))
    known, exact = knowledge(TRACKED, {"": observation}), Exact(SPACE, (observation,))
    found = interim_posterior(known, SPACE, seed=1)
    assert np.abs((found.mean - exact.mean) / exact.sd).max() < 0.1
    assert np.abs(np.log(found.sd / exact.sd)).max() < 0.08
    assert found.log_evidence == pytest.approx(exact.log_evidence, abs=0.1)


def test_words_of_the_scale_and_a_winner_beats_every_other_one():
    """From 1, 3 and 5 on; none below two errors, or of what is no number. Two are tied; one wins; one is uncertain."""
    scale = {0.999: CANNOT_TELL, 1.0: "positive", -1.0: "positive", 2.999: "positive", 3.0: "strong"}
    assert {ln: in_words(ln, 0.1) for ln in scale} == scale
    assert in_words(5.0, 2.5) == in_words(math.inf, 0.1) == "very strong"
    assert {in_words(*given) for given in ((5.0, 2.51), (math.nan, 0.1), (3.0, math.nan))} == {CANNOT_TELL}
    for b, c, favoured, tied, verdict in (
        (-4.6, (-9.5, 0.1), None, "ab", "The data cannot tell a and b apart: ln B = 0.60 ± 0.14 of a over b, below 1."),
        (-6.0, (-9.5, 0.1), "a", "a", "The data favour a over b: ln B = 2.00 ± 0.14, positive evidence."),
        (-6.0, (-8.0, 3.0), None, "ac", "The data cannot tell a and c apart: ln B = 4.00 ± 3.00 of a over c, less"),
    ):
        found = ModelComparison({"a": Evidence(-4.0, 0.1), "b": Evidence(b, 0.1), "c": Evidence(*c)})
        assert (found.favoured, "".join(found.tied)) == (favoured, tied)
        assert found.verdict.startswith(verdict)


def test_the_average_has_the_moments_of_the_mixture():
    random, parts = np.random.default_rng(1), []
    for centre, number in ((0.0, 400), (3.0, 700)):
        weights = random.random(number)
        parts.append(Weighted(centre + random.standard_normal((number, 2)), weights / weights.sum()))
    found, (one, other) = averaged(parts, [0.2, 0.8]), parts
    np.testing.assert_allclose(found.mean, 0.2 * one.mean + 0.8 * other.mean)
    between = 0.2 * 0.8 * (one.mean - other.mean) ** 2
    np.testing.assert_allclose(found.sd**2, 0.2 * one.sd**2 + 0.8 * other.sd**2 + between)
