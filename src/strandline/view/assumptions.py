"""What the sliders of the page ask → an alternative to the study, its posterior, and a new study with it."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from strandline import calibration, studies
from strandline.calibration import Alternative, AlternativePosterior, Baseline, scaled_noise
from strandline.foundations import require, unfit
from strandline.interface import GaussianNoise, PointErrors
from strandline.likelihood import FieldLikelihood
from strandline.studies import Number, Section, Study

NOISE, LENGTH = (0.2, 5.0), (0.0, 200.0)
"""Range of the factor on the noise's standard deviation, and of the correlation length, µm."""
SEED = 1
TO_UM = 1e3
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,62}")


class Asked(Section):
    """Other assumptions, as the page sends them; what it leaves out is as the study states it."""

    noise: Annotated[Number, Field(ge=NOISE[0], le=NOISE[1])] = 1.0
    """factor on the standard deviation of the noise"""
    length_um: Annotated[Number, Field(ge=LENGTH[0], le=LENGTH[1])] | None = None
    """correlation length of the points' errors, µm"""
    measure: str | None = None
    """name of a measure of the study"""
    priors: dict[str, Annotated[dict[str, list[Number]], Field(min_length=1, max_length=1)]] = Field({})
    """other priors by input, as study.yaml has them"""
    fixed: dict[str, Number] = Field({})
    """inputs taken as known"""


def knobs_of(study: Study, now: Baseline | None) -> dict[str, Any]:
    """Return what the page may change, with the present values; `now` is None if there is no posterior yet."""
    noises = [study.noise, *study.noises.values()]
    by_points = all(isinstance(one, PointErrors) for one in noises)
    sure = all(scaled_noise(one, 2.0) is not None for one in noises)
    through = now is not None and now.knowledge is not None
    first = noises[-1]
    length = TO_UM * first.length if isinstance(first, PointErrors) else None
    return {
        "noise": {"range": list(NOISE), "now": _in_words(first)} if sure and through else None,
        "length_um": {"range": list(LENGTH), "now": length} if by_points and through else None,
        "measures": list(study.discrepancies) if through else [next(iter(study.discrepancies))],
        "why_not": "" if now is None or through else now.why_not,
    }


def _in_words(noise: object) -> dict[str, Any]:
    """Return the present noise: its standard deviation and the unit of it."""
    if isinstance(noise, PointErrors):
        return {"sd": TO_UM * noise.sd, "unit": "µm"}
    if isinstance(noise, GaussianNoise):
        return {"sd": float(np.sqrt(noise.variance)), "unit": "σ_N"}
    return {"sd": None, "unit": ""}


def asked_by(given: Mapping[str, Any], study: Study) -> Asked:
    """Return what the page asks; refuse values that make no sense."""
    asked = studies.checked(Asked, given, "assumptions")
    known = asked.measure in (None, *study.discrepancies)
    require(known, "measure", asked.measure, f"one of {', '.join(study.discrepancies)}")
    for name in (*asked.priors, *asked.fixed):
        require(name in study.space.names, "input", name, f"one of {', '.join(study.space.names)}")
    for name, value in asked.fixed.items():
        number_in(name, value, *study.space[name].interval)
    return asked


def answer_to(asked: Asked, study: Study, now: Baseline, *, again: bool) -> AlternativePosterior:
    """Return the posterior under other assumptions without a run, by other weights or, if `again`, by new draws."""
    alternative = _alternative(asked, study, now)
    if again or alternative.fixed:
        return calibration.reweight_or_resample(now, alternative, seed=SEED)
    return calibration.reweighted(now, alternative)


def _alternative(asked: Asked, study: Study, now: Baseline) -> Alternative:
    priors = {name: studies.build_prior(one, f"prior of {name}") for name, one in asked.priors.items()}
    plain = asked.noise == 1 and asked.length_um is None and asked.measure is None
    possible, expected = plain or now.knowledge is not None, f"another prior only: {now.why_not}"
    require(possible, "assumptions", "another noise or measure", expected)
    likelihood = None if plain or now.knowledge is None else _likelihood(asked, study, now.knowledge.likelihood)
    return Alternative(
        name="as asked",
        kind="several",
        about="the assumptions",
        space=calibration.with_prior(now.space, priors),
        likelihood=likelihood,
        fixed=dict(asked.fixed),
        by_prior_alone=likelihood is None,
    )


