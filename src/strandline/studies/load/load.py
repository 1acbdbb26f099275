"""study.yaml → a study, checked as far as possible without a forward run."""

import os
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from strandline.foundations import InvalidStudy
from strandline.interface import Noise, PointErrors, UnknownErrors
from strandline.models import ForwardModel, declared_conditions
from strandline.studies.keys import StudyFile
from strandline.studies.keys.folder import LEDGER
from strandline.studies.keys.observation import COLUMN, IMAGE, ConditionNoise
from strandline.studies.keys.parse import parse_study
from strandline.studies.load import noise as noise_keys
from strandline.studies.load.inputs import build_fixed, build_space, check_complete, read_candidates
from strandline.studies.load.models import build_discrepancies, build_model, with_cheaper
from strandline.studies.load.observed import Found, SyntheticNoise, read_observations, require_condition
from strandline.studies.load.settings import build_executor, build_settings
from strandline.studies.load.study import Study
from strandline.studies.pictures.undeformed import undeformed_in, with_errors_of


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
    model = with_cheaper(model, content, folder, undeformed)
    reuse = tuple(_reused_ledger(folder, other) for other in content.reuse)
    space, fixed = build_space(content.inputs, model), build_fixed(content, model)
    truth, synthetic_noise = None, None
    if not isinstance(content.observation, list) and content.observation.synthetic is not None:
        truth, disturbed = dict(content.observation.synthetic), content.observation.noise
        check_complete(truth, (*space.names, *fixed), model, "observation.synthetic")
        if disturbed is not None:
            seed = content.seed if disturbed.seed is None else disturbed.seed
            synthetic_noise = SyntheticNoise(disturbed.sd, seed)
    read = {} if truth is not None else read_observations(folder, content.observation, model)
    observed = {condition: one.interface for condition, one in read.items()}
    noise, noises = _noises(content, model, read)
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
        settings=build_settings(content, model),
        executor=build_executor(content.executor, folder),
        reuse=reuse,
        candidates=read_candidates(content.next, model, space, fixed),
        with_report=content.report == "full",
    )
    for condition, seen in observed.items():
        noise_keys.require_fits(study.noise_of(condition), seen)
    stated = {name: study.noise_of(name) for name in observed or declared_conditions(model)}
    noise_keys.require_shared(stated)
    for given in (content.noise, *content.noise.conditions.values()):
        noise_keys.require_unit(given, study.discrepancies.values())
    noise_keys.require_inferable([*stated.values()], study.measure, by_field=study.settings.surrogate == "field")
    return replace(study, as_loaded=study)


def _noises(
    content: StudyFile, model: ForwardModel, read: Mapping[str, Found]
) -> tuple[Noise | PointErrors | UnknownErrors, dict[str, Noise | PointErrors | UnknownErrors]]:
    for condition in content.noise.conditions:
        require_condition(condition, declared_conditions(model), "noise.conditions")
    names, stated = tuple(content.inputs), dict[str, ConditionNoise](content.noise.conditions)
    if content.noise.sd in (COLUMN, IMAGE):
        stated = {**dict.fromkeys(read, content.noise), **stated}
    for name, one in read.items():
        _require_taken(stated.get(name, content.noise), one, name)
    noises = {name: noise_keys.build_noise(given, names, read.get(name)) for name, given in stated.items()}
    told = [one for one in read.values() if one.sds is not None or one.errors is not None]
    noise = noise_keys.build_noise(content.noise, names, next(iter([*told, *read.values()]), None))
    return noise, noises


def _require_taken(given: ConditionNoise, one: Found, condition: str) -> None:
    """Refuse standard deviations of points that the noise leaves aside, and a picture's edge without an offset."""
    if one.sds is not None and given.sd != COLUMN:
        raise InvalidStudy(
            "observation.sd: the noise does not take it",
            value=f"condition {condition}" if condition else f"noise.sd: {given.sd}",
            expected=f"`noise: {{sd: {COLUMN}, unit: um}}`",
            remedy="Write that, or remove observation.sd.",
        )
    if one.errors is not None:
        noise_keys.require_offset(given)


def _reused_ledger(folder: Path, other: str) -> Path:
    target = folder / other
    if not os.path.isdir(target):  # noqa: PTH112, which is False for a name that the system cannot hold, too
        raise InvalidStudy(
            "reuse",
            value=other,
            expected="the folder of another study, relative to this one",
            remedy="Correct the path or remove it.",
        )
    return target / LEDGER
