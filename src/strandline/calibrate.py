"""The whole method on one screen: from a problem to the posterior.

priors → Sobol design → forward runs → discrepancy → surrogate of the log-likelihood (→ further runs where the posterior
lies → better surrogate) → tempered SMC → posterior. Or: forward runs → surrogate of the interface as a field (→ batches
chosen on the posterior so far) → discrepancy of the predicted interface → tempered SMC → posterior.
"""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.active import FieldOutcome, VarianceEffect
from strandline.calibration import Calibration, Observer, Problem, Settings, Stopwatch
from strandline.cut import cut_by_quadrature, cut_reading
from strandline.field_likelihood import OnHost
from strandline.learning import Learning
from strandline.models.protocol import require_conditions
from strandline.parameters import ParameterSpace
from strandline.posterior import (
    GaussianApproximation,
    Posterior,
    Reading,
    SobolIndices,
    UnderUncertainty,
    laplace,
    log_prior_hessian,
    sobol_indices,
)
from strandline.quadrature import QuadratureResult, integrate
from strandline.refinement import SAMPLING, Learnt
from strandline.runs import (
    Executor,
    Ledger,
)
from strandline.smc import (
    SMCResult,
    sample,
)
from strandline.surrogate import GaussianProcess
from strandline.surrogate.field import one_thread
from strandline.targets import Target, of_field, of_process

__all__ = ["Calibration", "Observer", "Problem", "Settings", "calibrate"]

NORMALISED = 1e-7
"""Largest logarithm of the weights' sum: rounding exceeds it where log-likelihoods are of the order of -1e9."""
COMPARED = 2000
"""Particles of the posterior that is only told beside the study's."""


def calibrate(
    problem: Problem,
    settings: Settings,
    *,
    ledger: Ledger,
    executor: Executor,
    observer: Observer | None = None,
    given: Float[np.ndarray, "run dim"] | None = None,
) -> Calibration:
    """Return the posterior of the unknown inputs of `problem`.

    With a surrogate of the field, `given` are the inputs of finished runs to begin with in place of a design. Where the
    runs' interfaces make no field, for want of common points, the log-likelihood is learnt instead.

    Finished runs in the ledger are not repeated. The same arguments give the same result to the bit, whatever order the
    runs ended in.

    Raises:
        InvalidInput: an observed condition that the model does not have; raised before any run.
        CampaignStopped: as `settings.failures` says; what is finished is in the ledger.
        TooFewRuns: fewer successful runs than the Gaussian process needs.
    """
    require_conditions((o.condition for o in problem.observations), problem.model)
    watch, tell = Stopwatch(), observer or Observer()
    work = Learning(problem, settings, ledger, executor, tell, watch)
    space, lesson = problem.space, work.lesson(given)
    problem = replace(problem, observations=work.judge.observations)
    learnt, field_ = lesson.learnt, lesson.field
    target = of_process(learnt.surrogate.process) if field_ is None else of_field(field_.knowledge, space)
    with watch("sampling", tell), nullcontext() if field_ is None else one_thread():
        sampling = _sample(target, space, settings, tell)
        posterior = _posterior(space, sampling, target)
    under_uncertainty = None
    if space.nuisance:
        with watch("cut", tell):
            cut = cut_reading(
                space,
                target.compiled,
                values=settings.nuisance_values,
                particles=settings.particles,
                smc=settings.smc,
                seed=settings.seed,
            )
            under_uncertainty = UnderUncertainty(Reading(posterior), cut)
    with watch("check", tell):
        mode = posterior.map_estimate
        hessian = target.hessian(mode, posterior.sd) + log_prior_hessian(space, mode)
        direct = field_ is None
        quadrature = _quadrature(space, jax.jit(target.compiled)) if direct else None
        cut_quadrature = cut_by_quadrature(target.compiled, cut) if under_uncertainty and direct else None
        sensitivity = _sensitivity(space, target.values, settings.seed)
        if field_ is not None:
            field_ = _described(field_, learnt, space, sampling, posterior, settings)
    return Calibration(
        problem=problem,
        settings=settings,
        records=learnt.records,
        training=learnt.training,
        log_likelihoods=learnt.log_likelihoods,
        surrogates=learnt.surrogates,
        sampling=sampling,
        posterior=posterior,
        gaussian=GaussianApproximation(posterior.mean, posterior.covariance),
        laplace=laplace(hessian, mode),
        quadrature=quadrature,
        seconds=watch.seconds,
        under_uncertainty=under_uncertainty,
        cut_quadrature=cut_quadrature,
        rounds=lesson.rounds,
        sensitivity=sensitivity,
        field=field_,
        no_field=lesson.no_field,
        set_aside=lesson.set_aside,
        turned=work.judge.turned,
    )


