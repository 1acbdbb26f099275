"""Draws of the true posterior: chains whose proposals are those of the surrogate, accepted by runs of the true model.

A proposal is where a few Hamiltonian moves on the surrogate's posterior lead. These leave that posterior as it is, so
with likelihoods L of the true model and L̂ of the surrogate a proposal is accepted with probability
min(1, L'L̂ / (L L̂')): delayed acceptance (Christen and Fox, J. Comput. Graph. Stat. 14, 2005, 795), and with several
moves a surrogate transition (Liu, Monte Carlo Strategies in Scientific Computing, 2001, section 9.4.3). One run of the
true model is made for each proposal; the surrogate no longer learns.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from strandline.design.active.chains import ChainState, Normalised, drawn_result
from strandline.smc import Chains, SMCResult, hamiltonian

CHAINS, MOVES = 16, 10
"""Chains side by side, whose proposals are run together; moves on the surrogate for each."""
WARM = 0.25  # share of the steps that come before the draws
FEWEST, EACH = 60, 10
"""Steps before the chains may end, and between two looks at them."""
STEPS = 800  # most steps
R_HAT, EFFECTIVE = 1.02, 1000.0
"""Largest R̂ and fewest effective draws of the worst input with which the chains end."""


@dataclass(eq=False)
class ExactChain:
    """The chains of a design; each `propose` is answered by `take`, with the true log-likelihoods."""

    state: ChainState
    normal: Normalised
    random: np.random.Generator
    u: Float[np.ndarray, "chain dim"]
    proposed: Float[np.ndarray, "chain dim"]
    ratios: Float[np.ndarray, " chain"] | None = None
    draws: list[Float[np.ndarray, "chain dim"]] = field(default_factory=list)
    values: list[Float[np.ndarray, " chain"]] = field(default_factory=list)
    accepted: list[float] = field(default_factory=list)
    log: Float[np.ndarray, " chain"] | None = None

    @classmethod
    def of(cls, state: ChainState, normal: Normalised, seed: tuple[int, ...]) -> "ExactChain":
        """Return chains that start from draws of the surrogate's posterior."""
        random = np.random.default_rng(seed)
        start = normal.places(state.positions[random.choice(len(state.positions), CHAINS, replace=False)])
        return cls(state, normal, random, start, start)

    def propose(self) -> Float[np.ndarray, "chain dim"]:
        """Return the inputs of the runs that come next: those of the chains' starts first."""
        if self.ratios is not None:
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
            self.proposed = moved.last
        return self.normal.inputs(self.proposed)

    def take(self, log_likelihood: Float[np.ndarray, " chain"]) -> None:
        """Accept or refuse the proposals by their log-likelihoods, -inf where no run succeeded."""
        ratios = log_likelihood - self.normal.roughly(self.normal.inputs(self.proposed))
        if self.ratios is None or self.log is None:
            self.ratios, self.log = ratios, log_likelihood
            return
        change = np.where(np.isneginf(self.ratios), 0.0, ratios - self.ratios)
        chance = np.exp(np.minimum(np.where(np.isneginf(ratios), -np.inf, change), 0.0))
        taken = self.random.random(len(chance)) < chance
        self.u = np.where(taken[:, None], self.proposed, self.u)
        self.ratios, self.log = np.where(taken, ratios, self.ratios), np.where(taken, log_likelihood, self.log)
        self.draws.append(self.u)
        self.values.append(self.log)
        self.accepted.append(float(chance.mean()))

    @property
    def chains(self) -> Chains:
        """The draws that count, of the later steps."""
        first = int(WARM * len(self.draws))
        return Chains(np.stack(self.draws[first:]), float(np.mean(self.accepted[first:])), self.state.step)

    def result(self, number: int) -> SMCResult:
        """Return up to `number` draws of the true posterior, as many as are effective, with their log-likelihoods."""
        first = int(WARM * len(self.draws))
        return drawn_result(self.normal, self.chains, number, self.random, np.stack(self.values[first:]))

    @property
    def words(self) -> str:
        """How many draws there are, and how far the chains agree."""
        found = self.chains
        return (
            f"{found.effective:.0f} effective draws from {CHAINS * (1 + len(self.draws))} runs, R̂ {found.r_hat:.3f}, "
            f"{found.accepted:.0%} of proposals accepted"
        )

    @property
    def done(self) -> bool:
        steps = len(self.draws)
        if steps < FEWEST or steps % EACH:
            return False
        found = self.chains
        return found.r_hat <= R_HAT and found.effective >= EFFECTIVE

    @property
    def hopeless(self) -> bool:
        """Whether the last step is done, or the chains are too slow to have half of the draws by then."""
        steps = len(self.draws)
        if steps < FEWEST * 2 or steps % EACH:
            return False
        return steps >= STEPS or self.chains.effective * STEPS < EFFECTIVE / 2 * steps
