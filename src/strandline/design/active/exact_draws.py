"""Draws of the true posterior: draws of the surrogate's, each weighted by a run of the true model.

The surrogate's chains sample the likelihood L̂ that it expects, which is wide where it is unsure, so hardly a weight L/L̂
is large. On strips of 100 inputs 3 to 6 draws of ten are effective; of chains that accept or refuse the same draws
(delayed acceptance) 4 to 20 in a hundred, for they stand still where the weight is large. The surrogate learns no more.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from strandline.design.active.chains import ChainState, Normalised, drawn_result
from strandline.posterior import SmoothedWeights, pareto_smoothed, reliability_threshold
from strandline.smc import Chains, SMCResult, hamiltonian

CHAINS, MOVES = 48, 10
"""Chains side by side, whose draws are run together; moves between two draws, which are then nearly independent."""
FEWEST, MOST = 10, 270
"""Fewest and most batches."""
EFFECTIVE = 1500.0  # effective draws of the worst input with which they end: with 1000, means of 100 were .1 sd off
R_HAT = 1.05  # largest R̂ of the surrogate's chains: in a trap, all once stood still, and all weights were equal


class Expecting(Normalised):
    """The posterior of the likelihood that the surrogate expects."""

    def roughly(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        return self.knowledge.expected(x)


@dataclass(eq=False)
class ExactDraws:
    """The draws of a design; each `propose` is answered by `take`, with the true log-likelihoods."""

    state: ChainState
    normal: Normalised
    random: np.random.Generator
    u: Float[np.ndarray, "chain dim"]
    acceptance: list[float] = field(default_factory=list)
    draws: list[Float[np.ndarray, "chain dim"]] = field(default_factory=list)
    values: list[Float[np.ndarray, " chain"]] = field(default_factory=list)
    ratios: list[Float[np.ndarray, " chain"]] = field(default_factory=list)

    @classmethod
    def of(cls, state: ChainState, normal: Normalised, seed: tuple[int, ...]) -> "ExactDraws":
        """Return chains that start from draws of the surrogate's posterior."""
        random = np.random.default_rng(seed)
        chosen = random.choice(len(state.positions), CHAINS, replace=False)
        return cls(state, normal, random, normal.places(state.positions[chosen]))

    def propose(self) -> Float[np.ndarray, "chain dim"]:
        """Return the inputs of the runs that come next."""
        moved = hamiltonian(
            self.normal.log_density,
            self.normal.force,
            self.u,
            self.state.root,
            self.random,
            steps=MOVES,
            step=self.state.step,
            leaps=self.state.leaps,
        )
        self.u = moved.last
        self.acceptance.append(moved.accepted)
        return self.normal.inputs(self.u)

    def take(self, log_likelihood: Float[np.ndarray, " chain"]) -> None:
        """Weigh the last draws by their log-likelihoods, -inf where no run succeeded."""
        self.draws.append(self.u)
        self.values.append(log_likelihood)
        self.ratios.append(log_likelihood - self.normal.roughly(self.normal.inputs(self.u)))

    @property
    def chains(self) -> Chains:
        """The surrogate's draws."""
        return Chains(np.stack(self.draws), float(np.mean(self.acceptance)), self.state.step)

    @property
    def weights(self) -> SmoothedWeights:
        """The weights of all draws, the largest smoothed."""
        return pareto_smoothed(np.concatenate(self.ratios))

    @property
    def effective(self) -> float:
        """Effective number of draws for the worst input: of the weights, less what the chains repeat."""
        share = self.chains.effective / (CHAINS * len(self.draws))
        return self.weights.ess * min(share, 1.0)

    def result(self) -> SMCResult:
        """Return the draws with their true log-likelihoods, weighted, in two halves of independent chains."""
        true = np.stack(self.values), np.stack(self.ratios)
        return drawn_result(self.normal, self.chains, self.random, true=true)

    @property
    def words(self) -> str:
        """How many draws there are, and how much they weigh."""
        runs = CHAINS * len(self.draws)
        return f"{self.effective:.0f} effective draws from {runs} runs, Pareto k̂ {self.weights.k_hat:.2f}"

    @property
    def done(self) -> bool:
        if len(self.draws) < FEWEST or not self.chains.r_hat <= R_HAT:
            return False
        return self.effective >= EFFECTIVE and self.weights.k_hat < reliability_threshold(CHAINS * len(self.draws))

    @property
    def hopeless(self) -> bool:
        """Whether no more batches are allowed, or half of the effective draws would not be there by then."""
        batches = len(self.draws)
        if batches < FEWEST:
            return False
        return batches >= MOST or self.effective * MOST < EFFECTIVE / 2 * batches
