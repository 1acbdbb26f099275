"""The two log-likelihoods that a sampler may be given: the mean of a surrogate, or that of a predicted interface.

Each comes in the forms that the sampler and the checks need, turns what was sampled into the posterior, and brings the
checks that it allows.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.calibration.cut_posterior import LARGEST_DIM, cut_by_quadrature
from strandline.design.active import Certificate, FieldOutcome, Knowledge, VarianceEffect
from strandline.design.refinement import SAMPLING
from strandline.likelihood import OnHost
from strandline.numerics.one_thread import one_thread
from strandline.parameters import ParameterSpace
from strandline.posterior import Cut, Posterior
from strandline.posterior.quadrature import QuadratureResult, integrate
from strandline.posterior.weighted import Weighted
from strandline.smc import BatchedLogDensity, SMCResult, sample
from strandline.surrogate import GaussianProcess, batched_mean

__all__ = ["Checks", "FieldTarget", "LogLikelihoodTarget", "Target"]

Point = Float[np.ndarray, " dim"]
Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]
NORMALISED = 1e-7
"""Largest logarithm of the weights' sum: rounding exceeds it where log-likelihoods are of the order of -1e9."""
COMPARED = 2000
"""Particles of the posterior that is reported beside the study's own."""
_STEP = 0.1  # of finite differences, in the given scales


@dataclass(frozen=True, eq=False)
class Checks:
    """What a target says of its posterior; None or left out where it does not allow the check.

    Args:
        quadrature: Evidence and moments by direct integration.
        cut_quadrature: The same of the cut posterior, for each value of the nuisance inputs.
        field: What is known of the field, and how it affects the posterior.
    """

    quadrature: QuadratureResult | None = None
    cut_quadrature: tuple[QuadratureResult, ...] | None = None
    field: FieldOutcome | None = None


@runtime_checkable
class Target(Protocol):
    """A log-likelihood to sample from."""

    @property
    def compiled(self) -> BatchedLogDensity:
        """For the sampler: a JAX function, or one that asks for NumPy arrays."""
        ...

    def values(self, x: Points) -> Values:
        """Return the log-likelihood of NumPy arrays."""
        ...

    def hessian(self, x: Point, scales: Point) -> Float[np.ndarray, "dim dim"]:
        """Return the second derivatives at a point, given the scales of the inputs there."""
        ...

    def threads(self) -> AbstractContextManager[Any]:
        """Return a context in which the log-likelihood is evaluated fastest."""
        ...

    def posterior(self, sampling: SMCResult) -> Posterior:
        """Return the posterior that the sampled particles stand for."""
        ...

    def checks(self, sampling: SMCResult, posterior: Posterior, cut: Cut | None, *, seed: int) -> Checks:
        """Return the checks that this target allows."""
        ...


@dataclass(frozen=True, eq=False)
class LogLikelihoodTarget:
    """Mean of a surrogate of the log-likelihood.

    Args:
        process: Gaussian process of the log-likelihood.
        space: All inputs.
    """

    process: GaussianProcess
    space: ParameterSpace

    @cached_property
    def compiled(self) -> BatchedLogDensity:
        """The mean, with JAX."""
        return batched_mean(self.process)

    def values(self, x: Points) -> Values:
        """Return the mean."""
        return np.asarray(self.process.mean(x))

    def hessian(self, x: Point, scales: Point) -> Float[np.ndarray, "dim dim"]:
        """Return the exact second derivatives of the mean."""
        return np.asarray(self.process.hessian(x[None])[0])

    def threads(self) -> AbstractContextManager[Any]:
        """Return a context that changes nothing."""
        return nullcontext()

    def posterior(self, sampling: SMCResult) -> Posterior:
        """Return the particles as they are."""
        log_weights = sampling.log_weights
        if abs(float(logsumexp(log_weights))) > NORMALISED:
            log_weights = log_softmax(log_weights)
        return _posterior(self.space, sampling, log_weights, sampling.log_likelihood, sampling.log_evidence)

    def checks(self, sampling: SMCResult, posterior: Posterior, cut: Cut | None, *, seed: int) -> Checks:
        """Integrate the surrogate directly, as far as the dimension allows it: the check of the sampler."""
        cuts = None if cut is None else cut_by_quadrature(self.compiled, cut)
        return Checks(quadrature(self.space, jax.jit(self.compiled)), cuts)


