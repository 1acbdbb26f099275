"""Replicates of the sampler against exact evidence and moments, and planted bugs that must fail the same test."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.smc import STUDY, SMCSettings, sample, steps
from strandline.testing import densities

TARGET = densities.banana(centre=0.5, sd=1.0, bend=0.4, width=0.3)
CORNER = densities.truncated_gaussian(
    np.array([0.0, 1.0]), np.array([1.0, 0.1]), np.array([0.2, 0.95]), np.array([5.0, 3.0])
)
# Few moves: particles stay correlated with their weights, so that a summary that forgets the weights is wrong.
HASTY = SMCSettings(rejuvenation_steps=2, zeta=0.9, resample_below=0.3)
STEADY = SMCSettings(rejuvenation_steps=8, zeta=0.8)
REPLICATES, PARTICLES, LIMIT = 24, 2000, 4.5


def replicates(target=TARGET, settings=HASTY, log_likelihood=None):
    likelihood = log_likelihood or target.log_likelihood
    rng = np.random.default_rng(11)
    return [
        sample(
            jax.random.key(seed),
            likelihood,
            target.log_prior,
            target.draw_prior(rng, PARTICLES),
            settings=settings,
        )
        for seed in range(REPLICATES)
    ]


def summaries(result, weights):
    """Return (log Z, means, second moments about the origin)."""
    return np.concatenate([[result.log_evidence], weights @ result.positions, weights @ result.positions**2])


def weighted(result):
    return summaries(result, np.exp(result.log_weights))


def worst_z(values, target):
    """Return the largest |z| of the replicates' means."""
    exact = np.concatenate([[target.log_evidence], target.mean, np.diagonal(target.covariance) + target.mean**2])
    values = np.asarray(values)
    return np.abs((values.mean(axis=0) - exact) / (values.std(axis=0, ddof=1) / np.sqrt(len(values)))).max()


@pytest.fixture(scope="module")
def hasty():
    return replicates()


def test_evidence_and_weighted_moments_are_right(hasty):
    assert worst_z([weighted(r) for r in hasty], TARGET) < LIMIT


def test_a_density_cut_by_its_prior_is_right():
    assert worst_z([weighted(r) for r in replicates(CORNER, STEADY)], CORNER) < LIMIT


@pytest.mark.long
@pytest.mark.parametrize("target", [TARGET, CORNER], ids=["banana", "corner"])
@pytest.mark.parametrize("zeta", [0.5, 0.8, 0.97])
def test_other_settings_are_right_too(target, zeta):
    settings = SMCSettings(rejuvenation_steps=8, zeta=zeta)
    assert worst_z([weighted(r) for r in replicates(target, settings)], target) < LIMIT


def test_unweighted_means_fail(hasty):
    equal = np.full(PARTICLES, 1 / PARTICLES)
    assert min(r.ess for r in hasty) < 0.9 * PARTICLES
    assert worst_z([summaries(r, equal) for r in hasty], TARGET) > 2 * LIMIT


@pytest.mark.parametrize(
    "forgotten", [lambda r: r.steps[:1], lambda r: [s for s in r.steps if s.resampled]], ids=["first", "resampled"]
)
def test_a_forgotten_increment_of_the_evidence_fails(hasty, forgotten):
    def without(result):
        summary = weighted(result)
        summary[0] -= sum(step.log_evidence_increment for step in forgotten(result))
        return summary

    assert worst_z([without(r) for r in hasty], TARGET) > 2 * LIMIT


def planted(monkeypatch, change):
    """Run the replicates with `change` applied to the arguments of the moves."""
    original = steps.metropolis
    monkeypatch.setattr(steps, "metropolis", lambda *args, **kw: original(*args, **change(kw)))
    return replicates(settings=STEADY, log_likelihood=lambda x: TARGET.log_likelihood(x))


def test_tempering_left_out_of_the_acceptance_fails(monkeypatch):
    found = planted(monkeypatch, lambda kw: kw | {"temperature": jnp.ones_like(kw["temperature"])})
    assert worst_z([weighted(r) for r in found], TARGET) > 2 * LIMIT


def test_a_prior_left_out_of_the_acceptance_fails(monkeypatch):
    original = steps.metropolis

    def careless(*args, target, **kw):
        return original(*args, target=(target[0], lambda x: 0 * x[:, 0]), **kw)

    monkeypatch.setattr(steps, "metropolis", careless)
    found = replicates(CORNER, STEADY, lambda x: CORNER.log_likelihood(x))
    assert worst_z([weighted(r) for r in found], CORNER) > 2 * LIMIT


def test_weights_reset_without_resampling_fail(monkeypatch):
    original = steps.systematic
    monkeypatch.setattr(steps, "systematic", lambda key, w: 0 * original(key, w) + jnp.arange(len(w)))
    found = replicates(settings=HASTY, log_likelihood=lambda x: TARGET.log_likelihood(x))
    assert worst_z([weighted(r) for r in found], TARGET) > 2 * LIMIT


@pytest.mark.long
def test_the_studys_settings_are_right_over_many_replicates():
    rng = np.random.default_rng(12)
    found = [
        sample(jax.random.key(s), TARGET.log_likelihood, TARGET.log_prior, TARGET.draw_prior(rng, 5000), settings=STUDY)
        for s in range(40)
    ]
    assert not any(step.resampled for r in found for step in r.steps)
    assert worst_z([weighted(r) for r in found], TARGET) < LIMIT
