"""Replicates of the sampler against exact evidence and moments, and planted bugs that must fail the same test."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.densities import banana, truncated_gaussian

from strandline.smc import STUDY, SMCSettings, sample, steps

TARGET = banana(centre=0.5, sd=1.0, bend=0.4, width=0.3)
CORNER = truncated_gaussian(*np.array([[0.0, 1.0], [1.0, 0.1], [0.2, 0.95], [5.0, 3.0]]))
HASTY = SMCSettings(rejuvenation_steps=2, zeta=0.9, resample_below=0.3)
"""Few moves: particles stay correlated with their weights, so that a summary that forgets the weights is wrong."""
STEADY = SMCSettings(rejuvenation_steps=8, zeta=0.8)
LIMIT = 4.5


def replicates(target, settings, number=16, *, particles=2000):
    """Return runs of the sampler; the likelihood is a new function, so that it is compiled anew."""
    rng, log_likelihood = np.random.default_rng(11), lambda x: target.log_likelihood(x)
    starts = [target.draw_prior(rng, particles) for _ in range(number)]
    return [
        sample(jax.random.key(seed), log_likelihood, target.log_prior, start, settings=settings)
        for seed, start in enumerate(starts)
    ]


def weighted(result, weights=None):
    """Return (log Z, means, second moments about the origin)."""
    w = np.exp(result.log_weights) if weights is None else weights
    return np.concatenate([[result.log_evidence], w @ result.positions, w @ result.positions**2])


def worst_z(values, target=TARGET):
    """Return the largest |z| of the replicates' means."""
    exact = np.concatenate([[target.log_evidence], target.mean, np.diagonal(target.covariance) + target.mean**2])
    found = np.asarray(values)
    return float(np.abs((found.mean(axis=0) - exact) / (found.std(axis=0, ddof=1) / np.sqrt(len(found)))).max())


def test_evidence_and_weighted_moments_are_right_also_of_a_density_cut_by_its_prior():
    """Planted: weights, the first increment of the evidence, or those of steps that resample are forgotten."""
    found = replicates(TARGET, HASTY, 24)
    assert worst_z([weighted(r) for r in found]) < LIMIT
    equal = np.full(2000, 1 / 2000)
    assert min(r.ess for r in found) < 0.9 * 2000
    assert worst_z([weighted(r, equal) for r in found]) > 2 * LIMIT
    for forgotten in (lambda r: r.steps[:1], lambda r: [s for s in r.steps if s.resampled]):
        lost = [np.append(sum(s.log_evidence_increment for s in forgotten(r)), np.zeros(4)) for r in found]
        assert worst_z([weighted(r) - part for r, part in zip(found, lost, strict=True)]) > 2 * LIMIT
    assert worst_z([weighted(r) for r in replicates(CORNER, STEADY)], CORNER) < LIMIT


def tempering_left_out(metropolis):
    return lambda *args, **kw: metropolis(*args, **kw | {"temperature": jnp.ones_like(kw["temperature"])})


def prior_left_out(metropolis):
    return lambda *args, target, **kw: metropolis(*args, target=(target[0], lambda x: 0 * x[:, 0]), **kw)


def weights_reset_without_resampling(systematic):
    return lambda key, w: 0 * systematic(key, w) + jnp.arange(len(w))


@pytest.mark.parametrize(
    ("function", "change", "target", "settings"),
    [
        ("metropolis", tempering_left_out, TARGET, STEADY),
        ("metropolis", prior_left_out, CORNER, STEADY),
        ("systematic", weights_reset_without_resampling, TARGET, HASTY),
    ],
)
def test_a_planted_bug_shows(function, change, target, settings, monkeypatch):
    monkeypatch.setattr(steps, function, change(getattr(steps, function)))
    assert worst_z([weighted(r) for r in replicates(target, settings)], target) > 2 * LIMIT


@pytest.mark.long
def test_the_studys_settings_are_right_over_many_replicates():
    found = replicates(TARGET, STUDY, 40, particles=5000)
    assert not any(step.resampled for r in found for step in r.steps)
    assert worst_z([weighted(r) for r in found]) < LIMIT
