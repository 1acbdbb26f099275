"""The log-evidence of a study through its surrogate of the interface, and its error.

The evidence Z = ∫ L p dx is integrated by importance sampling, without the runs and the particles of the sampler: draws
of the prior, and of mixtures that are fitted to the posterior. Three errors add up:

- that of the finite number of draws;
- that of the surrogate: fields are drawn from it, jointly at many draws of the posterior, and each has its own Z;
- that of the region where runs succeed, if the posterior reaches its edge.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from strandline.calibration.importance_sampler import Pool, effective_size, fitted, prior_and_posterior, prior_pool
from strandline.design import Knowledge
from strandline.foundations import listed, one_thread, require
from strandline.parameters import ParameterSpace
from strandline.posterior import Weighted, systematic_indices

FIRST, DRAWS = 512, 1000  # draws of the prior, and of each mixture
ENOUGH, ROUNDS = 1500.0, 5  # effective sample size at which sampling ends, and the most mixtures that are drawn from
KEPT, FIELDS = 100, 32  # draws of the posterior at which possible fields are drawn, and number of these fields
TINY = 1e-300  # keeps logarithms of weights finite
Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]
SCALE = ((1.0, "positive"), (3.0, "strong"), (5.0, "very strong"))  # least |ln B| of each word
ERRORS = 2.0  # smallest |ln B| of a decision, in standard errors of ln B
CANNOT_TELL = "cannot tell"


@dataclass(frozen=True)
class Evidence:
    """A log-evidence, and its errors from the number of draws, the surrogate, and where runs fail; all in nats."""

    log: float
    sampling: float = 0.0
    surrogate: float = 0.0
    failing: float = 0.0

    def __repr__(self) -> str:
        return f"<Evidence: log {self.log:.4g} ± {self.error:.2g}>"

    @property
    def error(self) -> float:
        """The errors together: the root of their sum of squares."""
        return math.hypot(self.sampling, self.surrogate, self.failing)


def log_evidence(
    knowledge: Knowledge, space: ParameterSpace, posterior: Weighted, random: np.random.Generator
) -> Evidence:
    """Return the log-evidence that the surrogate of the interface gives.

    Draws of the posterior show where to integrate; their weights need not be exact.
    """
    with one_thread():
        return evidence_of(knowledge, integrated(knowledge, space, posterior, random), random)


def evidence_of(knowledge: Knowledge, pool: Pool, random: np.random.Generator) -> Evidence:
    """Return the log-evidence of likelihood times prior, with its errors, from draws that `integrated` returned."""
    log_weights = pool.log_weights
    weights = np.exp(log_weights)
    some = weights > 0
    feasible = float(weights[some] @ np.exp(knowledge.log_feasibility(pool.x[some])))
    chosen, counts = np.unique(systematic_indices(weights, KEPT, random), return_counts=True)
    return Evidence(
        log=float(logsumexp(pool.log_ratios)),
        sampling=math.sqrt(max(1.0 / effective_size(log_weights) - 1.0 / len(pool.x), 0.0)),
        surrogate=surrogate_error(knowledge, pool.x[chosen], counts / KEPT, random),
        failing=-math.log(min(feasible, 1.0)),
    )


def surrogate_error(knowledge: Knowledge, x: Points, shares: Values, random: np.random.Generator) -> float:
    """Return the standard deviation of the log-evidence over the interfaces that the surrogate considers possible.

    Z of a possible field f is that of the expected likelihood times the posterior mean of L_f / E[L], over different
    draws x of the posterior with weights `shares`.
    """
    expected = knowledge.nearly_expected(x) - knowledge.log_feasibility(x)
    z, drawn = knowledge.surrogate.warping.standardise(x), []
    for process in knowledge.surrogate.processes:
        values, vectors = np.linalg.eigh(process.covariance(z, z))
        root = vectors * np.sqrt(np.maximum(values, 0.0))  # rounding may have left tiny negative ones
        drawn.append(process.mean(z) + random.standard_normal((FIELDS, len(x))) @ root.T)
    fields = np.stack(drawn, axis=2)
    values = knowledge.likelihood.at(fields.reshape(-1, fields.shape[2])).reshape(FIELDS, len(x))
    return float(np.std(logsumexp(values - expected + np.log(shares), axis=1), ddof=1))


def integrated(knowledge: Knowledge, space: ParameterSpace, posterior: Weighted, random: np.random.Generator) -> Pool:
    """Return draws of the prior and of mixtures that are fitted to the posterior, until enough of them count."""
    log_densities = prior_and_posterior(space, knowledge.nearly_expected)
    pool = prior_pool(space, log_densities, FIRST)
    mixture = fitted(posterior.draws, np.log(np.maximum(posterior.weights, TINY)), random)
    for _ in range(ROUNDS):
        x = mixture.draw(DRAWS, random)
        pool = pool.extended(mixture, x, *log_densities(x))
        log_weights = pool.log_weights
        if effective_size(log_weights) >= ENOUGH:
            break
        mixture = fitted(pool.x, log_weights, random)
    return pool


def in_words(ln: float, error: float) -> str:
    """Return how strong the evidence is for ln B, in nats; ``cannot tell`` below 1, or below two standard errors of it.

    The words are those of Kass and Raftery (1995), who scale 2 ln B.
    """
    size = abs(ln)
    if not (size >= SCALE[0][0] and size >= ERRORS * error):  # also if one of them is not a number
        return CANNOT_TELL
    return next(word for least, word in reversed(SCALE) if size >= least)


@dataclass(frozen=True)
class BayesFactor:
    """The ratio of two models' evidences, the larger one first: its logarithm, at least 0, and error, in nats."""

    of: str
    over: str
    ln: float
    error: float

    def __repr__(self) -> str:
        return f"<BayesFactor of {self.of} over {self.over}: ln B = {self.ln:.3g} ± {self.error:.2g}, {self.words}>"

    @property
    def words(self) -> str:
        return in_words(self.ln, self.error)

    @property
    def decided(self) -> bool:
        return self.words != CANNOT_TELL


