"""study.yaml → a study, checked as far as possible without a forward run; its settings and its executor."""

import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from strandline.calibration import Settings, require_learnable
from strandline.design import Active, Refinement
from strandline.foundations import InvalidStudy, lookup
from strandline.interface import Noise, PointErrors, UnknownErrors
from strandline.models import ForwardModel, declared_conditions, declared_failure_kinds
from strandline.runs import EXECUTORS, Executor, FailurePolicy, Retry
from strandline.smc import SMCSettings
from strandline.studies.keys.folder import LEDGER
from strandline.studies.keys.observation import COLUMN, IMAGE, ConditionNoise
from strandline.studies.keys.parse import entry, made, open_entry, parse_study, refused_at, require_parts
from strandline.studies.keys.study_file import ExecutorChoice, Failures, StudyFile
from strandline.studies.load import observed as observing
from strandline.studies.load.inputs import build_fields, build_fixed, build_space, check_complete, read_candidates
from strandline.studies.load.models import build_discrepancies, build_model, with_cheaper, with_fields
from strandline.studies.load.photographed import undeformed_in, with_errors_of
from strandline.studies.load.study import Study, failure_words


def load_study(folder: Path | str) -> Study:
    """Return the study in `folder`; nothing is written and no forward run is made.

    Raises:
        InvalidStudy: The study cannot be parsed, see `parse_study`, or a value in it cannot be used.
    """
    folder = Path(folder)
    return study_of(folder, *parse_study(folder))


def study_of(folder: Path, content: StudyFile, text: str) -> Study:
    """Return the study that a study file states."""
    undeformed = undeformed_in(content.model, folder)
    model = build_model(content.model, folder, sensitivities=content.sensitivities, undeformed=undeformed)
    fields = build_fields(content.inputs, model, folder)
    model = with_cheaper(with_fields(model, fields), content, folder, undeformed)
    reuse = tuple(_reused_ledger(folder, other) for other in content.reuse)
    space = build_space(content, model)
    fixed = build_fixed(content, model, space)
    truth, synthetic_noise = None, None
    if not isinstance(content.observation, list) and content.observation.synthetic is not None:
        truth = {one.name: 0.0 for one in space if one.of_field is not None} | content.observation.synthetic
        disturbed = content.observation.noise
        check_complete(truth, (*space.names, *fixed), model, "observation.synthetic")
        if disturbed is not None:
            seed = content.seed if disturbed.seed is None else disturbed.seed
            synthetic_noise = observing.SyntheticNoise(disturbed.sd, seed)
    read = {} if truth is not None else observing.read_observations(folder, content.observation, model)
    observed = {condition: one.interface for condition, one in read.items()}
    noise, noises = _noises(content, model, read, space.names)
    if undeformed is not None:
        undeformed = replace(undeformed, noises={name: noises.get(name, noise) for name in read})
        with_errors = partial(with_errors_of, undeformed, conditions=len(read))
        noises |= {name: with_errors(undeformed.noises[name], one.interface) for name, one in read.items()}
    study = Study(
        folder=folder,
        name=content.name,
        text=text,
        model=model,
        space=space,
        fixed=fixed,
        discrepancies=build_discrepancies(content.discrepancy),
        noise=noise,
        noises=noises,
        observed=observed,
        truth=truth,
        synthetic_noise=synthetic_noise,
        turned=tuple(condition for condition, one in read.items() if one.turned),
        pictures={condition: one.picture for condition, one in read.items() if one.picture is not None},
        stacks={condition: one.stack for condition, one in read.items() if one.stack is not None},
        undeformed=undeformed,
        settings=build_settings(content, model, space.dim),
        executor=build_executor(content.executor, folder),
        reuse=reuse,
        candidates=read_candidates(content.next, model, space, fixed),
        with_report=content.report == "full",
    )
    for condition, seen in observed.items():
        observing.require_fits(study.noise_of(condition), seen)
    stated = {name: study.noise_of(name) for name in observed or declared_conditions(model)}
    observing.require_shared(stated)
    for given in (content.noise, *content.noise.conditions.values()):
        observing.require_unit(given, study.discrepancies.values())
    observing.require_inferable([*stated.values()], study.measure, by_field=study.settings.surrogate == "field")
    return replace(study, as_loaded=study)


