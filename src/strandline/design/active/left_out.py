"""A check that needs no new runs: the true log-likelihood of each run against its prediction from all others."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from strandline.design.active.state import State
from strandline.runs import RunRecord

__all__ = ["NEAR", "left_out_ratios"]

MASS, NEAR = 0.95, 0.995
"""Runs lie inside the posterior, or near it, if they are in its densest part that has this mass."""


def left_out_ratios(
    state: State,
    records: Sequence[RunRecord],
    log_likelihood: Callable[[RunRecord], float],
    log_prior: Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, " point"]],
    *,
    mass: float = MASS,
) -> tuple[Float[np.ndarray, "run dim"], Float[np.ndarray, " run"], Float[np.ndarray, " run"]]:
    """Return the inputs of the runs inside the posterior, log(true/predicted likelihood) of each, and its variance.

    The variance is the one that the surrogate without the run expects.

    The prediction is that of the surrogate without the run, so the ratios are those of a worse surrogate than the
    one in use. They show how much the weights of a check would differ, not where the posterior would move.

    Args:
        state: The posterior given all runs.
        records: Records of all runs, in the order of `state.knowledge.x`.
        log_likelihood: Function that returns the log-likelihood of a successful record, by the true model.
        log_prior: Function that returns the log prior density of points, shape (point,).
        mass: Mass of the densest part of the posterior whose runs count.
    """
    knowledge, likelihood = state.knowledge, state.knowledge.likelihood
    x = knowledge.x[knowledge.ok]
    density = state.log_expected + np.asarray(log_prior(state.positions))
    order = np.argsort(-density)
    within = np.cumsum(np.exp(state.log_weights)[order]) <= mass
    lowest = density[order[within]].min() if within.any() else density.max()
    inside = knowledge.expected(x) + np.asarray(log_prior(x)) >= lowest
    if not inside.any():
        return x[inside], np.empty(0), np.empty(0)
    good = [record for record in records if record.ok]
    true = np.array([log_likelihood(good[i]) for i in np.flatnonzero(inside)])
    predicted = likelihood.left_out(np.flatnonzero(inside))
    log_expected = predicted.log_expected + knowledge.log_feasibility(x[inside])
    return x[inside], true - log_expected, predicted.variances
