"""What a candidate can be expected to teach, from the predicted interfaces at draws of the inputs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from strandline.planning.information import expected_gain, linear_gain, linear_sd
from strandline.posterior.weighted import Weighted

__all__ = ["By", "Outlook", "expected_outlook", "linear_outlook"]

By = Literal["nested Monte Carlo", "linearised"]
_Informations = Sequence[Float[np.ndarray, "dim dim"]]


@dataclass(frozen=True, eq=False)
class Outlook:
    """What an experiment can be expected to teach.

    Args:
        gain: Expected information gain about the inputs of interest, nats.
        error: Its standard error by the number of draws; 0 if linearised.
        sd: Expected posterior standard deviation of each input, shape (dim,).
        by: How it was computed.
    """

    gain: float
    error: float
    sd: Float[np.ndarray, " dim"]
    by: By


def expected_outlook(
    now: Weighted,
    signals: Float[np.ndarray, "draw signal"],
    informations: Callable[[], _Informations],
    *,
    interest: Sequence[int],
    seed: int,
) -> Outlook:
    """Return the outlook by nested Monte Carlo; linearised if too few draws are left for that.

    Args:
        now: Draws of the present distribution of the inputs.
        signals: What the experiment shows for each of them, in standard deviations of independent errors.
        informations: Function that returns the Fisher information at some of the draws.
        interest: Columns of the inputs of interest; if there are others, gains are those of normal distributions.
        seed: Seed of the errors.
    """
    found = expected_gain(now, signals, np.random.default_rng(seed), interest=interest)
    if not found.reliable:
        return linear_outlook(now.covariance, informations(), interest=interest)
    everything = len(interest) == now.draws.shape[1]
    return Outlook(found.nats if everything else found.of_interest, found.error, found.sd, "nested Monte Carlo")


def linear_outlook(
    covariance: Float[np.ndarray, "dim dim"], informations: _Informations, *, interest: Sequence[int]
) -> Outlook:
    """Return the outlook from Fisher informations at draws of the inputs.

    Args:
        covariance: Present covariance of the inputs.
        informations: Fisher informations at the draws.
        interest: Columns of the inputs of interest.
    """
    gain = linear_gain(covariance, informations, interest=interest)
    return Outlook(gain, 0.0, linear_sd(covariance, informations), "linearised")
