"""The whole method on one screen: from a problem to the posterior.

priors → Sobol design → forward runs → discrepancy → surrogate of the log-likelihood (→ further runs where the posterior
lies → better surrogate) → tempered SMC → posterior. Or: forward runs → surrogate of the interface as a field (→ batches
chosen on the posterior so far) → discrepancy of the predicted interface → tempered SMC → posterior.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from strandline.calibration.learning import Given, Learning
from strandline.calibration.misfit import DRAFT, Effort
from strandline.calibration.problem import (
    MANY,
    Calibration,
    Observer,
    Problem,
    Settings,
    Stopwatch,
    observer_or_default,
    require_learnable,
)
from strandline.calibration.sampler_check import compare_halves
from strandline.calibration.targets import LARGEST_DIM, FieldTarget, Target, under_uncertainty
from strandline.foundations import require, use_double
from strandline.likelihood import require_inferable
from strandline.models import WithCheaper, asks_sensitivities, require_conditions, require_inputs
from strandline.parameters import ParameterSpace
from strandline.posterior import GaussianApproximation, SobolIndices, laplace, log_prior_hessian, sobol_indices
from strandline.runs import Executor, InProcess, Ledger
from strandline.smc import RandomKey, SMCResult, carried_over, in_halves, sample

CARRIED, RESTARTED = 1, 1 << 20
"""Keep random numbers that carry particles over to the next likelihood, or sample it from the prior, apart from others.
"""


def calibrate(
    problem: Problem,
    settings: Settings | None = None,
    *,
    ledger: Ledger | Path | str | None = None,
    executor: Executor | None = None,
    observer: Observer | None = None,
    given: Given | None = None,
) -> Calibration:
    """Return the posterior of the unknown inputs of `problem`.

    Finished runs in the ledger are not repeated. The same arguments give the same result to the bit, whatever order the
    runs end in. If the runs' interfaces have no common points, the log-likelihood is learnt instead of the field.

    Args:
        problem: Simulator, inputs with their priors, observations and measures.
        settings: How the posterior is computed.
        ledger: Ledger of the forward runs, or its path; if omitted, the runs are not kept.
        executor: Executor of the forward runs; if omitted, they run in this process.
        observer: Functions to call as the work goes on.
        given: Inputs of finished runs to begin with, in place of the Sobol design: the unknown ones, shape (run, dim),
            or all inputs of each run by name.

    Raises:
        InvalidInput: An input, a unit or a condition that the model does not have; raised before any run.
        CampaignStopped: `settings.failures` says to stop; finished runs are in the ledger.
        TooFewRuns: Fewer successful runs than the Gaussian process needs.
    """
    wrong: object = problem
    require(isinstance(wrong, Problem), "problem", wrong, "a Problem", "Make one of the model, its inputs and so on.")
    if not isinstance(ledger, Ledger):
        with _opened(ledger, problem) as opened:
            return calibrate(problem, settings, ledger=opened, executor=executor, observer=observer, given=given)
    use_double()
    for what, value, kind in (("settings", settings, Settings), ("executor", executor, Executor)):
        good = value is None or (isinstance(value, kind) and not isinstance(value, type))
        expected = "Settings, e.g. Settings(runs=100)" if kind is Settings else "an executor, e.g. LocalProcesses(2)"
        require(good, what, value, expected, "Make one, or leave it out.")
    settings, executor, tell = settings or Settings(), executor or InProcess(), observer_or_default(observer)
    _require_sound(problem, settings)
    watch, space = Stopwatch(), problem.space
    learning = Learning(problem, settings, ledger, executor, tell, watch)
    trained = learning.train(given)
    target = trained.target(space)
    with watch("sampling", tell), target.threads():
        chains = target.chains(settings) if isinstance(target, FieldTarget) else None
        sampling = chains or _sample(target, space, settings, tell)
        posterior = target.posterior(sampling)
    both = None
    if space.nuisance:
        with watch("cut", tell):
            both = under_uncertainty(posterior, target.compiled, settings)
    with watch("check", tell):
        mode = posterior.map_estimate
        hessian = target.hessian(mode, posterior.sd) + log_prior_hessian(space, mode)
        checks = target.checks(sampling, posterior, both.cut if both else None, seed=settings.seed)
        sensitivity = None if settings.draft or space.dim > MANY else _sensitivity(space, target.values, settings.seed)
        problem = replace(problem, observations=learning.judge.observations)
        misfit = trained.misfit(problem, posterior, effort=DRAFT if settings.draft else Effort(), seed=settings.seed)
    return Calibration(
        problem=problem,
        settings=settings,
        **trained.found,
        sampling=sampling,
        posterior=posterior,
        gaussian=GaussianApproximation(posterior.mean, posterior.covariance),
        laplace=laplace(hessian, mode),
        under_uncertainty=both,
        **checks,
        sensitivity=sensitivity,
        seconds=watch.seconds,
        turned=learning.judge.turned,
        misfit=misfit,
        sampler_check=compare_halves(sampling, posterior),
    )


def _require_sound(problem: Problem, settings: Settings) -> None:
    """Refuse a problem that the model does not fit, or that cannot be learnt with these settings."""
    model, active = problem.model, settings.active
    require_inputs({one.name: one.unit for one in problem.space.parameters}, problem.fixed, model)
    require_conditions((o.condition for o in problem.observations), model)
    require_inferable(problem.observations, problem.measure, by_field=settings.surrogate == "field")
    require_learnable(
        problem.space.dim,
        active=active,
        sensitivities=asks_sensitivities(model),
        cheaper=isinstance(model, WithCheaper),
    )


@contextmanager
def _opened(path: Path | str | None, problem: Problem) -> Iterator[Ledger]:
    """Yield the ledger at `path`, or one in a folder that is removed afterwards."""
    with (
        TemporaryDirectory() if path is None else nullcontext() as folder,
        Ledger.open(path or Path(str(folder)) / "ledger.sqlite", model=problem.model) as ledger,
    ):
        yield ledger


def _sample(target: Target, space: ParameterSpace, settings: Settings, tell: Observer) -> SMCResult:
    """Return the particles: of one run up to three inputs, which a quadrature can check, else of two halves."""
    start, chain = jax.random.split(jax.random.key(settings.seed))
    uniform = jax.random.uniform(start, (settings.particles, space.dim), dtype=float)
    initial = space.prior_quantiles(np.asarray(uniform))
    run = partial(_sample_from, target=target, space=space, settings=settings, tell=tell)
    return run(chain, initial) if space.dim <= LARGEST_DIM else in_halves(run, chain, initial)


def _sample_from(
    chain: RandomKey,
    initial: Float[np.ndarray, "particle dim"],
    *,
    target: Target,
    space: ParameterSpace,
    settings: Settings,
    tell: Observer,
) -> SMCResult:
    options: dict[str, Any] = {"scouts": initial, "extents": space.high - space.low, "settings": settings.smc}
    found = None
    for stage, one in enumerate((*target.warm_up_densities, target.compiled)):
        if found is not None:
            key = jax.random.fold_in(chain, CARRIED + stage - 1)
            found = carried_over(key, found, one, space.log_prior, **options)
        if found is None:
            key = jax.random.fold_in(chain, RESTARTED + stage) if stage else chain
            found = sample(key, one, space.log_prior, initial, settings=settings.smc, on_step=tell.step)
    assert found is not None
    return found


def _sensitivity(space: ParameterSpace, log_likelihood: Callable[[Any], Any], seed: int) -> SobolIndices | None:
    """Return how much each input affects the log-likelihood; None for one input, or correlated ones: they share it."""
    if space.dim == 1 or space.correlation:
        return None
    return sobol_indices(log_likelihood, space, number=2048 if space.dim < 4 else 1024, seed=seed)