def _sample(target: Target, space: ParameterSpace, settings: Settings, tell: Observer) -> SMCResult:
    start, chain = jax.random.split(jax.random.key(settings.seed))
    uniform = jax.random.uniform(start, (settings.particles, space.dim), dtype=float)
    initial = space.prior_quantiles(np.asarray(uniform))
    return sample(chain, target.compiled, space.log_prior, initial, settings=settings.smc, on_step=tell.step)


def _posterior(space: ParameterSpace, sampling: SMCResult, target: Target) -> Posterior:
    """Return the draws, weighted from the log-likelihood that was sampled to the one that is meant."""
    log_likelihood, log_weights = sampling.log_likelihood, sampling.log_weights
    log_evidence = sampling.log_evidence
    if target.weighted is not None:
        meant = target.weighted(sampling.positions)
        log_weights = log_weights + meant - log_likelihood
        log_evidence += float(logsumexp(log_weights))
        log_likelihood, log_weights = meant, log_softmax(log_weights)
    elif abs(float(logsumexp(log_weights))) > NORMALISED:
        log_weights = log_softmax(log_weights)
    return Posterior(
        space=space,
        draws=sampling.positions,
        log_weights=log_weights,
        log_likelihood=log_likelihood,
        log_prior=sampling.log_prior,
        log_evidence=log_evidence,
    )


def _described(
    found: FieldOutcome,
    learnt: Learnt,
    space: ParameterSpace,
    sampling: SMCResult,
    posterior: Posterior,
    settings: Settings,
) -> FieldOutcome:
    """Return the outcome with what the posterior says of the surrogate's variance, of feasibility, of the other way."""
    weights = np.exp(sampling.log_weights)
    mean = weights @ sampling.positions
    sd = np.sqrt(weights @ (sampling.positions - mean) ** 2)
    ratios = posterior.weights / np.maximum(weights, 1e-300)
    effective = float(1.0 / (weights @ ratios**2))
    effect = VarianceEffect((posterior.mean - mean) / posterior.sd, posterior.sd / sd, effective)
    feasible = float(posterior.weights @ np.exp(found.knowledge.log_feasibility(posterior.draws)))
    compared = None
    if learnt.surrogates:
        compared = _by_log_likelihood(learnt.surrogate.process, space, settings.seed)
    return replace(found, effect=effect, feasible=feasible, compared=compared)


def _by_log_likelihood(
    process: GaussianProcess, space: ParameterSpace, seed: int
) -> dict[str, Float[np.ndarray, " dim"]]:
    """Return the moments of the posterior by the other surrogate; to be told beside the study's, not to be used."""
    initial = space.prior_quantiles(np.random.default_rng(seed).random((COMPARED, space.dim)))
    found = sample(jax.random.key(seed), OnHost(process.mean), space.log_prior, initial, settings=SAMPLING)
    weights = np.exp(found.log_weights)
    mean = weights @ found.positions
    return {"mean": mean, "sd": np.sqrt(weights @ (found.positions - mean) ** 2)}


def _quadrature(space: ParameterSpace, log_likelihood: Callable[[Any], Any]) -> QuadratureResult | None:
    """Integrate the same surrogate directly where the dimension allows it: the check of the sampler.

    None, too, for a posterior so narrow that rounding leaves no variance, as where nothing comes near the observation.
    """
    if space.dim > 3:
        return None
    found = integrate(lambda x: log_likelihood(x) + space.log_prior(x), space.low, space.high)
    return found if (np.diag(found.covariance) > 0).all() else None


def _sensitivity(space: ParameterSpace, log_likelihood: Callable[[Any], Any], seed: int) -> SobolIndices | None:
    """Return what the inputs have to do with the log-likelihood; None where there is one input only."""
    if space.dim == 1:
        return None
    return sobol_indices(log_likelihood, space, number=2048 if space.dim < 4 else 1024, seed=seed)
