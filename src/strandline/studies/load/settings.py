"""The keys `design`, `surrogate`, `sampler`, `failures` and `executor` of study.yaml → settings, and an executor."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from strandline.calibration import Settings
from strandline.design import Active, Refinement
from strandline.foundations import InvalidStudy, lookup
from strandline.models import ForwardModel, declared_failure_kinds
from strandline.runs import COMMON_KINDS, ENDS, EXECUTORS, Executor, FailurePolicy, Retry
from strandline.smc import SMCSettings
from strandline.studies.keys import StudyFile
from strandline.studies.keys.parse import entry, made, open_entry, refused_at, require_parts
from strandline.studies.keys.settings import ExecutorChoice, Failures

FEW_INPUTS = 3
"""Largest number of inputs with one length scale for all in a surrogate of the log-likelihood made for comparison."""

SLURM = "slurm"
"""Folder in the study that holds the batches of SLURM arrays."""


def build_settings(content: StudyFile, model: ForwardModel) -> Settings:
    """Return how the posterior is computed."""
    smc, sobol = dict(content.sampler.smc), content.design.sobol
    particles = smc.pop("particles")
    refine = build_refinement(content.design.refine, particles)
    with refused_at("sampler.smc"):
        sampler = SMCSettings(**smc)
    dim, log_likelihood = len(content.inputs), content.surrogate.log_likelihood
    active = build_active(content.design.active, dim, sensitivities=content.sensitivities)
    if sobol is not None and sobol.runs < dim + 2:
        raise InvalidStudy(
            "design.sobol.runs",
            value=sobol.runs,
            expected=f"at least {dim + 2} runs for {dim} input(s); 100 are a start",
            remedy="Enlarge the design.",
        )
    by_field = active is not None or content.surrogate.field is not None
    kernel, fit = (None, None) if log_likelihood is None else (log_likelihood.kernel, log_likelihood.fit)
    kernel = kernel or ("matern32" if dim <= FEW_INPUTS or not by_field else "matern32_product")
    scramble = (content.design.active or {}).get("scramble") if sobol is None else sobol.scramble
    failures = build_failures(content.failures, model)
    with refused_at("surrogate.log_likelihood"):
        return Settings(
            runs=sobol.runs if sobol is not None else (active.initial if active and active.initial else 0),
            scramble=scramble,
            refine=refine,
            kernel=kernel,
            fit=fit,
            surrogate="field" if by_field else "log_likelihood",
            active=active,
            particles=particles,
            smc=sampler,
            seed=content.seed,
            nuisance_values=content.sampler.cut.values,
            failures=failures,
            draft=content.draft,
        )


def build_failures(given: Failures, model: ForwardModel) -> FailurePolicy:
    """Return the policy for failed runs; refuse a kind that the model is known not to have."""
    if declared_failure_kinds(model) is not None:
        known = dict.fromkeys(failure_words(model))
        for kind in given.kinds:
            entry(known, kind, "failures.kinds")
    actions = {kind: action if isinstance(action, str) else Retry(action) for kind, action in given.kinds.items()}
    if isinstance(given.stop, str):
        return FailurePolicy(actions, stop_share=2.0)
    return FailurePolicy(actions, stop_after=given.stop.after, stop_share=given.stop.share)


def failure_words(model: ForwardModel) -> tuple[str, ...]:
    """Return the known words for failed runs of `model`: states, its own kinds, kinds of any model."""
    states = (state for state in ENDS if state != "ok")
    return tuple(dict.fromkeys([*states, *(declared_failure_kinds(model) or ()), *COMMON_KINDS]))


def build_active(given: Mapping[str, Any] | None, dim: int, *, sensitivities: bool) -> Active | None:
    """Return the settings of an active design, with the number of its first runs."""
    if given is None:
        return None
    options = {name: value for name, value in given.items() if name != "scramble"}
    usual = 4 + 2 * dim
    options.setdefault("initial", max(usual // 2, 3) if sensitivities else usual)
    with refused_at("design.active"):
        return Active(**options)


def build_refinement(given: Mapping[str, Any] | None, particles: int) -> Refinement:
    """Return the rounds of refinement, none by default; a round has no more runs than there are particles."""
    if given is None:
        return Refinement()
    with refused_at("design.refine"):
        refinement = Refinement(**given)
    if refinement.runs > particles:
        raise InvalidStudy(
            "design.refine.runs",
            value=refinement.runs,
            expected=f"at most {particles}, the number of particles that they are drawn from",
            remedy="Make fewer runs in a round, and more rounds.",
        )
    return refinement


def build_executor(choice: ExecutorChoice, folder: Path) -> Executor:
    """Return the executor of the study in `folder`; worker processes on this machine if it names none."""
    for name, options in (choice.model_extra or {}).items():
        own: Executor = made(open_entry(EXECUTORS, name, "executor", "an executor"), options, f"executor.{name}")
        require_parts(own, ("__call__",), f"executor.{name}")
        return own
    named: dict[str, dict[str, Any]] = {name: dict(options) for name, options in choice if options is not None}
    name, given = next(iter(named.items()), ("local", {}))
    if name == "slurm_array":
        given |= {
            "folder": folder.resolve() / SLURM,
            "command": (sys.executable, "-m", "strandline.studies.array_task", str(folder.resolve())),
        }
    with refused_at(f"executor.{name}"):
        executor: Executor = lookup(EXECUTORS, name, "executor")(**given)
    return executor