def _likelihood(asked: Asked, study: Study, present: FieldLikelihood) -> FieldLikelihood:
    measure = present.discrepancy if asked.measure is None else study.discrepancies[asked.measure]
    seen = []
    for one in present.observations:
        noise: Any = scaled_noise(one.noise, asked.noise)
        require(noise is not None, "noise", "another standard deviation", "a study that states it")
        if asked.length_um is not None:
            stated = "a study that states the errors of its points"
            require(isinstance(noise, PointErrors), "length_um", asked.length_um, stated)
            noise = replace(noise, length=asked.length_um / TO_UM)
        seen.append(replace(one, noise=noise))
    return replace(present, observations=tuple(seen), discrepancy=measure)


def number_in(name: str, given: Any, low: float, high: float) -> float:
    """Return a number that the page sends; refuse one that is not between these."""
    good = isinstance(given, int | float) and not isinstance(given, bool) and low <= given <= high
    require(good, name, given, f"a number from {low:g} to {high:g}")
    return float(given)


def save_as(study: Study, name: str, asked: Asked) -> Path:
    """Write a study with other assumptions, its files and `reuse` beside the present one; return its folder."""
    good = NAME.fullmatch(name) is not None
    require(good, "name of the new study", name, "letters, digits, -, _ and . (at most 63)")
    present = study.folder.resolve()
    target = present.parent / name
    require(not target.exists(), "name of the new study", name, "no such folder yet")
    text = studies.changed_text(study.text, _changes(study, name, asked, present, target))
    studies.write_copy(present, target, f"# {name}: {study.name} with other assumptions\n{text}")
    return target


def _changes(study: Study, name: str, asked: Asked, present: Path, target: Path) -> dict[tuple[str, ...], Any]:
    """Return the values that differ in the new study, which takes over the runs of the present one."""
    content = studies.load_yaml(study.text)
    changes: dict[tuple[str, ...], Any] = {("name",): name}
    of_fields = {f"{one.name}_{which}": (one.name, which) for one in study.space.fields for which in one.prior.unknown}
    for key, other in (*asked.priors.items(), *asked.fixed.items()):
        if key in of_fields:  # the sd or length of a field
            of, which = of_fields[key]
            changes["inputs", of, "field", which] = dict(other) if isinstance(other, Mapping) else other
        elif isinstance(other, Mapping):
            changes["inputs", key, "prior"] = dict(other)
            changes["inputs", key, "box"] = content["inputs"][key].get("box", list(study.space[key].interval))
        else:
            changes["inputs", key] = studies.REMOVED
            changes["fixed", key] = other
    if asked.noise != 1 or asked.length_um is not None:
        changes["noise",] = _noise(study, asked)
    if asked.measure is not None:
        stated = content["discrepancy"] if isinstance(content["discrepancy"], list) else [content["discrepancy"]]
        each = [{measure: options} for one in stated for measure, options in one.items()]
        changes["discrepancy",] = sorted(each, key=lambda one: asked.measure not in one)
    changes["reuse",] = studies.reuse_from(present, target, content.get("reuse"))
    return changes


def _noise(study: Study, asked: Asked) -> dict[str, Any]:
    """Return the key `noise` with another standard deviation, unless points or conditions have noise of their own."""
    noise = study.noise
    if not study.noises and isinstance(noise, GaussianNoise):
        return {"variance": float(f"{asked.noise**2 * noise.variance:.6g}")}
    given = studies.load_yaml(study.text)["noise"]
    if not study.noises and isinstance(noise, PointErrors) and isinstance(given.get("sd"), int | float | str):
        sd = float(f"{asked.noise * TO_UM * noise.sd:.6g}")
        length = TO_UM * noise.length if asked.length_um is None else asked.length_um
        kept = {key: value for key, value in given.items() if key not in ("sd", "length", "unit")}
        if not kept:
            return {"sd": sd, "unit": "um", **({"length": float(f"{length:.6g}")} if length else {})}
    found = "other noise for a study whose points or conditions have their own"
    expected, remedy = "a study with one standard deviation", "Change noise in study.yaml by hand."
    raise unfit("noise of the new study", found, expected, remedy)
