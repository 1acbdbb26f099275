"""The two log-likelihoods to sample from: the mean of a surrogate, or that of a predicted interface.

Each has the forms that the sampler and the checks need, turns the sample into the posterior, and provides the checks
that it allows.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.calibration.cut_posterior import LARGEST_DIM, cut_by_quadrature
from strandline.design.active import Certificate, FieldOutcome, Knowledge, VarianceEffect, simulator_noise
from strandline.design.refinement import SAMPLING
from strandline.likelihood import OnHost, evaluated, predicted
from strandline.likelihood.mixture import Mixture
from strandline.numerics.threads import one_thread
from strandline.parameters import ParameterSpace
from strandline.posterior import Cut, Posterior
from strandline.posterior.quadrature import QuadratureResult, integrate
from strandline.posterior.weighted import Weighted
from strandline.smc import BatchedLogDensity, SMCResult, sample
from strandline.surrogate import HasHessian, Predictor

__all__ = ["Checks", "FieldTarget", "LogLikelihoodTarget", "Target"]

Point = Float[np.ndarray, " dim"]
Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]
NORMALISED = 1e-7
"""Largest logarithm of the weights' sum: rounding exceeds it if log-likelihoods are of the order of -1e9."""
COMPARED = 2000
"""Particles of the posterior that is reported for comparison."""
SCATTERED = 64
"""Draws of the posterior that show what the simulator's own scatter does there."""
_STEP = 0.1  # step of finite differences, in the given scales


