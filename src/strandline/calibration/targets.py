"""The two log-likelihoods to sample from: the mean of a surrogate, or that of a predicted interface.

Each has the forms that the sampler and the checks need, turns the sample into the posterior, and provides the checks
that it allows.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.calibration.problem import MANY, Settings
from strandline.design import (
    SAMPLING,
    Certificate,
    ExactDraws,
    FieldOutcome,
    Knowledge,
    Normalised,
    State,
    VarianceEffect,
    sample_by_chains,
    simulator_noise,
)
from strandline.foundations import one_thread
from strandline.likelihood import Mixture, differences, evaluated, predicted, second_differences
from strandline.parameters import ParameterSpace
from strandline.posterior import (
    Cut,
    MarginalPosterior,
    Posterior,
    QuadratureResult,
    UnderUncertainty,
    Weighted,
    integrate,
    nuisance_values,
    pooled,
)
from strandline.smc import BatchedLogDensity, OnHost, SMCResult, is_on_host, sample, sample_each
from strandline.surrogate import HasHessian, Predictor

Point = Float[np.ndarray, " dim"]
Matrix = Float[np.ndarray, "dim dim"]
Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]
ZETA = 0.5  # share of the effective sample size that a tempering step keeps: enough for moments
MIXED = 1.05  # largest R̂ of chains that have mixed
FEWEST_PARTICLES = 250  # fewest particles for each value of the nuisance inputs: 150 gave errors of 5 % of an sd
STREAM = 2  # keeps these random numbers apart from the two streams of the joint reading
LARGEST_DIM = 3  # largest number of inputs, nuisance ones included, for which posteriors are also integrated directly
COMPARED = 2000  # particles of the posterior that is reported for comparison
SCATTERED = 64  # draws of the posterior that show what the simulator's own scatter does there
LEAST_LEFT = 10.0
"""Effective particles of a reweighted posterior, at least: of 2000 one is left where the model misses the observation
by thousands of the noise's standard deviations, and a single one has no width."""
_STEP = 0.1  # step of finite differences, in the given scales


