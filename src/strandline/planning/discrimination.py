"""What an experiment can be expected to tell about which model is right.

Under model m with inputs x, the observation of a candidate is s = z_m(x) + ε with standard normal ε, where the signals
z_m are predicted interfaces in standard deviations of the errors, in the same coordinates for all models. What it tells
about the model is the mutual information of m and s,

    Σ_m P(m) E[log p(s | m) - log Σ_k P(k) p(s | k)],   p(s | m) = ∫ p(s | x, m) p(x | m) dx,

(Box and Hill 1967; Cavagnaro et al. 2010), by nested Monte Carlo over draws of the models' present posteriors.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from strandline.errors import InvalidInput

__all__ = ["CLEAR", "Discrimination", "expected_discrimination"]

CLEAR = 3.0
"""ln of the posterior odds from which a model is clearly better, strong evidence."""
FEWEST = 10.0
"""Median number of draws of the right model that an observation must leave with weight."""
BLOCK = 256
"""Observations that are weighed at the same time."""


@dataclass(frozen=True)
class Discrimination:
    """What an experiment is expected to tell about which model is right.

    Args:
        nats: Expected information about the model, from 0 to ln of the number of models.
        error: Standard error of it by the number of draws.
        clear: Probability that the right model will lead every other one by `CLEAR` nats of posterior odds.
        wrong: Probability that another model will lead by as much.
        left: Median number of draws of the right model that a possible observation leaves with weight.
    """

    nats: float
    error: float
    clear: float
    wrong: float
    left: float

    def __repr__(self) -> str:
        return f"<Discrimination: {self.nats:.3g} ± {self.error:.2g} nats, clear in {self.clear:.0%}>"

    @property
    def reliable(self) -> bool:
        """Whether enough draws are left for nested Monte Carlo."""
        return self.left >= FEWEST


def expected_discrimination(
    signals: Sequence[Float[np.ndarray, "_ signal"]],
    probabilities: Sequence[float],
    random: np.random.Generator,
) -> Discrimination:
    """Return what an experiment is expected to tell about which model is right.

    Each draw of each model in turn is the truth; it is left out where the density of its own observation is computed.

    Args:
        signals: What the experiment shows under each model, in standard deviations of independent errors, for equally
            likely draws of its inputs: shape (draw, signal) for each model.
        probabilities: Present probabilities of the models, whose sum is 1.
        random: Generator of the errors; the same state for all candidates makes their differences more certain.

    Raises:
        InvalidInput: Fewer than two models or draws, signals of different sizes, or probabilities that do not fit.
    """
    _require(signals, probabilities)
    log_prior, nats, variance, clear, wrong = np.log(probabilities), 0.0, 0.0, 0.0, 0.0
    left: list[Float[np.ndarray, " truth"]] = []
    for k, (truths, share) in enumerate(zip(signals, probabilities, strict=True)):
        seen = truths + random.standard_normal(truths.shape)
        columns, effective = zip(
            *(_log_densities(seen, draws, own=k == m) for m, draws in enumerate(signals)), strict=True
        )
        odds = log_prior + np.stack(columns, axis=1)
        posterior = odds - logsumexp(odds, axis=1, keepdims=True)
        told = posterior[:, k] - log_prior[k]
        nats, variance = nats + share * float(told.mean()), variance + share**2 * float(told.var()) / len(told)
        best_other = np.delete(odds, k, axis=1).max(axis=1)
        clear += share * float(np.mean(odds[:, k] - best_other >= CLEAR))
        wrong += share * float(np.mean(_lead(odds, k) >= CLEAR))
        left.append(effective[k])
    return Discrimination(max(nats, 0.0), math.sqrt(variance), clear, wrong, float(np.median(np.concatenate(left))))


def _lead(odds: Float[np.ndarray, "truth model"], right: int) -> Float[np.ndarray, " truth"]:
    """Return by how much the best wrong model leads every other one; negative if it does not lead."""
    out = np.full(len(odds), -np.inf)
    for m in range(odds.shape[1]):
        if m != right:
            out = np.maximum(out, odds[:, m] - np.delete(odds, m, axis=1).max(axis=1))
    return out


def _log_densities(
    seen: Float[np.ndarray, "truth signal"], draws: Float[np.ndarray, "draw signal"], *, own: bool
) -> tuple[Float[np.ndarray, " truth"], Float[np.ndarray, " truth"]]:
    """Return log p(s | model), without the constant of the errors, and the effective number of draws behind it.

    Args:
        seen: Observations.
        draws: Signals of the model's draws.
        own: Whether observation i comes from draw i, which is then left out.
    """
    squares, logs, left = 0.5 * (draws**2).sum(axis=1), np.empty(len(seen)), np.empty(len(seen))
    for first in range(0, len(seen), BLOCK):
        rows = np.arange(first, min(first + BLOCK, len(seen)))
        some = seen[rows]
        values = some @ draws.T - squares - 0.5 * (some**2).sum(axis=1)[:, None]
        if own:
            values[np.arange(len(rows)), rows] = -np.inf
        total = logsumexp(values, axis=1)
        left[rows] = np.exp(2 * total - logsumexp(2 * values, axis=1))
        # The logarithm of a mean of few draws is too low: by half its relative variance, to first order.
        number = len(draws) - own
        logs[rows] = total - math.log(number) + 0.5 * (1.0 / left[rows] - 1.0 / number)
    return logs, left


def _require(signals: Sequence[Float[np.ndarray, "_ signal"]], probabilities: Sequence[float]) -> None:
    shapes = [one.shape for one in signals]
    if len(shapes) < 2 or min(shape[0] for shape in shapes) < 2 or len({shape[1] for shape in shapes}) > 1:
        raise InvalidInput(
            "signals of the models",
            value=f"shapes {shapes}",
            expected="at least two models and two draws of each, all with the same number of signals",
            remedy="Bring the predicted interfaces of all models together to the same signals.",
        )
    right = len(probabilities) == len(shapes) and all(0 < one < 1 for one in probabilities)
    if not (right and abs(sum(probabilities) - 1) < 1e-9):
        raise InvalidInput(
            "probabilities of the models",
            value=list(probabilities),
            expected=f"{len(shapes)} numbers between 0 and 1 whose sum is 1",
            remedy="Divide them by their sum.",
        )
