"""How the posterior of a finished study changes with other assumptions, without a forward run."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from strandline import calibration, studies
from strandline.calibration.usual_alternatives import usual_alternatives
from strandline.foundations import InvalidStudy, figure_text, listed, one_thread, require, use_double
from strandline.interface import Observation
from strandline.likelihood import FieldLikelihood
from strandline.posterior import Weighted
from strandline.questions.answer import Answer, Part, Symbol, Table, facts_of_surrogate, moments, remark
from strandline.questions.knowledge import baseline_of, require_seed
from strandline.report import Captioned, axis_label, plots, without_coefficients
from strandline.runs import Progress

__all__ = ["what_if"]

Tried = tuple[calibration.AlternativePosterior, ...]
PLACE = "what_if"  # the key of study.yaml


def what_if(
    study: studies.Study,
    alternatives: Sequence[Mapping[str, Any]] | None = None,
    *,
    seed: int = 1,
    observer: calibration.Observer | None = None,
) -> Answer[Tried]:
    """Return how the posterior of a finished study changes with its assumptions, without a forward run.

    Writes what-if.json, what-if.html and a figure.

    Args:
        study: A finished study, from `load_study`.
        alternatives: Other assumptions, each with the keys of `what_if` in study.yaml; by default those of study.yaml
            and the usual ones.
        seed: Seed of all random numbers, 0 or above.
        observer: Receives the progress.

    Raises:
        InvalidInput: A negative seed, an empty list of alternatives, or a study whose inputs are all fields.
        InvalidStudy: The study is not finished, its folder cannot be written to, or an alternative does not fit it.
        LedgerError: The ledger is damaged, or belongs to another model.
    """
    studies.require_study(study)
    require_seed(seed, "what-if")
    some = "an input that is no coefficient of a field", "Read the report, which shows fields."
    require(len(study.space.scalars) > 0, "inputs of what-if", "fields alone", *some)
    words = "at least one", "Leave them out to ask the usual questions."
    require(alternatives is None or len(alternatives) > 0, "alternatives", "none", *words)
    stated = studies.StudyFile.model_validate(studies.load_yaml(study.text)).what_if
    asked = stated if alternatives is None else [studies.checked(studies.WhatIf, one, PLACE) for one in alternatives]
    posterior = studies.finished_posterior(study, purpose="compare with")
    studies.require_writable(study.folder)
    use_double()
    for one in asked:  # refused before anything is computed
        alternative_of(one, study, calibration.baseline(posterior, None))
    tell = calibration.observer_or_default(observer)
    with one_thread():
        tell.stage("surrogate")
        now = baseline_of(study, posterior, purpose="what-if")
        tried = [alternative_of(one, study, now) for one in asked]
        if alternatives is None:
            tried += usual_alternatives(now, study.discrepancies)
        tell.stage("alternatives")
        answers = tuple(sorted(_answers(now, tried, seed, tell), key=_rank))
    tell.stage("report")
    return _answer(
        without_coefficients(_described(study, now, answers, seed), now.space), answers, study.folder
    ).written(draft=study.settings.draft)


def _answers(
    now: calibration.Baseline, tried: Sequence[calibration.Alternative], seed: int, tell: calibration.Observer
) -> Iterator[calibration.AlternativePosterior]:
    begun = time.monotonic()
    for number, one in enumerate(tried, start=1):
        yield calibration.reweight_or_resample(now, one, seed=seed)
        tell.part(Progress(len(tried), number, number, 0, 0, time.monotonic() - begun))


def alternative_of(asked: studies.WhatIf, study: studies.Study, now: calibration.Baseline) -> calibration.Alternative:
    """Return the alternative that is asked for, to be compared with the present posterior; it must fit the study."""
    priors = {name: studies.build_prior(given, f"{PLACE}.prior.{name}") for name, given in asked.prior.items()}
    for name in (*priors, *asked.fix):
        studies.entry(dict.fromkeys(study.space.names), name, f"{PLACE}: name of an input")
    for name, value in asked.fix.items():
        once = "an input without another prior in the same alternative"
        _require(name not in priors, "fix", name, once, "Remove one of the two.")
        low, high = study.space[name].interval
        _require(low <= value <= high, f"fix.{name}", value, f"a value in its box, [{low:g}, {high:g}]")
    with studies.refused_at(f"{PLACE}.prior"):
        space = calibration.with_prior(now.space, priors)
    parts = list(_parts(asked))
    other = _changed(asked, study)
    likelihood = None if now.knowledge is None else _likelihood(asked, other, now.knowledge.likelihood)
    details = [f"{name}: {calibration.prior_in_words(prior)}" for name, prior in priors.items()]
    if likelihood is not None and asked.noise is not None:
        details.append(calibration.facts_of(likelihood))
    with studies.refused_at(f"{PLACE}.fix"):
        return calibration.Alternative(
            name=asked.name or ", ".join(name for _, name, _ in parts),
            kind=parts[0][0] if len(parts) == 1 else "several",
            about=listed([about for _, _, about in parts]),
            space=space,
            likelihood=likelihood,
            fixed=dict(asked.fix),
            detail="; ".join(details),
            by_prior_alone=not _changes_likelihood(asked),
        )


def _parts(asked: studies.WhatIf) -> list[tuple[calibration.Kind, str, str]]:
    """Return the kind, the name and the subject of each change."""
    out: list[tuple[calibration.Kind, str, str]] = []
    out += [("prior", f"another prior of {name}", f"the prior of {name}") for name in asked.prior]
    out += [("fix", f"{name} known to be {value:g}", f"what is known of {name}") for name, value in asked.fix.items()]
    if asked.noise is not None:
        out.append(("noise", "other noise", "the noise"))
    if asked.measure is not None:
        name = asked.measure if isinstance(asked.measure, str) else next(iter(asked.measure))
        out.append(("measure", f"measure {name}", "the measure"))
    out += [("without", f"without condition {name}", f"condition {name}") for name in asked.without]
    return out


def _changes_likelihood(asked: studies.WhatIf) -> bool:
    return asked.noise is not None or asked.measure is not None or bool(asked.without)


def _likelihood(asked: studies.WhatIf, study: studies.Study, present: FieldLikelihood) -> FieldLikelihood | None:
    """Return the likelihood with the noise and measure of `study`, or fewer conditions; None if none is asked for."""
    if not _changes_likelihood(asked):
        return None
    observations, measure = present.observations, present.discrepancy
    if asked.noise is not None or asked.measure is not None:
        measure = study.measure
    if asked.noise is not None:
        observations = tuple(Observation(o.interface, study.noise_of(o.condition), o.condition) for o in observations)
    return replace(present, observations=_left(asked, observations), discrepancy=measure)


def _changed(asked: studies.WhatIf, study: studies.Study) -> studies.Study:
    """Return the study with another noise or measure, checked as any study is; itself if neither is asked for."""
    if asked.noise is None and asked.measure is None:
        return study
    content = studies.StudyFile.model_validate(studies.load_yaml(study.text))
    changes: dict[str, Any] = {}
    if asked.noise is not None:
        changes["noise"] = studies.checked(studies.StudyNoise, asked.noise, f"{PLACE}.noise")
    if asked.measure is not None:
        stated = content.discrepancy if isinstance(content.discrepancy, list) else [content.discrepancy]
        named = {name: one for one in stated for name in one}
        given = asked.measure
        changes["discrepancy"] = named.get(given, {given: None}) if isinstance(given, str) else given
    with studies.refused_at(PLACE):
        return studies.study_of(study.folder, content.model_copy(update=changes), study.text)


def _left(asked: studies.WhatIf, observations: tuple[Observation, ...]) -> tuple[Observation, ...]:
    conditions, named = {seen.condition: seen for seen in observations}, ", ".join(asked.without)
    one_alone = bool(named) and len(conditions) == 1
    _require(not one_alone, "without", named, "several conditions: the study has one", "Remove it.")
    for name in asked.without:
        studies.entry(conditions, name, f"{PLACE}.without")
    left = tuple(seen for name, seen in conditions.items() if name not in asked.without)
    _require(len(left) > 0, "without", named, "at least one condition left", "Leave out fewer.")
    return left


def _require(right: bool, key: str, value: Any, expected: str, remedy: str = "Choose another value.") -> None:
    require(right, f"{PLACE}.{key}", value, expected, remedy, InvalidStudy)


LEVELS = {"low": 0.05, "high": 0.95}  # probabilities below the ends of the 90 % intervals
CUT = 1e-3  # prior probability outside the box from which it is reported
PRIOR = "the prior of "
LARGE = 0.05  # distance of the stored posterior from that of the surrogate, in sd, from which it is said


def _rank(one: calibration.AlternativePosterior) -> tuple[int, float]:
    """Return the rank of an answer: those that move come first, the largest before others, then those without one."""
    return (0 if one.moves else 1 if one.by is None else 2), -one.size


def _described(study: studies.Study, now: calibration.Baseline, answers: Tried, seed: int) -> dict[str, Any]:
    return {
        **studies.facts_of(study, seed),
        "conclusion": _conclusion(answers),
        "remarks": list(_remarks(study, now, answers)),
        "limits": {"shift": calibration.LEAST_SHIFT, "sd_ratio": calibration.LEAST_RATIO},
        "surrogate": _surrogate(now),
        "present": {
            "log_evidence": now.log_evidence,
            "effective": now.weighted.ess,
            "inputs": {
                one.name: {"label": one.shown, "unit": one.unit, **moments(now.weighted, i, LEVELS)}
                for i, one in enumerate(now.space)
            },
        },
        "alternatives": [_alternative(one) for one in answers],
    }


def _conclusion(answers: Tried) -> str:
    if all(one.by is None for one in answers):
        return "None of the alternatives can be computed without new runs."
    subjects = list(dict.fromkeys(one.alternative.about for one in answers if one.moves))
    if not subjects:
        return (
            "The posterior depends on nothing that was tried: no mean moves by more than "
            f"{calibration.LEAST_SHIFT:g} sd, and no sd changes by more than a factor of {calibration.LEAST_RATIO:g}."
        )
    words = listed(_with_priors_together(subjects))
    comma = "," if " and " in words else ""
    return f"The posterior depends on {words}{comma} and on nothing else that was tried."


def _with_priors_together(subjects: Sequence[str]) -> list[str]:
    """Return the subjects, with those that are priors as one, in the place of the first."""
    names = [one.removeprefix(PRIOR) for one in subjects if one.startswith(PRIOR) and " and " not in one]
    if len(names) < 2:
        return list(subjects)
    together = f"the priors of {listed(names)}"
    return list(dict.fromkeys(together if one.removeprefix(PRIOR) in names else one for one in subjects))


def _remarks(study: studies.Study, now: calibration.Baseline, answers: Tried) -> Iterator[str]:
    number = sum(one.by is None for one in answers)
    if number:
        yield remark("new_runs", number=number, of=len(answers), folder=study.folder.resolve().name)
    if now.knowledge is None:
        yield remark("priors_only", why=now.why_not)
    elif now.shift > LARGE:
        yield remark("another_posterior", shift=now.shift)
    if now.space.nuisance:
        yield remark("joint")


def _surrogate(now: calibration.Baseline) -> dict[str, Any] | None:
    if now.knowledge is None or now.quality is None:
        return None
    return {**facts_of_surrogate(now.knowledge.surrogate.runs, now.quality), "shift": now.shift}


def _alternative(one: calibration.AlternativePosterior) -> dict[str, Any]:
    asked = one.alternative
    cut = {parameter.name: parameter.mass_cut for parameter in asked.space if parameter.mass_cut > CUT}
    return {
        **studies.named(asked, "name", "kind", "about", "detail"),
        "mass_cut": cut,
        "by": one.by,
        "k_hat": one.k_hat if math.isfinite(one.k_hat) else None,
        **studies.named(one, "effective", "log_evidence_change"),
        "beyond": None if one.quality is None else one.quality.beyond,
        **studies.named(one, "moves", "why_not"),
        "inputs": {} if one.draws is None else _inputs(one, one.draws),
    }


def _inputs(one: calibration.AlternativePosterior, draws: Weighted) -> dict[str, Any]:
    return {
        name: {
            **moments(draws, i, LEVELS),
            "shift": float(one.shift[i]),
            "shift_error": float(one.shift_error[i]),
            "sd_ratio": float(one.sd_ratio[i]),
            "moves": name in one.moved,
        }
        for i, name in enumerate(one.present.space.names)
        if name not in one.alternative.fixed
    }


def _answer(content: dict[str, Any], found: Tried, folder: Path) -> Answer[Tried]:
    some, inputs = content["alternatives"], content["present"]["inputs"]
    symbols = [Symbol(item["label"]) for item in inputs.values()]
    head = "what changed", *symbols, "log-evidence", "by", "k̂", "effective draws", "moves"
    table = Table(head, [_row(one, list(inputs)) for one in some])
    return Answer(
        title=f"{content['study']}: what if",
        lead=f"How would the posterior change with other assumptions? {len(some)} alternative{'s' * (len(some) != 1)}, "
        "no forward run.",
        sentence=content["conclusion"],
        remarks=content["remarks"],
        good=not any(one["moves"] for one in some),
        parts=[Part("The alternatives", table, notes="alternatives"), Part("How it was computed", notes="how_changed")],
        content=content,
        found=found,
        page=folder / "what-if.html",
        drawn=_drawn,
    )


def _drawn(content: Mapping[str, Any]) -> Iterator[Captioned]:
    inputs = content["present"]["inputs"]
    alternatives = [
        (figure_text(one["name"]), [one["inputs"].get(name) for name in inputs])
        for one in content["alternatives"]
        if one["by"] is not None
    ]
    if not inputs:
        return
    figure = plots.plot_alternatives({axis_label(item): item for item in inputs.values()}, alternatives)
    yield Captioned.of("what_if", "what_if", figure, **content["limits"])


def _row(one: Mapping[str, Any], names: Sequence[str]) -> tuple[str, ...]:
    k_hat = "–" if one["k_hat"] is None else f"{one['k_hat']:.2f}"
    if one["by"] is None:
        return one["name"], f"needs new runs: {one['why_not']} (k̂ {k_hat}, {one['effective']:.0f} effective draws)"
    known = [one["inputs"].get(name) for name in names]
    return (
        one["name"],
        *("known" if item is None else f"{item['shift']:+.2f} sd ×{item['sd_ratio']:.2f}" for item in known),
        "–" if one["log_evidence_change"] is None else f"{one['log_evidence_change']:+.2f}",
        "reweighting" if one["by"] == "reweighting" else "new draws",
        k_hat,
        f"{one['effective']:.0f}",
        ", ".join(name for name, item in one["inputs"].items() if item["moves"]) or "–",
    )
