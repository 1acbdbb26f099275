"""The sampler's defaults against exact moments, over seeds, and what they save against the published settings."""

from collections.abc import Mapping

import jax
import numpy as np
import pytest

from strandline.smc import STUDY, SMCSettings, sample
from strandline.testing.densities import KnownPosterior, banana, gaussian, truncated_gaussian

PARTICLES, SEEDS = 5000, 20


def ridge(dim: int) -> KnownPosterior:
    """Standard deviations from 1 to 0.05 along axes that are none of the inputs'."""
    axes = np.linalg.qr(np.random.default_rng(3).normal(size=(dim, dim)))[0]
    return gaussian(np.zeros(dim), axes @ np.diag(np.geomspace(1.0, 0.05, dim) ** 2) @ axes.T)


TARGETS: Mapping[str, KnownPosterior] = {
    "banana in 2-D": banana(centre=1.0, sd=1.0, bend=0.5, width=0.15),
    "ridge in 7-D": ridge(7),
    "box in 7-D": truncated_gaussian(
        np.array([0.2, 0.9, 0.5, 1.2, -0.1, 0.5, 0.4]),
        np.array([0.1, 0.5, 0.05, 0.3, 0.2, 2.0, 0.02]),
        np.zeros(7),
        np.ones(7),
    ),
}


def errors(target: KnownPosterior, settings: SMCSettings, seeds: int = SEEDS) -> tuple[float, float, float, float]:
    """Return rms errors over seeds: of means (in sd), of standard deviations (relative), of log Z; and evaluations."""
    sd, found, evaluations = np.sqrt(np.diagonal(target.covariance)), [], []
    for seed in range(seeds):
        initial = target.draw_prior(np.random.default_rng(100 + seed), PARTICLES)
        result = sample(jax.random.key(seed), target.log_likelihood, target.log_prior, initial, settings=settings)
        weights = np.exp(result.log_weights)
        mean = weights @ result.positions
        spread = np.sqrt(weights @ (result.positions - mean) ** 2)
        evidence = np.full(len(sd), result.log_evidence - target.log_evidence)
        found.append([(mean - target.mean) / sd, spread / sd - 1, evidence])
        evaluations.append(result.likelihood_evaluations)
    worst = np.sqrt(np.mean(np.square(found), axis=0)).max(axis=1)
    return float(worst[0]), float(worst[1]), float(worst[2]), float(np.mean(evaluations))


@pytest.mark.long
@pytest.mark.parametrize("name", TARGETS)
def test_moments_are_as_good_for_a_twentieth_of_the_evaluations(name: str) -> None:
    mean, sd, evidence, evaluations = errors(TARGETS[name], SMCSettings())
    study = errors(TARGETS[name], STUDY, seeds=2)
    print(f"\n{name}: mean {mean:.4f} sd, sd {sd:.4f}, log Z {evidence:.3f}, {study[3] / evaluations:.1f}x fewer")
    assert mean < 0.03
    assert sd < 0.03
    assert evidence < 0.1
    assert study[3] / evaluations >= 20


@pytest.mark.long
def test_too_few_moves_are_noticed() -> None:
    """Planted: one move a step; particles stay where resampling has put several of them."""
    mean, *_ = errors(TARGETS["box in 7-D"], SMCSettings(rejuvenation_steps=1), seeds=8)
    assert mean > 0.1