@dataclass(frozen=True, eq=False)
class FieldTarget:
    """Log-likelihood of the predicted interface; the posterior has that expected over possible interfaces.

    Args:
        knowledge: Surrogate of the field, its likelihood and feasibility.
        space: All inputs.
        certificate: What speaks for an active design; None for a fixed one.
        beside: Gaussian process of the log-likelihood from the same runs, to compare; None if there is none.
    """

    knowledge: Knowledge
    space: ParameterSpace
    certificate: Certificate | None = None
    beside: GaussianProcess | None = None

    @cached_property
    def compiled(self) -> BatchedLogDensity:
        """Log L of the predicted interface, for NumPy arrays."""
        return OnHost(self.knowledge.plug_in)

    def values(self, x: Points) -> Values:
        """Return log L of the predicted interface."""
        return np.asarray(self.knowledge.plug_in(x))

    def hessian(self, x: Point, scales: Point) -> Float[np.ndarray, "dim dim"]:
        """Return second derivatives by central differences over a tenth of the scales."""
        return central_hessian(self.values, x, _STEP * scales, self.space.low, self.space.high)

    def threads(self) -> AbstractContextManager[Any]:
        """Return a context in which BLAS uses one thread, for its matrices are small."""
        return one_thread()

    def posterior(self, sampling: SMCResult) -> Posterior:
        """Return the particles, weighted from the log-likelihood that was sampled to the expected one."""
        expected = self.knowledge.expected(sampling.positions)
        log_weights = sampling.log_weights + expected - sampling.log_likelihood
        log_evidence = sampling.log_evidence + float(logsumexp(log_weights))
        return _posterior(self.space, sampling, log_softmax(log_weights), expected, log_evidence)

    def checks(self, sampling: SMCResult, posterior: Posterior, cut: Cut | None, *, seed: int) -> Checks:
        """Return what the surrogate's variance, feasibility and the other surrogate make of the posterior."""
        weights = np.exp(sampling.log_weights)
        plain = Weighted(sampling.positions, weights)
        ratios = posterior.weights / np.maximum(weights, 1e-300)
        effective = float(1.0 / (weights @ ratios**2))
        effect = VarianceEffect((posterior.mean - plain.mean) / posterior.sd, posterior.sd / plain.sd, effective)
        feasible = float(posterior.weights @ np.exp(self.knowledge.log_feasibility(posterior.draws)))
        compared = None if self.beside is None else _moments_by(self.beside, self.space, seed)
        return Checks(field=FieldOutcome(self.knowledge, effect, feasible, self.certificate, compared))


def _posterior(
    space: ParameterSpace,
    sampling: SMCResult,
    log_weights: Float[np.ndarray, " particle"],
    log_likelihood: Float[np.ndarray, " particle"],
    log_evidence: float,
) -> Posterior:
    return Posterior(
        space=space,
        draws=sampling.positions,
        log_weights=log_weights,
        log_likelihood=log_likelihood,
        log_prior=sampling.log_prior,
        log_evidence=log_evidence,
    )


def quadrature(space: ParameterSpace, log_likelihood: Callable[[Any], Any]) -> QuadratureResult | None:
    """Integrate the posterior of a log-likelihood; None for more than three inputs.

    None, too, for a posterior so narrow that rounding leaves no variance, as where nothing comes near the observation.
    """
    if space.dim > LARGEST_DIM:
        return None
    found = integrate(lambda x: log_likelihood(x) + space.log_prior(x), space.low, space.high)
    return found if (np.diag(found.covariance) > 0).all() else None


def _moments_by(process: GaussianProcess, space: ParameterSpace, seed: int) -> dict[str, Point]:
    """Return mean and standard deviations of the posterior by a surrogate of the log-likelihood."""
    initial = space.prior_quantiles(np.random.default_rng(seed).random((COMPARED, space.dim)))
    found = sample(jax.random.key(seed), OnHost(process.mean), space.log_prior, initial, settings=SAMPLING)
    moments = Weighted(found.positions, np.exp(found.log_weights))
    return {"mean": moments.mean, "sd": moments.sd}


def central_hessian(
    values: Callable[[Points], Values],
    x: Float[np.ndarray, " dim"],
    step: Float[np.ndarray, " dim"],
    low: Float[np.ndarray, " dim"],
    high: Float[np.ndarray, " dim"],
) -> Float[np.ndarray, "dim dim"]:
    """Return second derivatives by central differences, around a point that is moved inside where x is at the edge."""
    dim = len(x)
    step = np.minimum(step, (high - low) / 4)
    x = np.clip(x, low + step, high - step)
    signs = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    E = np.diag(step)
    points = [x, *(x + s * E[i] for i in range(dim) for s in (1, -1))]
    pairs = [(i, j) for i in range(dim) for j in range(i)]
    points += [x + a * E[i] + b * E[j] for i, j in pairs for a, b in signs]
    f = values(np.array(points))
    H = np.empty((dim, dim))
    for i in range(dim):
        H[i, i] = (f[1 + 2 * i] - 2 * f[0] + f[2 + 2 * i]) / step[i] ** 2
    for k, (i, j) in enumerate(pairs):
        pp, pm, mp, mm = f[1 + 2 * dim + 4 * k : 5 + 2 * dim + 4 * k]
        H[i, j] = H[j, i] = (pp - pm - mp + mm) / (4 * step[i] * step[j])
    return H