@dataclass(frozen=True)
class ModelComparison:
    """Evidences of models of the same data, with prior odds of the models, above 0; equal if omitted.

    Raises:
        InvalidInput: Fewer than two models, or odds that are not finite numbers above 0, one for each model.
    """

    evidences: Mapping[str, Evidence]
    odds: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        require(len(self.evidences) >= 2, "models to compare", len(self.evidences), "at least 2", "Give another one.")
        if self.odds is not None:
            require_odds([self.odds.get(name, math.nan) for name in self.evidences], len(self.evidences))

    def __repr__(self) -> str:
        return f"<ModelComparison: {self.verdict}>"

    @cached_property
    def order(self) -> tuple[str, ...]:
        """Names of the models, that with the largest evidence first."""
        return tuple(sorted(self.evidences, key=lambda name: -self.evidences[name].log))

    @cached_property
    def factors(self) -> tuple[BayesFactor, ...]:
        """The Bayes factor of each pair of models, those of the best one first."""
        return tuple(self._factor(one, other) for one, other in combinations(self.order, 2))

    @property
    def prior(self) -> dict[str, float]:
        odds = self.odds or dict.fromkeys(self.evidences, 1.0)
        whole = sum(odds[name] for name in self.evidences)
        return {name: odds[name] / whole for name in self.evidences}

    @cached_property
    def probabilities(self) -> dict[str, float]:
        logs = np.array([self.evidences[name].log + math.log(share) for name, share in self.prior.items()])
        weights = np.exp(logs - logs.max())
        return dict(zip(self.prior, (weights / weights.sum()).tolist(), strict=True))

    @property
    def favoured(self) -> str | None:
        """The model that is preferred to every other one; None if there is none."""
        best = self.order[0]
        return best if all(one.decided for one in self._of_best) else None

    @property
    def tied(self) -> tuple[str, ...]:
        """The models between which the data cannot tell: the best one and those that it is not preferred to."""
        return (self.order[0], *(one.over for one in self._of_best if not one.decided))

    @property
    def verdict(self) -> str:
        """Which model the data favour, or that they cannot tell, in one sentence."""
        if self.favoured is not None:
            second = self._of_best[0]
            return f"The data favour {second.of} over {second.over}: ln B = {_shown(second)}, {second.words} evidence."
        nearest = next(one for one in self._of_best if not one.decided)
        found = f"ln B = {_shown(nearest)} of {nearest.of} over {nearest.over}"
        if nearest.ln < SCALE[0][0]:
            return f"The data cannot tell {listed(self.tied)} apart: {found}, below 1."
        return (
            f"The data cannot tell {listed(self.tied)} apart: {found}, less than {ERRORS:g} errors. "
            "More runs, or more particles, make the error smaller."
        )

    @property
    def _of_best(self) -> tuple[BayesFactor, ...]:
        return self.factors[: len(self.order) - 1]

    def _factor(self, one: str, other: str) -> BayesFactor:
        first, second = self.evidences[one], self.evidences[other]
        return BayesFactor(one, other, first.log - second.log, math.hypot(first.error, second.error))


def require_odds(odds: Sequence[float], number: int) -> None:
    """Refuse with InvalidInput prior odds that are not numbers above 0, one for each model."""
    right = len(odds) == number and all(math.isfinite(one) and one > 0 for one in odds)
    value, expected = ":".join(f"{one:g}" for one in odds), f"{number} numbers above 0, one for each model"
    require(right, "prior odds of the models", value, expected, "Give them in the order of the models, e.g. 2:1.")


def averaged(posteriors: Sequence[Weighted], probabilities: Sequence[float]) -> Weighted:
    """Return the mixture of the posteriors of several models, each with the probability of its model."""
    draws = np.concatenate([one.draws for one in posteriors])
    weights = [share * one.weights for one, share in zip(posteriors, probabilities, strict=True)]
    return Weighted(draws, np.concatenate(weights))


def _shown(one: BayesFactor) -> str:
    return f"{one.ln:.2f} ± {one.error:.2f}"