def _noises(
    content: StudyFile, model: ForwardModel, read: Mapping[str, observing.Found], names: tuple[str, ...]
) -> tuple[Noise | PointErrors | UnknownErrors, dict[str, Noise | PointErrors | UnknownErrors]]:
    for condition in content.noise.conditions:
        observing.require_condition(condition, declared_conditions(model), "noise.conditions")
    stated = dict[str, ConditionNoise](content.noise.conditions)
    if content.noise.sd in (COLUMN, IMAGE):
        stated = {**dict.fromkeys(read, content.noise), **stated}
    for name, one in read.items():
        _require_taken(stated.get(name, content.noise), one, name)
    noises = {name: observing.build_noise(given, names, read.get(name)) for name, given in stated.items()}
    told = [one for one in read.values() if one.sds is not None or one.errors is not None]
    noise = observing.build_noise(content.noise, names, next(iter([*told, *read.values()]), None))
    return noise, noises


def _require_taken(given: ConditionNoise, one: observing.Found, condition: str) -> None:
    """Refuse standard deviations of points that the noise leaves aside, and a picture's edge without an offset."""
    if one.sds is not None and given.sd != COLUMN:
        what, expected = "observation.sd: the noise does not take it", f"`noise: {{sd: {COLUMN}, unit: um}}`"
        value = f"condition {condition}" if condition else f"noise.sd: {given.sd}"
        raise InvalidStudy(what, value=value, expected=expected, remedy="Write that, or remove observation.sd.")
    if one.errors is not None:
        observing.require_offset(given)


def _reused_ledger(folder: Path, other: str) -> Path:
    target = folder / other
    if not os.path.isdir(target):  # noqa: PTH112, which is False for a name that the system cannot hold, too
        expected = "the folder of another study, relative to this one"
        raise InvalidStudy("reuse", value=other, expected=expected, remedy="Correct the path or remove it.")
    return target / LEDGER


FEW_INPUTS = 3  # most inputs with one length scale for all in a surrogate of the log-likelihood for comparison

SLURM = "slurm"  # folder in the study that holds the batches of SLURM arrays


def build_settings(content: StudyFile, model: ForwardModel, dim: int) -> Settings:
    """Return how the posterior of `dim` inputs is computed."""
    smc, sobol = dict(content.sampler.smc), content.design.sobol
    particles = smc.pop("particles")
    refine = build_refinement(content.design.refine, particles)
    with refused_at("sampler.smc"):
        sampler = SMCSettings(**smc)
    log_likelihood = content.surrogate.log_likelihood
    active = build_active(content.design.active, dim, sensitivities=content.sensitivities)
    with refused_at():
        require_learnable(dim, active=active, sensitivities=content.sensitivities, cheaper=bool(content.fidelities))
    if sobol is not None and sobol.runs < dim + 2:
        expected = f"at least {dim + 2} runs for {dim} input(s); 100 are a start"
        raise InvalidStudy("design.sobol.runs", value=sobol.runs, expected=expected, remedy="Enlarge the design.")
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


def build_active(given: Mapping[str, Any] | None, dim: int, *, sensitivities: bool) -> Active | None:
    """Return the settings of an active design, with the number of its first runs."""
    if given is None:
        return None
    options = {name: value for name, value in given.items() if name != "scramble"}
    options.setdefault("initial", 3 if sensitivities or options.get("differences") is True else 4 + 2 * dim)
    with refused_at("design.active"):
        return Active(**options)


def build_refinement(given: Mapping[str, Any] | None, particles: int) -> Refinement:
    """Return the rounds of refinement, none by default; a round has no more runs than there are particles."""
    if given is None:
        return Refinement()
    with refused_at("design.refine"):
        refinement = Refinement(**given)
    if refinement.runs > particles:
        expected = f"at most {particles}, the number of particles that they are drawn from"
        remedy = "Make fewer runs in a round, and more rounds."
        raise InvalidStudy("design.refine.runs", value=refinement.runs, expected=expected, remedy=remedy)
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
