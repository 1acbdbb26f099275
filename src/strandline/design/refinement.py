"""Designs that do not depend on the posterior so far, and rounds of further runs where it lies.

A Sobol sequence fills the unit cube. Each round (Willmann et al. 2022, Remark 7) samples the posterior of the surrogate
so far, runs the simulator at some of the particles, and trains the surrogate again with all runs. The difference
between what the surrogate had predicted there and the results of the runs is an honest measure of its error, because it
was not trained with these runs.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax
from scipy.stats import qmc

from strandline.foundations import require_types
from strandline.likelihood import predicted
from strandline.parameters import ParameterSpace
from strandline.posterior import Weighted
from strandline.runs import RunRecord
from strandline.smc import SMCSettings, require, sample
from strandline.surrogate import LogLikelihoodSurrogate

__all__ = ["SAMPLING", "Learnt", "Refinement", "Round", "over_prior", "refine", "shifts", "sobol"]

MOST_POINTS = 2**24
MOST_INPUTS = qmc.Sobol.MAXDIM  # largest number of inputs for which direction numbers are known


def sobol(number: int, dim: int, *, scramble: int | None = None) -> Float[np.ndarray, "run dim"]:
    """Return the first `number` points of one Sobol sequence in the unit cube.

    Designs are nested: a larger one begins with the smaller one and reuses its runs. `scramble` is the seed of an Owen
    scrambling; None (the default) is the plain sequence, whose first point is the origin.

    Raises:
        InvalidInput: `number` or `dim` below 1, or more than the sequence has.
    """
    right, value = 1 <= number <= MOST_POINTS and 1 <= dim <= MOST_INPUTS, f"{number} points in {dim} dimensions"
    expected = f"at least 1 of each, at most {MOST_POINTS} points and {MOST_INPUTS} dimensions"
    require(right, "size of the Sobol design", value, expected, remedy="Ask for another number of runs.")
    engine = qmc.Sobol(dim, scramble=scramble is not None, rng=scramble)
    return np.asarray(engine.random_base2(max(number - 1, 0).bit_length())[:number])


def over_prior(space: ParameterSpace, number: int, *, scramble: int | None = None) -> Float[np.ndarray, "run dim"]:
    """Return physical points of a Sobol sequence in the prior's quantiles; the plain one without the origin, a corner.

    In many dimensions most of a box lies where a normal prior has no mass.
    """
    first = int(scramble is None)
    return space.prior_quantiles(sobol(first + number, space.dim, scramble=scramble)[first:])


SAMPLING = SMCSettings(rejuvenation_steps=10, zeta=0.5)
"""Settings of the samplings between rounds: cheaper than the one for the final posterior."""
STREAM = 3  # keeps the random numbers of the rounds apart from all others of the same seed


@dataclass(frozen=True)
class Refinement:
    """How a design is refined.

    Args:
        rounds: Number of further rounds of runs where the posterior lies.
        runs: Runs per round, at most as many as particles.
        temperature: Exponent γ: half of a round's runs come from the posterior, half from likelihood^γ × prior, to
            cover its flanks; with 1, all come from the posterior.

    Raises:
        InvalidInput: a number out of its range.
    """

    rounds: int = 0
    runs: int = 100
    temperature: float = 0.4

    def __post_init__(self) -> None:
        require_types(self)
        require(self.rounds >= 0, "rounds of the refinement", self.rounds, "0 or more")
        require(self.runs >= 1, "runs of a round of the refinement", self.runs, "at least 1")
        require(0 < self.temperature <= 1, "temperature of the refinement", self.temperature, "above 0, at most 1")

    @property
    def total(self) -> int:
        """Runs of all rounds."""
        return self.rounds * self.runs


@dataclass(frozen=True, eq=False)
class Learnt:
    """The runs so far and the surrogates that they trained, by measure; the first measure defines the posterior.

    `design` has the physical inputs of all runs, in the order of their records, `training` those of the successful
    ones, in the same order, with their log-likelihoods. `made` are all runs as they were made, if `records` hold
    corrected ones of a cheaper model; else it is empty.
    """

    design: Float[np.ndarray, "run dim"]
    records: tuple[RunRecord, ...]
    training: Float[np.ndarray, "ok dim"]
    log_likelihoods: Mapping[str, Float[np.ndarray, " ok"]]
    surrogates: Mapping[str, LogLikelihoodSurrogate]
    made: tuple[RunRecord, ...] = ()

    @property
    def log_likelihood(self) -> Float[np.ndarray, " ok"]:
        """Log-likelihoods of the successful runs under the first measure, shape (ok,)."""
        return next(iter(self.log_likelihoods.values()))

    @property
    def surrogate(self) -> LogLikelihoodSurrogate:
        """Surrogate of the first measure."""
        return next(iter(self.surrogates.values()))


@dataclass(frozen=True, eq=False)
class Round:
    """Result of one round: how good the surrogate was that it began with, which `n_train` runs had trained.

    `error_rms` is the root mean square of predicted minus true log-likelihood over the successful runs,
    `error_rms_posterior` over those drawn from the posterior itself, not from the tempered one; None if there are none.
    """

    n_train: int
    runs: int
    failed: int
    error_rms: float | None
    error_rms_posterior: float | None
    mean: Float[np.ndarray, " dim"]
    sd: Float[np.ndarray, " dim"]


def refine(
    learnt: Learnt,
    extend: Callable[[Learnt, Float[np.ndarray, "run dim"]], Learnt],
    space: ParameterSpace,
    refinement: Refinement,
    *,
    particles: int,
    seed: int,
    stage: Callable[[], AbstractContextManager[Any]] = nullcontext,
) -> tuple[Learnt, tuple[Round, ...]]:
    """Return what is learnt after all rounds, and a report on each.

    The same arguments give the same inputs to the bit, so runs kept in a ledger are found again. `extend` makes runs at
    further inputs and trains the surrogate with all of them, the new ones last; `stage` returns a context for each of
    the samplings between rounds, which have this number of particles.
    """
    rounds = []
    for number in range(refinement.rounds):
        with stage():
            own, others, posterior = _propose(learnt.surrogate, space, refinement, particles, (seed, STREAM, number))
        after = extend(learnt, np.concatenate([own, others]))
        rounds.append(_account(learnt, after, len(own), posterior))
        learnt = after
    return learnt, tuple(rounds)


def shifts(
    rounds: Sequence[Round], final: Float[np.ndarray, " dim"], sd: Float[np.ndarray, " dim"]
) -> tuple[Float[np.ndarray, " dim"], ...]:
    """Return how far each round has moved the posterior means (dim,), in standard deviations after it.

    `final` and `sd` are means and standard deviations of the posterior after the last round.
    """
    means, deviations = [r.mean for r in rounds] + [final], [r.sd for r in rounds] + [sd]
    return tuple((means[k + 1] - means[k]) / deviations[k + 1] for k in range(len(rounds)))


def _propose(
    surrogate: LogLikelihoodSurrogate,
    space: ParameterSpace,
    refinement: Refinement,
    particles: int,
    seed: tuple[int, ...],
) -> tuple[Float[np.ndarray, "own dim"], Float[np.ndarray, "other dim"], Weighted]:
    """Sample π_γ once; weights L^(1 - γ) turn the same particles into draws from the posterior.

    Return inputs of runs from the posterior itself, others from π_γ, and that posterior.
    """
    rng = np.random.default_rng(seed)
    gamma = refinement.temperature
    initial = space.prior_quantiles(rng.random((particles, space.dim)))
    key = jax.random.key(int(rng.integers(2**32)))
    tempered = sample(key, predicted(surrogate.process, power=gamma), space.log_prior, initial, settings=SAMPLING)
    rest = (1.0 / gamma - 1.0) * tempered.log_likelihood
    log_weights = log_softmax(tempered.log_weights + rest)
    positions = tempered.positions
    posterior = Weighted(positions, np.exp(log_weights))
    own = refinement.runs if gamma == 1.0 else refinement.runs - refinement.runs // 2
    first = _distinct(positions, log_weights, own, rng, positions[:0])
    second = _distinct(positions, tempered.log_weights, refinement.runs - own, rng, first)
    return first, second, posterior


def _distinct(
    positions: Float[np.ndarray, "particle dim"],
    log_weights: Float[np.ndarray, " particle"],
    number: int,
    rng: np.random.Generator,
    taken: Float[np.ndarray, "other dim"],
) -> Float[np.ndarray, "run dim"]:
    """Return `number` weighted draws, no position twice and none of `taken`: a repeated run teaches nothing. Sampling
    without replacement: the largest sums of log weight and Gumbel noise.
    """
    rows, member = np.unique(positions, axis=0, return_inverse=True)
    total = np.full(len(rows), -np.inf)
    np.logaddexp.at(total, member.ravel(), log_weights)
    known = {row.tobytes() for row in taken}
    free = np.array([row.tobytes() not in known for row in rows])
    score = np.where(free, total + rng.gumbel(size=len(rows)), -np.inf)
    best = np.argsort(-score, kind="stable")[: min(number, int(np.isfinite(score).sum()))]
    return np.asarray(rows[best])


def _account(before: Learnt, after: Learnt, proposed: int, posterior: Weighted) -> Round:
    records = after.records[len(before.records) :]
    ok = np.array([record.ok for record in records], bool)
    found, at = after.log_likelihood[len(before.training) :], after.training[len(before.training) :]
    error = before.surrogate.process.mean(at) - found
    own = (np.arange(len(records)) < proposed)[ok]
    return Round(
        n_train=len(before.training),
        runs=len(records),
        failed=int((~ok).sum()),
        error_rms=_rms(error),
        error_rms_posterior=_rms(error[own]),
        mean=posterior.mean,
        sd=posterior.sd,
    )


def _rms(values: Float[np.ndarray, " run"]) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None