@dataclass(frozen=True, eq=False)
class Checks:
    """Checks of a target's posterior; None for a check that it does not allow.

    Args:
        quadrature: Evidence and moments by direct integration.
        cut_quadrature: The same for the cut posterior, for each value of the nuisance inputs.
        field: What is known about the field, and how it affects the posterior.
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

    @property
    def leading(self) -> tuple[BatchedLogDensity, ...]:
        """Log-likelihoods that lead near it, one after the other, in a fraction of the time."""
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
        """Return the posterior that the sampled particles represent."""
        ...

    def checks(self, sampling: SMCResult, posterior: Posterior, cut: Cut | None, *, seed: int) -> Checks:
        """Return the checks that this target allows."""
        ...


@dataclass(frozen=True, eq=False)
class LogLikelihoodTarget:
    """Mean of a surrogate of the log-likelihood.

    Args:
        process: Surrogate of the log-likelihood.
        space: All inputs.
    """

    process: Predictor
    space: ParameterSpace

    @cached_property
    def compiled(self) -> BatchedLogDensity:
        """The mean: with JAX if it is a Gaussian process, else for NumPy arrays."""
        return predicted(self.process)

    @property
    def leading(self) -> tuple[BatchedLogDensity, ...]:
        """None."""
        return ()

    def values(self, x: Points) -> Values:
        """Return the mean."""
        return np.asarray(self.process.mean(x))

    def hessian(self, x: Point, scales: Point) -> Float[np.ndarray, "dim dim"]:
        """Return the second derivatives of the mean: exact if the surrogate knows them, else central differences."""
        if isinstance(self.process, HasHessian):
            return np.asarray(self.process.hessian(x[None])[0])
        return central_hessian(self.values, x, _STEP * scales, self.space.low, self.space.high)

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
        """Integrate the surrogate directly if the dimension allows it, to check the sampler."""
        cuts = None if cut is None else cut_by_quadrature(self.compiled, cut)
        return Checks(quadrature(self.space, evaluated(self.compiled)), cuts)


@dataclass(frozen=True, eq=False)
class FieldTarget:
    """Log-likelihood expected over the interfaces that the surrogate considers possible.

    It is sampled in closed form; draws of the interfaces weigh off the rest for the joint posterior.

    Args:
        knowledge: Surrogate of the field, its likelihood and feasibility.
        space: All inputs.
        certificate: Certificate of an active design; None for a fixed design.
        beside: Surrogate of the log-likelihood from the same runs, for comparison; None if there is none.
    """

    knowledge: Knowledge
    space: ParameterSpace
    certificate: Certificate | None = None
    beside: Predictor | None = None

    @cached_property
    def compiled(self) -> BatchedLogDensity:
        """Log E[L] in closed form, for NumPy arrays."""
        return OnHost(self.knowledge.nearly_expected)

    @cached_property
    def leading(self) -> tuple[BatchedLogDensity, ...]:
        """Log L by `FieldLikelihood.nearby`, of the predicted interface and expected."""
        known = self.knowledge
        if known.likelihood.nearby is None:
            return ()
        ways = (known.roughly, known.roughly_expected)
        return tuple(OnHost(lambda x, way=way: np.asarray(way(x))) for way in ways)  # type: ignore[misc]

    def values(self, x: Points) -> Values:
        """Return log E[L] in closed form."""
        return self.knowledge.nearly_expected(x)

    def hessian(self, x: Point, scales: Point) -> Float[np.ndarray, "dim dim"]:
        """Return second derivatives by central differences over a tenth of the scales."""
        return central_hessian(self.values, x, _STEP * scales, self.space.low, self.space.high)

    def threads(self) -> AbstractContextManager[Any]:
        """Return a context in which BLAS uses one thread, because its matrices are small."""
        return one_thread()

    def posterior(self, sampling: SMCResult) -> Posterior:
        """Return the particles, reweighted from the sampled log-likelihood to the expected one by draws."""
        expected = self.knowledge.expected(sampling.positions, plug_in=self.knowledge.plug_in(sampling.positions))
        log_weights = sampling.log_weights + expected - sampling.log_likelihood
        log_evidence = sampling.log_evidence + float(logsumexp(log_weights))
        return _posterior(self.space, sampling, log_softmax(log_weights), expected, log_evidence)

    def checks(self, sampling: SMCResult, posterior: Posterior, cut: Cut | None, *, seed: int) -> Checks:
        """Return how the surrogate's variance, feasibility and the other surrogate change the posterior."""
        exact = self.knowledge.plug_in(sampling.positions) - sampling.log_likelihood
        plain = Weighted(sampling.positions, np.exp(log_softmax(sampling.log_weights + exact)))
        effective = float(1.0 / np.sum(plain.weights**2 / np.maximum(posterior.weights, 1e-300)))
        effect = VarianceEffect((posterior.mean - plain.mean) / posterior.sd, posterior.sd / plain.sd, effective)
        feasible = float(posterior.weights @ np.exp(self.knowledge.log_feasibility(posterior.draws)))
        compared = None if self.beside is None else _moments_by(self.beside.mean, self.space, seed)
        inferred = self.knowledge.likelihood.inferred
        without = None
        if inferred is not None and inferred.without is not None:
            without = _moments_by(partial(self._by, inferred.without), self.space, seed)
        scatter = simulator_noise(self.knowledge, posterior.equally_weighted(seed, SCATTERED))
        found = FieldOutcome(self.knowledge, effect, feasible, self.certificate, compared, without, scatter)
        return Checks(field=found)

    def _by(self, likelihood: Mixture, x: Points) -> Values:
        """Return log L of the predicted interface by another likelihood."""
        surrogate = self.knowledge.surrogate
        templates = {name: layout.template for name, layout in surrogate.layouts.items()}
        values = likelihood.many(surrogate.points(surrogate.mean(x)), templates)
        return np.asarray(values + self.knowledge.log_feasibility(x))


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

    Also None for a posterior so narrow that rounding leaves no variance, e.g. if nothing comes near the observation.
    """
    if space.dim > LARGEST_DIM:
        return None
    found = integrate(lambda x: log_likelihood(x) + space.log_prior(x), space.low, space.high)
    return found if (np.diag(found.covariance) > 0).all() else None


def _moments_by(log_likelihood: Callable[[Points], Values], space: ParameterSpace, seed: int) -> dict[str, Point]:
    """Return mean and standard deviations of the posterior of another log-likelihood."""
    initial = space.prior_quantiles(np.random.default_rng(seed).random((COMPARED, space.dim)))
    found = sample(jax.random.key(seed), OnHost(log_likelihood), space.log_prior, initial, settings=SAMPLING)
    moments = Weighted(found.positions, np.exp(found.log_weights))
    return {"mean": moments.mean, "sd": moments.sd}


def central_hessian(
    values: Callable[[Points], Values],
    x: Float[np.ndarray, " dim"],
    step: Float[np.ndarray, " dim"],
    low: Float[np.ndarray, " dim"],
    high: Float[np.ndarray, " dim"],
) -> Float[np.ndarray, "dim dim"]:
    """Return second derivatives by central differences around a point, which is moved inside if x is at the edge."""
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
