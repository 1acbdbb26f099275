"""Two independent runs of the sampler, each with half the particles, joined into one sample of the posterior."""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Float

from strandline.smc.moves import RandomKey
from strandline.smc.records import SMCResult

__all__ = ["FEWEST", "in_halves", "joined"]

FEWEST = 4
"""Number of particles from which there are two halves that the sampler accepts."""
FIRST = 2
"""Keeps the keys of the halves apart from those derived from the same key elsewhere."""


def in_halves(
    run: Callable[[RandomKey, Float[np.ndarray, "half dim"]], SMCResult],
    key: RandomKey,
    initial: Float[np.ndarray, "particle dim"],
) -> SMCResult:
    """Return the union of two runs with half the initial particles each; a single run if there are too few particles.

    Args:
        run: The sampler as a function of a key and initial particles.
        key: Random key; do not use it again. Each half gets its own.
        initial: Draws from the prior, physical.
    """
    if len(initial) < FEWEST:
        return run(key, initial)
    halves = np.array_split(initial, 2)
    return joined(*(run(jax.random.fold_in(key, FIRST + i), half) for i, half in enumerate(halves)))


def joined(one: SMCResult, other: SMCResult) -> SMCResult:
    """Return the particles of two independent runs, weighted by evidence.

    Each run estimates the integral of any function times L p without bias, so the mean of the two does as well, and
    with it the evidence. A half that misses most of the mass has a small evidence, and so little weight. The steps are
    those of the first run.
    """
    halves, number = (one, other), len(one.positions) + len(other.positions)
    shares = [half.log_evidence + np.log(len(half.positions) / number) for half in halves]
    log_evidence = float(np.logaddexp(*shares))
    weights = [half.log_weights + share - log_evidence for half, share in zip(halves, shares, strict=True)]
    log_weights = np.concatenate(weights)
    return SMCResult(
        positions=np.concatenate([half.positions for half in halves]),
        log_weights=log_weights,
        log_likelihood=np.concatenate([half.log_likelihood for half in halves]),
        log_prior=np.concatenate([half.log_prior for half in halves]),
        log_evidence=log_evidence,
        ess=float(1.0 / np.sum(np.exp(2 * log_weights))),
        steps=one.steps,
        likelihood_evaluations=one.likelihood_evaluations + other.likelihood_evaluations,
        halves=halves,
    )
