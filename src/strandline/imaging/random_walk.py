"""A random walk over places on neighbouring normals: its mean, standard deviation and draws, given what each shows."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

__all__ = ["Walk", "walk"]


@dataclass(frozen=True, eq=False)
class Walk:
    """The posterior of a random walk.

    Args:
        mean: Mean on each normal, shape (normal,).
        sd: Standard deviation on each normal, shape (normal,).
        draws: Paths drawn from it, shape (draw, normal).
    """

    mean: Float[np.ndarray, " normal"]
    sd: Float[np.ndarray, " normal"]
    draws: Float[np.ndarray, "draw normal"]


def walk(
    log_likelihood: Float[np.ndarray, "normal candidate"],
    candidates: Float[np.ndarray, " candidate"],
    drift: float,
    *,
    draws: int = 0,
    random: np.random.Generator | None = None,
) -> Walk:
    """Return the posterior of a path that changes by N(0, drift²) from one normal to the next, by forward–backward.

    Args:
        log_likelihood: Logarithm of the likelihood of each candidate on each normal, up to a constant on each.
        candidates: Equally spaced places.
        drift: Standard deviation of a step; below half the spacing of candidates the path could hardly move.
        draws: Number of paths to draw.
        random: Generator for these.
    """
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    kernel = np.exp(-0.5 * (np.subtract.outer(candidates, candidates) / drift) ** 2)
    kernel /= kernel.sum(axis=1, keepdims=True)
    forward = np.empty_like(likelihood)
    message = np.ones(len(candidates))
    for i, row in enumerate(likelihood):
        message = message * row + 1e-300
        forward[i] = message / message.sum()
        message = forward[i] @ kernel
    backward, message = np.empty_like(likelihood), np.ones(len(candidates))
    for i in range(len(likelihood) - 1, -1, -1):
        backward[i] = message
        message = kernel @ (message * likelihood[i])
        message /= message.sum() or 1.0
    posterior = forward * backward
    posterior /= posterior.sum(axis=1, keepdims=True)
    mean = posterior @ candidates
    sd = np.sqrt(np.maximum(posterior @ candidates**2 - mean**2, 0.0))
    drawn = _drawn(forward, kernel, draws, random) if random is not None else np.empty((0, len(mean)), dtype=int)
    return Walk(mean, sd, candidates[drawn])


def _drawn(
    forward: Float[np.ndarray, "normal candidate"],
    kernel: Float[np.ndarray, "candidate candidate"],
    number: int,
    random: np.random.Generator,
) -> Int[np.ndarray, "draw normal"]:
    """Return candidates on paths drawn from the last normal to the first."""
    out = np.empty((number, len(forward)), dtype=int)
    uniform = random.random((len(forward), number))
    weights = np.broadcast_to(forward[-1], (number, forward.shape[1]))
    for i in range(len(forward) - 1, -1, -1):
        total = np.cumsum(weights, axis=1)
        out[:, i] = (total < uniform[i][:, None] * total[:, -1:]).sum(axis=1)
        if i:
            weights = forward[i - 1] * kernel[:, out[:, i]].T
    return out
