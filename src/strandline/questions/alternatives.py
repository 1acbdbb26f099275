"""The key `what_if` of study.yaml → alternatives to a study, each checked as the study itself would be."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from strandline.calibration.alternative import Alternative, Baseline, Kind
from strandline.calibration.usual_alternatives import facts_of, prior_in_words, with_prior
from strandline.errors import InvalidStudy
from strandline.interface import Observation
from strandline.likelihood import FieldLikelihood
from strandline.questions.knowledge import require
from strandline.studies.inputs import build_prior
from strandline.studies.keys import StudyFile
from strandline.studies.keys.observation import Noise
from strandline.studies.keys.study_file import WhatIf
from strandline.studies.load import study_of
from strandline.studies.parse import checked, entry, refused_at
from strandline.studies.study import Study
from strandline.studies.text import load_yaml
from strandline.text import listed

PLACE = "what_if"


def asked_in(study: Study) -> tuple[WhatIf, ...]:
    """Return the alternatives that study.yaml asks for."""
    return tuple(StudyFile.model_validate(load_yaml(study.text)).what_if)


def require_asked(given: Mapping[str, Any]) -> WhatIf:
    """Return an alternative with the keys of `what_if`; refuse unknown ones."""
    return checked(WhatIf, given, PLACE)


def alternative_of(asked: WhatIf, study: Study, now: Baseline) -> Alternative:
    """Return the alternative that is asked for, to be compared with the present posterior; it must fit the study."""
    priors = {name: build_prior(given, f"{PLACE}.prior.{name}") for name, given in asked.prior.items()}
    for name in (*priors, *asked.fix):
        entry(dict.fromkeys(study.space.names), name, f"{PLACE}: name of an input")
    for name, value in asked.fix.items():
        once = "an input without another prior in the same alternative"
        _require(name not in priors, "fix", name, once, "Remove one of the two.")
        low, high = study.space[name].interval
        _require(low <= value <= high, f"fix.{name}", value, f"a value in its box, [{low:g}, {high:g}]")
    with refused_at(f"{PLACE}.prior"):
        space = with_prior(now.space, priors)
    parts = list(_parts(asked))
    other = _changed(asked, study)
    likelihood = None if now.knowledge is None else _likelihood(asked, other, now.knowledge.likelihood)
    details = [f"{name}: {prior_in_words(prior)}" for name, prior in priors.items()]
    if likelihood is not None and asked.noise is not None:
        details.append(facts_of(likelihood))
    with refused_at(f"{PLACE}.fix"):
        return Alternative(
            name=asked.name or ", ".join(name for _, name, _ in parts),
            kind=parts[0][0] if len(parts) == 1 else "several",
            about=listed([about for _, _, about in parts]),
            space=space,
            likelihood=likelihood,
            fixed=dict(asked.fix),
            detail="; ".join(details),
            by_prior_alone=not _changes_likelihood(asked),
        )


def _parts(asked: WhatIf) -> list[tuple[Kind, str, str]]:
    """Return the kind, the name and the subject of each change."""
    out: list[tuple[Kind, str, str]] = []
    out += [("prior", f"another prior of {name}", f"the prior of {name}") for name in asked.prior]
    out += [("fix", f"{name} known to be {value:g}", f"what is known of {name}") for name, value in asked.fix.items()]
    if asked.noise is not None:
        out.append(("noise", "other noise", "the noise"))
    if asked.measure is not None:
        name = asked.measure if isinstance(asked.measure, str) else next(iter(asked.measure))
        out.append(("measure", f"measure {name}", "the measure"))
    out += [("without", f"without condition {name}", f"condition {name}") for name in asked.without]
    return out


def _changes_likelihood(asked: WhatIf) -> bool:
    return asked.noise is not None or asked.measure is not None or bool(asked.without)


def _likelihood(asked: WhatIf, study: Study, present: FieldLikelihood) -> FieldLikelihood | None:
    """Return the likelihood with the noise and measure of `study`, or fewer conditions; None if none is asked for."""
    if not _changes_likelihood(asked):
        return None
    observations, measure = present.observations, present.discrepancy
    if asked.noise is not None or asked.measure is not None:
        measure = study.measure
    if asked.noise is not None:
        observations = tuple(Observation(o.interface, study.noise_of(o.condition), o.condition) for o in observations)
    return replace(present, observations=_left(asked, observations), discrepancy=measure)


def _changed(asked: WhatIf, study: Study) -> Study:
    """Return the study with another noise or measure, checked as any study is; itself if neither is asked for."""
    if asked.noise is None and asked.measure is None:
        return study
    content = StudyFile.model_validate(load_yaml(study.text))
    changes: dict[str, Any] = {}
    if asked.noise is not None:
        changes["noise"] = checked(Noise, asked.noise, f"{PLACE}.noise")
    if asked.measure is not None:
        stated = content.discrepancy if isinstance(content.discrepancy, list) else [content.discrepancy]
        named = {name: one for one in stated for name in one}
        given = asked.measure
        changes["discrepancy"] = named.get(given, {given: None}) if isinstance(given, str) else given
    with refused_at(PLACE):
        return study_of(study.folder, content.model_copy(update=changes), study.text)


def _left(asked: WhatIf, observations: tuple[Observation, ...]) -> tuple[Observation, ...]:
    conditions, named = {seen.condition: seen for seen in observations}, ", ".join(asked.without)
    one_alone = bool(named) and len(conditions) == 1
    _require(not one_alone, "without", named, "several conditions: the study has one", "Remove it.")
    for name in asked.without:
        entry(conditions, name, f"{PLACE}.without")
    left = tuple(seen for name, seen in conditions.items() if name not in asked.without)
    _require(len(left) > 0, "without", named, "at least one condition left", "Leave out fewer.")
    return left


def _require(right: bool, key: str, value: Any, expected: str, remedy: str = "Choose another value.") -> None:
    require(right, f"{PLACE}.{key}", value, expected, remedy, InvalidStudy)
