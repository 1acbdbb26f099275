"""Hamiltonian Monte Carlo with many chains side by side, for many inputs.

The force may be approximate: each proposal is accepted by the exact log density, and the leapfrog steps keep volume and
can be reversed whatever the force is, if it depends on the position alone (Neal, MCMC using Hamiltonian dynamics, 2011,
section 5.3). R̂ is that of rank-normalised halves of the chains' draws for the worst input (Vehtari et al., Bayesian
Analysis 16, 2021, 667).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri
from scipy.stats import rankdata

Positions = Float[np.ndarray, "chain dim"]
ACCEPTED, RATE = 0.8, 0.05
"""Share of proposals that should be accepted, and how fast the step follows while it is adapted."""
LEAPS = 4
SPREAD = (0.6, 1.3)
"""Factors of the step that are drawn, so that no chain goes round in circles."""


@dataclass(frozen=True, eq=False)
class Chains:
    """Draws of equal weight (step, chain, dim), the share of proposals accepted, and the step at the end."""

    draws: Float[np.ndarray, "step chain dim"]
    accepted: float
    step: float

    @property
    def last(self) -> Positions:
        return np.asarray(self.draws[-1])

    @classmethod
    def joined(cls, parts: Sequence["Chains"]) -> "Chains":
        """Return parts of the same chains, one after the other, as one."""
        accepted = float(np.mean([one.accepted for one in parts]))
        return cls(np.concatenate([one.draws for one in parts]), accepted, parts[-1].step)

    def only(self, chains: slice) -> "Chains":
        """Return some of the chains."""
        return replace(self, draws=self.draws[:, chains])

    @property
    def r_hat(self) -> float:
        """The largest R̂ of an input, of rank-normalised halves."""
        z = self._halves
        within, all_of = self._variances(z)
        return float(np.sqrt(all_of / within).max())

    @property
    def effective(self) -> float:
        """Effective number of draws for the mean of the worst input, by the same halves.

        Sums of two neighbouring autocorrelations count as long as they are positive (Geyer, Stat. Sci. 7, 1992, 473).
        """
        z = self._halves
        number, chains, _ = z.shape
        within, all_of = self._variances(z)
        spectrum = np.fft.rfft(z - z.mean(axis=0), 2 * number, axis=0)
        covariances = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:number].mean(axis=1) / number
        rho = 1 - (within - covariances * number / (number - 1)) / all_of
        pairs = rho[: number // 2 * 2].reshape(number // 2, 2, -1).sum(axis=1)
        pairs = np.minimum.accumulate(np.where(np.minimum.accumulate(pairs > 0, axis=0), pairs, 0.0), axis=0)
        return float((number * chains / np.maximum(2 * pairs.sum(axis=0) - 1, 1e-3)).min())

    @cached_property
    def _halves(self) -> Float[np.ndarray, "step half dim"]:
        """Return normal scores of the ranks, in halves of the chains."""
        number = len(self.draws) // 2
        halves = np.concatenate([self.draws[:number], self.draws[number : 2 * number]], axis=1)
        shape = halves.shape
        ranks = rankdata(halves.reshape(-1, shape[2]), axis=0).reshape(shape)
        return np.asarray(ndtri((ranks - 0.375) / (shape[0] * shape[1] + 0.25)))

    @staticmethod
    def _variances(z: Float[np.ndarray, "step half dim"]) -> tuple[Any, Any]:
        """Return the mean variance within a half, and that over all of them."""
        within = z.var(axis=0, ddof=1).mean(axis=0)
        return within, (len(z) - 1) / len(z) * within + z.mean(axis=0).var(axis=0, ddof=1)


def hamiltonian(
    log_density: Callable[[Positions], Float[np.ndarray, " chain"]],
    force: Callable[[Positions], Positions],
    start: Positions,
    root: Float[np.ndarray, "dim dim"],
    random: np.random.Generator,
    *,
    steps: int,
    step: float = 0.2,
    leaps: int = LEAPS,
    adapt: bool = False,
) -> Chains:
    """Return the chains from `start`; momenta are those of a mass whose inverse is root rootᵀ, a guess of the
    covariance. A move has that many `leaps`. With `adapt`, the step is changed on the way, and the draws are not to be
    used.
    """
    x, draws, accepted = start, np.empty((steps, *start.shape)), np.empty(steps)
    log, pull = log_density(x), force(x) @ root
    for k in range(steps):
        p = random.standard_normal(x.shape)
        length = step * random.uniform(*SPREAD)
        there, moving, pulled = x, p + 0.5 * length * pull, pull
        for leap in range(leaps):
            there = there + length * moving @ root.T
            pulled = force(there) @ root
            moving = moving + (length if leap < leaps - 1 else 0.5 * length) * pulled
        reached = log_density(there)
        change = reached - log + 0.5 * (p**2 - moving**2).sum(axis=1)
        chance = np.exp(np.minimum(np.nan_to_num(change, nan=-np.inf), 0.0))
        taken = random.random(len(x)) < chance
        x = np.where(taken[:, None], there, x)
        log, pull = np.where(taken, reached, log), np.where(taken[:, None], pulled, pull)
        draws[k], accepted[k] = x, chance.mean()
        if adapt:
            step *= float(np.exp(RATE * (accepted[k] - ACCEPTED)))
    return Chains(draws, float(accepted.mean()), step)