def under_uncertainty(posterior: Posterior, log_likelihood: BatchedLogDensity, settings: Settings) -> UnderUncertainty:
    """Return both readings of the posterior of the calibrated inputs: joint and cut.

    For the cut reading, p(x | θ, Y) is sampled, in longer steps, for values θ that represent p(θ), and pooled.
    """
    space = posterior.space
    theta, calibrated = nuisance_values(space, settings.nuisance_values), space.calibrated_space
    start, chain = jax.random.split(jax.random.fold_in(jax.random.key(settings.seed), STREAM))
    each = max(FEWEST_PARTICLES, -(-settings.particles // len(theta)))
    uniform = jax.random.uniform(start, (len(theta) * each, calibrated.dim), dtype=float)
    initial = calibrated.prior_quantiles(np.asarray(uniform)).reshape(len(theta), each, -1)
    longer = replace(settings.smc, zeta=min(ZETA, settings.smc.zeta))
    given = _given(space, log_likelihood)
    found = sample_each(chain, given, calibrated.log_prior, initial, theta, settings=longer)
    return UnderUncertainty(MarginalPosterior(posterior), pooled(space, theta, found))


def cut_by_quadrature(log_likelihood: BatchedLogDensity, cut: Cut) -> tuple[QuadratureResult, ...] | None:
    """Integrate p(x | θ, Y) directly for each θ of a cut reading; None for more than three inputs."""
    space = cut.extended.space
    if space.dim > LARGEST_DIM:
        return None
    calibrated, given = space.calibrated_space, _given(space, log_likelihood)
    found = given.of_one_value if is_on_host(given) else jax.jit(given)

    def log_density(x: Float[np.ndarray, "point x"], theta: Float[np.ndarray, " nuisance"]) -> Any:
        return np.asarray(found(x, theta)) + calibrated.log_prior(x)

    return tuple(integrate(partial(log_density, theta=theta), calibrated.low, calibrated.high) for theta in cut.values)


@dataclass(frozen=True)
class _GivenOnHost:
    """log L for NumPy arrays of calibrated inputs and of as many nuisance inputs."""

    log_likelihood: Callable[[Points], Values]
    order: tuple[int, ...]
    on_host = True

    def __call__(self, x: Float[np.ndarray, "point x"], theta: Float[np.ndarray, "point nuisance"]) -> Values:
        return self.log_likelihood(np.ascontiguousarray(np.concatenate([x, theta], axis=1)[:, self.order]))

    def of_one_value(self, x: Float[np.ndarray, "point x"], theta: Float[np.ndarray, " nuisance"]) -> Values:
        return self(x, np.tile(theta, (len(x), 1)))


def _given(space: ParameterSpace, log_likelihood: Any) -> Any:
    order = np.argsort([*space.calibrated, *space.nuisance])
    if is_on_host(log_likelihood):
        return _GivenOnHost(log_likelihood, tuple(order.tolist()))

    def given(x: Float[jax.Array, "particle x"], theta: Float[jax.Array, " nuisance"]) -> Float[jax.Array, " particle"]:
        fixed = jnp.broadcast_to(theta, (len(x), len(theta)))
        values: jax.Array = log_likelihood(jnp.concatenate([x, fixed], axis=1)[:, order])
        return values

    return given


@dataclass(frozen=True, eq=False)
class LogLikelihoodTarget:
    """Mean of a surrogate of the log-likelihood; no other one leads near it in a fraction of the time."""

    warm_up_densities: ClassVar[tuple[BatchedLogDensity, ...]] = ()
    process: Predictor
    space: ParameterSpace

    @cached_property
    def compiled(self) -> BatchedLogDensity:
        """For the sampler: a JAX function, or one that asks for NumPy arrays."""
        return predicted(self.process)

    def values(self, x: Points) -> Values:
        """Return the log-likelihood of NumPy arrays."""
        return np.asarray(self.process.mean(x))

    def hessian(self, x: Point, scales: Point) -> Float[np.ndarray, "dim dim"]:
        """Return the second derivatives of the mean: exact if the surrogate knows them, else central differences."""
        if isinstance(self.process, HasHessian):
            return np.asarray(self.process.hessian(x[None])[0])
        return central_hessian(self.values, x, _STEP * scales, self.space.low, self.space.high)

    def threads(self) -> AbstractContextManager[Any]:
        """Return a context in which the log-likelihood is evaluated fastest."""
        return nullcontext()

    def posterior(self, sampling: SMCResult) -> Posterior:
        given = sampling.log_weights, sampling.log_likelihood, sampling.log_evidence
        return _posterior(self.space, sampling, *given)

    def checks(self, sampling: SMCResult, posterior: Posterior, cut: Cut | None, *, seed: int) -> dict[str, Any]:
        """Return the fields of a `Calibration` with integrals of the surrogate, if the dimension allows them."""
        cuts = None if cut is None else cut_by_quadrature(self.compiled, cut)
        return {"quadrature": quadrature(self.space, evaluated(self.compiled)), "cut_quadrature": cuts}


@dataclass(frozen=True, eq=False)
class FieldTarget:
    """Log-likelihood expected over the interfaces that the surrogate considers possible.

    It is sampled in closed form; draws of the interfaces weigh off the rest for the joint posterior. `beside` is a
    surrogate of the log-likelihood from the same runs, for comparison.
    """

    knowledge: Knowledge
    space: ParameterSpace
    certificate: Certificate | None = None
    beside: Predictor | None = None
    sampled: State | None = None
    exact: ExactDraws | None = None

    def chains(self, settings: Settings) -> SMCResult | None:
        """Return draws by chains, which many inputs need: of the true posterior if there are any; else None.

        Chains that do not mix, as in a curved valley, leave fewer inputs to tempered particles.
        """
        if self.exact is not None:
            return self.exact.result()
        if not self.knowledge.surrogate.shares_kernel:
            return None
        found, r_hat = sample_by_chains(self.knowledge, self.space, settings.seed, settings.particles, self.sampled)
        return found if r_hat <= MIXED or self.space.dim > MANY else None

    @cached_property
    def compiled(self) -> BatchedLogDensity:
        return OnHost(self.knowledge.nearly_expected)

    @cached_property
    def warm_up_densities(self) -> tuple[BatchedLogDensity, ...]:
        """Log L by `FieldLikelihood.nearby`, of the predicted interface and expected."""
        known = self.knowledge
        if known.likelihood.nearby is None:
            return ()
        ways = (known.roughly, known.roughly_expected)
        return tuple(OnHost(lambda x, way=way: np.asarray(way(x))) for way in ways)  # type: ignore[misc]

    def values(self, x: Points) -> Values:
        return self.knowledge.nearly_expected(x)

    def hessian(self, x: Point, scales: Point) -> Float[np.ndarray, "dim dim"]:
        """Return second derivatives by central differences over a tenth of the scales; of many inputs those of a
        parabola of the residuals (Gauss and Newton).
        """
        if self.space.dim > MANY:
            return -Normalised(self.space, self.knowledge).information(x)
        return central_hessian(self.values, x, _STEP * scales, self.space.low, self.space.high)

    def threads(self) -> AbstractContextManager[Any]:
        """Return a context in which BLAS uses one thread, because its matrices are small."""
        return one_thread()

    def posterior(self, sampling: SMCResult) -> Posterior:
        """Return the particles, reweighted from the sampled log-likelihood to the expected one by draws.

        They keep their weights if hardly a particle would be left, or if they are draws of the true posterior.
        """
        if self.exact is not None:
            given = sampling.log_weights, sampling.log_likelihood, sampling.log_evidence
            return _posterior(self.space, sampling, *given)
        expected = self.knowledge.expected(sampling.positions, plug_in=self.knowledge.plug_in(sampling.positions))
        log_weights = sampling.log_weights + expected - sampling.log_likelihood
        if np.exp(-logsumexp(2 * log_softmax(log_weights))) < LEAST_LEFT:
            known = sampling.log_weights, sampling.log_likelihood, sampling.log_evidence
            return _posterior(self.space, sampling, *known)
        log_evidence = sampling.log_evidence + float(logsumexp(log_weights))
        return _posterior(self.space, sampling, log_softmax(log_weights), expected, log_evidence)

    def checks(self, sampling: SMCResult, posterior: Posterior, cut: Cut | None, *, seed: int) -> dict[str, Any]:
        """Return how the surrogate's variance, feasibility and the other surrogate change the posterior."""
        exact = self.knowledge.plug_in(sampling.positions) - sampling.log_likelihood
        plain = Weighted(sampling.positions, np.exp(log_softmax(sampling.log_weights + exact)))
        effective = float(1.0 / np.sum(plain.weights**2 / np.maximum(posterior.weights, 1e-300)))
        with np.errstate(divide="ignore"):  # a single particle may be left without the variance
            effect = VarianceEffect((posterior.mean - plain.mean) / posterior.sd, posterior.sd / plain.sd, effective)
        feasible = float(posterior.weights @ np.exp(self.knowledge.log_feasibility(posterior.draws)))
        compared = None if self.beside is None else _moments_by(self.beside.mean, self.space, seed)
        inferred = self.knowledge.likelihood.inferred
        without = None
        if inferred is not None and inferred.without is not None:
            without = _moments_by(partial(self._by, inferred.without), self.space, seed)
        scatter = simulator_noise(self.knowledge, posterior.equally_weighted(seed, SCATTERED))
        found = FieldOutcome(self.knowledge, effect, feasible, self.certificate, compared, without, scatter)
        return {"quadrature": None, "field": found}

    def _by(self, likelihood: Mixture, x: Points) -> Values:
        surrogate = self.knowledge.surrogate
        values = likelihood.many(surrogate.points(surrogate.mean(x)), surrogate.templates)
        return np.asarray(values + self.knowledge.log_feasibility(x))


Target = LogLikelihoodTarget | FieldTarget  # a log-likelihood to sample from


def _posterior(
    space: ParameterSpace, sampling: SMCResult, log_weights: Values, log_likelihood: Values, log_evidence: float
) -> Posterior:
    return Posterior(space, sampling.positions, log_weights, log_likelihood, sampling.log_prior, log_evidence)


def quadrature(space: ParameterSpace, log_likelihood: Callable[[Any], Any]) -> QuadratureResult | None:
    """Integrate the posterior of a log-likelihood; None for more than three inputs.

    Also None for a posterior so narrow that rounding leaves no variance, e.g. if nothing comes near the observation.
    """
    if space.dim > LARGEST_DIM:
        return None
    found = integrate(lambda x: log_likelihood(x) + space.log_prior(x), space.low, space.high)
    return found if (np.diag(found.covariance) > 0).all() else None


def _moments_by(log_likelihood: Callable[[Points], Values], space: ParameterSpace, seed: int) -> dict[str, Point]:
    initial = space.prior_quantiles(np.random.default_rng(seed).random((COMPARED, space.dim)))
    found = sample(jax.random.key(seed), OnHost(log_likelihood), space.log_prior, initial, settings=SAMPLING)
    moments = Weighted(found.positions, np.exp(found.log_weights))
    return {"mean": moments.mean, "sd": moments.sd}


def central_hessian(values: Callable[[Points], Values], x: Point, step: Point, low: Point, high: Point) -> Matrix:
    """Return second derivatives by central differences around a point, which is moved inside if x is at the edge."""
    step = np.minimum(step, (high - low) / 4)
    points = np.clip(x, low + step, high - step) + step * differences(len(x))
    return second_differences(values(points), len(x)) / np.outer(step, step)
