"""The log-evidence of a study through its surrogate of the interface, and its error.

The evidence Z = ∫ L p dx is integrated by importance sampling, without the runs and the particles of the sampler: draws
of the prior, and of mixtures that are fitted to the posterior. Three errors add up:

- that of the finite number of draws;
- that of the surrogate: fields are drawn from it, jointly at many draws of the posterior, and each has its own Z;
- that of the region where runs succeed, if the posterior reaches its edge.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from strandline.calibration.importance_sampler import Pool, effective_size, fitted
from strandline.calibration.log_densities import prior_and_posterior
from strandline.design import sobol
from strandline.design.active import Knowledge
from strandline.numerics.threads import one_thread
from strandline.parameters import ParameterSpace
from strandline.posterior import systematic_indices
from strandline.posterior.weighted import Weighted

__all__ = ["Evidence", "evidence_of", "integrated", "log_evidence", "surrogate_error"]

FIRST, DRAWS = 512, 1000
"""Draws of the prior, and of each mixture."""
ENOUGH, ROUNDS = 1500.0, 5
"""Effective sample size at which sampling ends, and the most mixtures that are drawn from."""
SCRAMBLE = 0
"""Seed that scrambles the Sobol sequence of the prior's draws."""
KEPT, FIELDS = 100, 32
"""Draws of the posterior at which possible fields are drawn, and number of these fields."""

TINY = 1e-300
"""Keeps logarithms of weights finite."""

Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]


@dataclass(frozen=True)
class Evidence:
    """A log-evidence with its errors, all in nats.

    Args:
        log: Natural logarithm of the evidence.
        sampling: Standard error due to the finite number of draws.
        surrogate: Standard deviation due to the uncertainty of the surrogate.
        failing: Error due to not knowing exactly where runs fail.
    """

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

    Args:
        knowledge: Surrogate of the interface, its likelihood, and where runs succeed.
        space: All inputs with their priors, which are normalised.
        posterior: Draws of the posterior, which show where to integrate; their weights need not be exact.
        random: Random numbers.
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


def surrogate_error(
    knowledge: Knowledge,
    x: Float[np.ndarray, "draw dim"],
    shares: Float[np.ndarray, " draw"],
    random: np.random.Generator,
) -> float:
    """Return the standard deviation of the log-evidence over the interfaces that the surrogate considers possible.

    Z of a possible field f is that of the expected likelihood times the posterior mean of L_f / E[L].

    Args:
        knowledge: Surrogate of the interface and its likelihood.
        x: Draws of the posterior, all different.
        shares: Their weights, whose sum is 1.
        random: Random numbers that the fields are drawn with.
    """
    expected = knowledge.nearly_expected(x) - knowledge.log_feasibility(x)
    fields = np.stack(
        [
            process.mean(z) + random.standard_normal((FIELDS, len(x))) @ _root(process.covariance(z, z)).T
            for z in [knowledge.surrogate.warping.standardise(x)]
            for process in knowledge.surrogate.processes
        ],
        axis=2,
    )
    values = knowledge.likelihood.at(fields.reshape(-1, fields.shape[2])).reshape(FIELDS, len(x))
    return float(np.std(logsumexp(values - expected + np.log(shares), axis=1), ddof=1))


def _root(covariance: Float[np.ndarray, "draw draw"]) -> Float[np.ndarray, "draw draw"]:
    """Return R with R Rᵀ = covariance, which rounding may have left with tiny negative eigenvalues."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def integrated(knowledge: Knowledge, space: ParameterSpace, posterior: Weighted, random: np.random.Generator) -> Pool:
    """Return draws of the prior and of mixtures that are fitted to the posterior, until enough of them count.

    Args:
        knowledge: Surrogate of the interface, its likelihood, and where runs succeed.
        space: All inputs with their priors, which are normalised.
        posterior: Draws of the posterior, which the first mixture is fitted to; their weights need not be exact.
        random: Random numbers.
    """
    log_densities = prior_and_posterior(space, knowledge.nearly_expected)
    x = space.prior_quantiles(sobol(FIRST, space.dim, scramble=SCRAMBLE))
    first, target = log_densities(x)
    pool = Pool(x=x, log_counts=np.zeros(len(x)), log_first=first, log_target=target, number=len(x))
    mixture = fitted(posterior.draws, np.log(np.maximum(posterior.weights, TINY)), random)
    for _ in range(ROUNDS):
        x = mixture.draw(DRAWS, random)
        pool = pool.extended(mixture, x, *log_densities(x))
        log_weights = pool.log_weights
        if effective_size(log_weights) >= ENOUGH:
            break
        mixture = fitted(pool.x, log_weights, random)
    return pool
