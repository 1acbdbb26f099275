"""The posterior of one specimen against quadrature, its certificate against perturbed fields, its random numbers."""

from dataclasses import replace
from functools import cache

import numpy as np
from tests.unit.calibration.arches import SD, SPACE, arch, knowledge, seen

from strandline.discrepancy import NormalOffset
from strandline.interface import Observation, PointErrors
from strandline.likelihood import FieldLikelihood
from strandline.questions import specimen as module
from strandline.questions.specimen import Start, posterior_of, runs_for

ERRORS = PointErrors(SD)
OUTLINE = Observation(ERRORS.draw(arch(np.array([0.33, 0.12])), np.random.default_rng(3)), ERRORS)
U = (np.arange(161) + 0.5) / 161


@cache
def begin(widening=1.0):
    """Return a start whose surrogate expects larger errors by a factor of their variance."""
    known = knowledge(NormalOffset(), {"": Observation(seen(ERRORS), ERRORS)})
    wider = tuple(replace(process, widening=widening * process.widening) for process in known.surrogate.processes)
    likelihood = replace(known.likelihood, surrogate=replace(known.surrogate, processes=wider))
    return Start(replace(known, likelihood=likelihood), SPACE)


def found(of=None, errors=ERRORS, name="one", seed=1):
    observed = replace(OUTLINE, noise=errors)
    return posterior_of(of or begin(), (observed,), NormalOffset(), name=name, seed=seed)


def square(u):
    return np.stack(np.meshgrid(u, u, indexing="ij"), axis=-1).reshape(-1, 2)


def by_quadrature(x, off=0.0):
    """Return mean and covariance by quadrature, with fields that are off by some coefficients."""
    likelihood = FieldLikelihood(begin().knowledge.surrogate, (OUTLINE,), NormalOffset())
    values = likelihood.at(likelihood.surrogate.mean(x) + off)
    weights = np.exp(values - values.max())
    weights /= weights.sum()
    mean = weights @ x
    return mean, (weights[:, None] * (x - mean)).T @ (x - mean)


def test_mean_and_covariance_are_those_of_quadrature():
    """Planted: errors that are 1.4 times too large."""
    mean, covariance = by_quadrature(SPACE.to_physical(square(U)))
    sd = np.sqrt(np.diag(covariance))
    for errors, right in ((ERRORS, True), (PointErrors(1.4 * SD), False)):
        one = found(errors=errors)
        assert bool(np.abs((one.covariance - covariance) / np.outer(sd, sd)).max() < 0.1) is right
        assert not right or np.abs((one.mean - mean) / sd).max() < 0.06
        np.testing.assert_allclose(one.draws.mean(axis=0), one.mean, atol=1e-9)


def test_known_inputs_are_held_fixed():
    one = found(begin().with_given({"lean": 0.12}))
    heights = SPACE.low[0] + U * (SPACE.high[0] - SPACE.low[0])
    mean, covariance = by_quadrature(np.stack([heights, np.full(len(U), 0.12)], axis=1))
    sd = float(np.sqrt(covariance[0, 0]))
    assert np.abs([(one.mean[0] - mean[0]) / sd, one.sd[0] / sd - 1]).max() < 0.06


def test_it_depends_on_name_and_seed_alone():
    first, second, again = (found(name=name) for name in "aba")
    np.testing.assert_array_equal(again.draws, first.draws)
    for other in (second, found(name="a", seed=2)):
        assert not np.array_equal(other.draws, first.draws)


def test_tempering_takes_over_from_importance_sampling(monkeypatch):
    one = found()
    monkeypatch.setattr(module.calibration, "followed", lambda *given, **how: None)
    tempered = found()
    assert (one.by, tempered.by) == ("importance", "smc")
    assert np.abs((tempered.mean - one.mean) / one.sd).max() < 0.3


def test_the_certified_shift_is_that_of_perturbed_fields():
    """Fields with drawn errors of the surrogate move the mean by as much as certified; half of these errors do not."""
    one = found(begin(1e4))
    variance = begin(1e4).predict(one.draws).variance.mean(axis=0)
    drawn = np.sqrt(variance) * np.random.default_rng(1).standard_normal((40, len(variance)))
    x = one.mean + square(np.linspace(-5, 5, 41)) @ np.linalg.cholesky(one.covariance).T
    x = x[((x >= SPACE.low) & (x <= SPACE.high)).all(axis=1)]
    mean = by_quadrature(x)[0]
    for kept in (1.0, 0.5):
        shifts = np.array([by_quadrature(x, off)[0] - mean for off in kept * drawn]) / one.sd
        ratio = shifts.std(axis=0).max() / (one.certified.shift / one.certified.surprise)
        assert (0.7 < ratio < 1.4) == (kept == 1.0)


def test_a_coarse_surrogate_asks_for_runs_at_the_posterior():
    one = found(begin(1e9))
    assert (found().certified.verdict, one.certified.verdict) == ("good", "refine")
    x = runs_for(begin(1e9), [one], 3)
    assert len(np.unique(x, axis=0)) == 3
    assert ((x >= one.draws.min(axis=0)) & (x <= one.draws.max(axis=0))).all()
