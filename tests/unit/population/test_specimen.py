"""The posterior of one specimen against quadrature, its certificate against perturbed fields, its random numbers."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.unit.calibration.arches import SD, SPACE, arch, knowledge, seen

from strandline.discrepancy import NormalOffset
from strandline.errors import InvalidInput
from strandline.interface import Observation, PointErrors
from strandline.likelihood import FieldLikelihood
from strandline.population import posterior_of, start
from strandline.population import specimen as module
from strandline.population.refinement import runs_for

ERRORS = PointErrors(SD)
OUTLINE = Observation(ERRORS.draw(arch(np.array([0.33, 0.12])), np.random.default_rng(3)), ERRORS)
U = (np.arange(161) + 0.5) / 161


@cache
def begin(widening=1.0):
    """Return a start whose surrogate expects larger errors by a factor of their variance."""
    known = knowledge(NormalOffset(), {"": Observation(seen(ERRORS), ERRORS)})
    wider = tuple(replace(process, widening=widening * process.widening) for process in known.surrogate.processes)
    likelihood = replace(known.likelihood, surrogate=replace(known.surrogate, processes=wider))
    return start(replace(known, likelihood=likelihood), SPACE)


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
        assert one.by == "importance"
        assert one.effective > 1000
        assert bool(np.abs((one.covariance - covariance) / np.outer(sd, sd)).max() < 0.1) is right
        assert not right or np.abs((one.mean - mean) / sd).max() < 0.06
        np.testing.assert_allclose(one.draws.mean(axis=0), one.mean, atol=1e-9)
        np.testing.assert_allclose(np.cov(one.draws.T, bias=True), one.covariance, rtol=1e-6)
        assert (np.diff(one.quantiles, axis=0) > 0).all()


def test_known_inputs_are_held_fixed_or_refused():
    one, elsewhere = (found(begin().with_given({"lean": lean})) for lean in (0.12, 0.05))
    heights = SPACE.low[0] + U * (SPACE.high[0] - SPACE.low[0])
    mean, covariance = by_quadrature(np.stack([heights, np.full(len(U), 0.12)], axis=1))
    sd = float(np.sqrt(covariance[0, 0]))
    assert one.space.names == ("height",)
    assert abs(one.mean[0] - mean[0]) < 0.06 * sd
    assert abs(one.sd[0] / sd - 1) < 0.06
    assert abs(elsewhere.mean[0] - mean[0]) > 3 * sd, "the known value matters"
    for given, words in (
        ({"lean": 3.0}, "known value of lean: got 3.0; expected a number from -0.1 to 0.2"),
        ({"weight": 1.0}, "name of an input: got weight"),
        ({"lean": 0.1, "height": 0.3}, "at least one input left"),
    ):
        with pytest.raises(InvalidInput, match=words):
            begin().with_given(given)


def test_it_depends_on_name_and_seed_alone():
    first, second, again = (found(name=name) for name in "aba")
    for part in ("mean", "covariance", "quantiles", "draws"):
        np.testing.assert_array_equal(getattr(again, part), getattr(first, part))
    for other in (second, found(name="a", seed=2)):
        assert not np.array_equal(other.draws, first.draws)
        assert np.abs((other.mean - first.mean) / first.sd).max() < 0.12


def test_other_samplers_take_over(monkeypatch):
    """Without a likelihood nearby the measure leads the sampler; without importance sampling, tempering does it."""
    one = found()
    monkeypatch.setattr(FieldLikelihood, "nearby", None)
    exact = found()
    monkeypatch.setattr(module, "followed", lambda *given: None)
    tempered = found()
    assert [x.by for x in (one, exact, tempered)] == ["importance", "importance", "smc"]
    for other, limit in ((exact, 0.1), (tempered, 0.3)):
        assert np.abs((other.mean - one.mean) / one.sd).max() < limit
        assert np.abs(other.sd / one.sd - 1).max() < limit


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
    assert found().certified.verdict == "good"
    one = found(begin(1e9))
    assert one.certified.verdict == "refine"
    x = runs_for(begin(1e9), [one], 3)
    assert len(np.unique(x, axis=0)) == 3
    assert ((x >= one.draws.min(axis=0)) & (x <= one.draws.max(axis=0))).all()
    assert len(runs_for(begin(1e9), [], 3)) == 0
