"""Where runs are known to fail: how many runs of a budget were lost there, and what may still be run.

The classifier of failures only weighs the posterior and the choice of runs. If the observation is best explained by
inputs that fail, the likelihood outweighs it and batch after batch would go there. So once a tenth of the runs allowed
has failed where that was likely, the others are placed where runs are expected to succeed.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from strandline.design.active.checking import MOST_FAILED
from strandline.design.active.state import Knowledge, State
from strandline.design.space_filling import sobol
from strandline.parameters import ParameterSpace
from strandline.posterior import subset
from strandline.runs import RunRecord

__all__ = ["MOST", "SAFE", "UNLIKELY", "Losses", "price_of_a_hang", "safe_candidates"]

MOST = 0.1
"""Largest share of the runs allowed that may be lost where runs are known to fail."""
UNLIKELY, SAFE = 0.5, 0.95
"""Probability of success, relative to the safest run, below which a region is known to fail; from which it is safe."""
POOL = 2048
"""Points of the Sobol sequence from which runs are taken if hardly a particle is safe."""
FEWEST = 30
"""Fewest safe particles to choose from."""


@dataclass(frozen=True, eq=False)
class Losses:
    """Runs lost where runs are known to fail, and how many more may be.

    Args:
        knowledge: What the runs so far have taught.
        runs: Number of runs that were allowed.
        first: Inputs of the first runs, as bytes; these were placed before anything was known.
        price: Time that a lost run takes, in those of a good one, at least 1: a hang costs as much as many runs.
    """

    knowledge: Knowledge
    runs: int
    first: Collection[bytes]
    price: float = 1.0

    @property
    def lost(self) -> int:
        """Number of runs after the first ones that failed where the classifier expects it."""
        failed = [row for row in self.knowledge.x[~self.knowledge.ok] if row.tobytes() not in self.first]
        return int((~self.likely(np.array(failed))).sum()) if failed else 0

    @property
    def left(self) -> float:
        """Number of further runs that may be lost."""
        return MOST * self.runs / self.price - self.lost

    def chance(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the probability that a run succeeds, relative to the safest run."""
        return np.asarray(np.exp(self.knowledge.log_feasibility(x)))

    def likely(self, x: Float[np.ndarray, "point dim"]) -> Bool[np.ndarray, " point"]:
        """Return which points do not lie where runs are known to fail."""
        return np.asarray(self.chance(x) >= UNLIKELY)

    def bears(self, x: Float[np.ndarray, "run dim"]) -> bool:
        """Return whether runs at these points may be made: all of them are safe, or the losses to expect are few."""
        chance = self.chance(x)
        return bool((1 - chance[chance < SAFE]).sum() <= max(self.left, 0.0))

    def safest(self, x: Float[np.ndarray, "point dim"], fewest: int) -> Float[np.ndarray, "safe dim"]:
        """Return the safe ones of these points, at least the `fewest` safest."""
        chance = self.chance(x)
        return x[chance >= min(SAFE, float(np.sort(chance)[-min(fewest, len(x))]))]

    def bearable(self, x: Float[np.ndarray, "run dim"]) -> Float[np.ndarray, "kept dim"]:
        """Return the points, without those where runs are known to fail if no more may be lost."""
        return x if self.bears(x) else x[self.likely(x)]

    def bears_check(self, state: State, draws: int) -> bool:
        """Return whether a check with this number of draws of the posterior may be made.

        It cannot pass if more of them fail than a check tolerates, and these would be lost.
        """
        risk = self._risk(state)
        return risk <= MOST_FAILED or draws <= self.left

    def words(self, state: State) -> tuple[str, ...]:
        """Return how much of the posterior lies where runs fail if this kept it from being checked."""
        risk = self._risk(state)
        if risk <= MOST_FAILED or not self.lost:
            return ()
        return (f"{risk:.0%} of the posterior lies where runs are likely to fail; {self.lost} runs were lost there",)

    def _risk(self, state: State) -> float:
        """Return the share of draws of the posterior whose run is expected to fail."""
        return float(np.exp(state.log_weights) @ (1 - self.chance(state.positions)))


def price_of_a_hang(records: Sequence[RunRecord]) -> float:
    """Return the mean time of the runs that ended at their time limit over the median of good ones, at least 1."""
    good, hung = ([one.seconds for one in records if one.state == state] for state in ("ok", "timeout"))
    return max(1.0, float(np.mean(hung) / max(np.median(good), 1e-9))) if good and hung else 1.0


def safe_candidates(
    losses: Losses, state: State, particles: Float[np.ndarray, "particle dim"], space: ParameterSpace, seed: int
) -> Float[np.ndarray, "candidate dim"]:
    """Return the safe particles; if these are few, points of the box that are safe too, the likeliest by π_γ.

    Args:
        losses: The runs lost so far.
        state: The posterior so far.
        particles: Particles of π_γ.
        space: The inputs with their priors.
        seed: Seed of the draws.
    """
    safe = particles[losses.chance(particles) >= SAFE]
    if len(safe) >= FEWEST:
        return safe
    pool = losses.safest(space.prior_quantiles(sobol(POOL, space.dim, scramble=4)), FEWEST)
    value = 0.5 * state.knowledge.plug_in(pool)
    weights = np.exp(value - value.max())
    drawn = pool[subset(weights / weights.sum(), 10 * FEWEST, seed)]
    best = pool[np.argsort(-value)[:FEWEST]]
    return np.unique(np.concatenate([safe, drawn, best]), axis=0)
