"""Can studies be compared? Only if they explain the same data, with the same measure, noise and supports of priors.

Log-likelihoods leave out constants, so that evidences of other data, measures or noise differ by more than the models.
What may differ is the model, its unknown and its known inputs, and whether the study allows for an error of the model.
What each model is expected to show in candidates for the next experiment tells which of them separates the models.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float

from strandline.calibration import Observer
from strandline.design import Candidate
from strandline.foundations import InvalidStudy
from strandline.interface import Interface, Noise, PointErrors, UnknownErrors
from strandline.likelihood import adapted
from strandline.models import declared_conditions
from strandline.questions.knowledge import require
from strandline.questions.next_answers import AfterExperiment, Prospect, Prospects, prospects_of
from strandline.questions.observing import signals_of
from strandline.runs import Executor
from strandline.studies import Study, in_words, observations_of

SAME = 1e-6
"""Largest distance of points that count as the same, mm."""
OF_POINTS = ("sd", "length", "shift", "rotation", "scale", "offset", "shared", "shares")
DEFAULTS = {"shared": False, "shares": ()}


def require_several(studies: Sequence[Study]) -> None:
    """Refuse fewer than two studies, and the same folder twice."""
    folders = ", ".join(str(one.folder) for one in studies) or "none"
    remedy = "Name the other one too: strandline compare A B"
    require(len(studies) >= 2, "studies to compare", folders, "at least two study folders", remedy)
    seen: set[Path] = set()
    for one in studies:
        here = one.folder.resolve()
        require(here not in seen, "studies to compare", f"{one.folder} twice", "different folders")
        seen.add(here)


def labels_of(studies: Sequence[Study]) -> tuple[str, ...]:
    """Return a different name for each study: its own, or else that of its folder, or else the path."""
    folders = [one.folder.resolve() for one in studies]
    for names in ([one.name for one in studies], [one.name for one in folders]):
        if len(set(names)) == len(names):
            return tuple(names)
    return tuple(map(str, folders))


def require_comparable(studies: Mapping[str, Study]) -> None:
    """Refuse studies whose data, measure, noise or supports of shared inputs differ; the message says which."""
    (name, first), *others = studies.items()
    for one, study in studies.items():
        _require_known_range(one, study)
    for other, study in others:
        both = f"{name} and {other} cannot be compared"
        _require_same_data(both, first, study)
        _require_same_measure(both, first, study)
        _require_same_noise(both, first, study)
    for (one, study), (other, second) in combinations(studies.items(), 2):
        _require_same_supports(f"{one} and {other} cannot be compared", study, second)


def may_err(study: Study) -> bool:
    """Return whether the study allows for an error of the model."""
    noises = [study.noise, *study.noises.values()]
    return any(isinstance(one, UnknownErrors) and (one.model_error or bool(one.spread)) for one in noises)


def _require_same_data(both: str, first: Study, other: Study) -> None:
    seen, others = observations_of(first), observations_of(other)
    if seen.keys() != others.keys():
        value = " and ".join(", ".join(map(_condition, one)) for one in (seen, others))
        _refuse(f"{both}: they observe different conditions", value, "the same conditions in both")
    for name in seen:
        apart = _apart(seen[name], others[name])
        if not apart <= SAME:
            of = f" of {_condition(name)}" if name else ""
            value = "another number of points" if apart == np.inf else f"points up to {1e3 * apart:.3g} µm apart"
            remedy = "Give both studies the same file under observation."
            if first.truth is not None or other.truth is not None:
                where = "write it to a file with `strandline forward … --csv`, and give that to both."
                remedy = f"A synthetic observation comes from the study's own model: {where}"
            _refuse(f"{both}: the observed interfaces{of} differ", value, "the same data", remedy)


def _apart(one: Interface, other: Interface) -> float:
    """Return the largest distance of corresponding points, mm, in either direction; infinite if numbers differ."""
    if one.points.shape != other.points.shape or one.cells.shape != other.cells.shape:
        return np.inf
    turned = [other.points, other.points[::-1]] if one.dim == 2 else [other.points]
    return min(float(np.linalg.norm(one.points - points, axis=1).max()) for points in turned)


def _require_same_measure(both: str, first: Study, other: Study) -> None:
    seen = [study.observations(observations_of(study)) for study in (first, other)]
    studies = zip((first, other), seen, strict=True)
    one, two = (in_words(adapted(study.measure, some[0]) if some else study.measure) for study, some in studies)
    if one != two:
        _refuse(f"{both}: the measures differ", f"{one} and {two}", "the same measure first under discrepancy")


def _require_same_noise(both: str, first: Study, other: Study) -> None:
    for name in observations_of(first):
        one, two = (_stated(study.noise_of(name)) for study in (first, other))
        shares = two.get("shares")
        turned = {**two, "shares": shares[::-1]} if isinstance(shares, tuple) else two
        if one in (two, turned):
            continue
        of = f" of {_condition(name)}" if name else ""
        different = [key for key in one if one[key] != two.get(key)] or ["its kind"]
        value = "; ".join(f"{key} {one.get(key)} and {two.get(key)}" for key in different if key != "shares")
        expected = "the same errors of the data in both; model_error and spread may differ"
        _refuse(f"{both}: the noise{of} differs", value or "other errors of single points", expected)


def _stated(noise: Noise | PointErrors | UnknownErrors) -> dict[str, object]:
    """Return what is stated about the errors of the data, without those of the model."""
    if isinstance(noise, PointErrors | UnknownErrors):
        return {"kind": "points", **{key: getattr(noise, key, DEFAULTS.get(key)) for key in OF_POINTS}}
    return {"kind": type(noise).__qualname__, **noise.facts}


def _require_known_range(name: str, study: Study) -> None:
    """Refuse unknown errors without a range: each model would then get another prior, from its own residuals."""
    for condition in observations_of(study):
        noise = study.noise_of(condition)
        if isinstance(noise, UnknownErrors) and (noise.sd is None or noise.length is None):
            _refuse(
                f"{name} cannot be compared: the range of its unknown noise is not stated",
                "sd or length: unknown",
                "a value or a range, since the evidence depends on it",
                "State a range, e.g. noise: {sd: [1, 10], length: [5, 50], unit: um}, in all studies.",
            )


def _require_same_supports(both: str, first: Study, other: Study) -> None:
    for parameter in first.space:
        if parameter.name not in other.space.names:
            continue
        second = other.space[parameter.name]
        if parameter.unit != second.unit:
            value = f"{parameter.unit} and {second.unit}"
            _refuse(f"{both}: the units of {parameter.name} differ", value, "the same unit of a shared input")
        if not np.allclose(parameter.interval, second.interval, rtol=1e-12, atol=0.0):
            value = " and ".join(f"[{low:g}, {high:g}]" for low, high in (parameter.interval, second.interval))
            _refuse(
                f"{both}: the supports of the priors of {parameter.name} differ",
                value,
                "the same support of a shared input",
                "Give it the same box or prior in both, or another name if it means something else.",
            )


def _condition(name: str) -> str:
    return name or "a condition without a name"


def _refuse(what: str, value: str, expected: str, remedy: str = "Make them the same and run again.") -> None:
    raise InvalidStudy(what, value=value, expected=expected, remedy=remedy)


DRAWS = 500
"""Draws of each posterior, few enough to be all different."""


@dataclass(frozen=True, eq=False)
class CandidateSignals:
    """What a candidate shows under each model: signals of equally likely draws, in the same coordinates."""

    label: str
    signals: tuple[Float[np.ndarray, "_ signal"], ...]
    problem: str = ""


def candidates_of(studies: Sequence[Study]) -> tuple[Candidate, ...]:
    """Return the candidates of the first study that lists some; refuse studies without any."""
    found = next((one.candidates for one in studies if one.candidates), ())
    require(
        bool(found),
        "none of the studies lists candidates for the next experiment",
        ", ".join(one.name for one in studies),
        "the key `next` in the study.yaml of one of them",
        "Add it; the results of the study stay as they are.",
        InvalidStudy,
    )
    return found


def shown_by_models(
    studies: Mapping[str, Study],
    candidates: Sequence[Candidate],
    *,
    seed: int,
    executor: Executor | None,
    tell: Observer,
) -> tuple[CandidateSignals, ...]:
    """Return what each candidate shows under each model; it costs at most one run with sensitivities of each."""
    found = [
        prospects_of(one, candidates, draws=DRAWS, seed=seed, executor=executor or one.executor, observer=tell)
        for one in studies.values()
    ]
    return tuple(_shown(candidate, found) for candidate in candidates)


def require_settable(studies: Mapping[str, Study], candidates: Sequence[Candidate]) -> None:
    """Refuse candidates that one of the studies could not make: each model must know what they set and observe."""
    for name, study in studies.items():
        for candidate in candidates:
            quantities = [pair for setting in candidate.settings for pair in setting.items()]
            problems = [_problem(study, quantity, value) for quantity, value in quantities]
            missing = [one for one in candidate.look.conditions if one not in declared_conditions(study.model)]
            problems += [f"condition {one}, which its model does not have" for one in missing]
            require(
                not any(problems),
                f"the candidates under next do not fit {name}",
                next(filter(None, problems), ""),
                "quantities that are fixed or a nuisance input in all studies, and conditions of all models",
                "Remove the candidate, or change the study.",
                InvalidStudy,
            )


def _problem(study: Study, quantity: str, value: float) -> str:
    """Return why a study cannot set a quantity; empty if it can."""
    if quantity in study.fixed:
        return ""
    if quantity not in study.space.names:
        return f"{quantity}, which its model does not have"
    low, high = study.space[quantity].interval
    if not study.space[quantity].nuisance:
        return f"{quantity}, which is calibrated there"
    return "" if low <= value <= high else f"{quantity} {value:g}, which is outside its box there"


def _shown(candidate: Candidate, found: Sequence[Prospects]) -> CandidateSignals:
    made = [one.of(candidate) for one in found]
    problem = next((one.problem for several in made for one in several if one.problem), "")
    presents, experiments = [one.present for one in found], list(zip(*made, strict=True))
    if not problem and any(not _alike(presents, candidate, several) for several in experiments):
        problem = "the models' interfaces have different points where nothing was observed"
    if problem:
        return CandidateSignals(candidate.label(), (), problem)
    parts = [_signals(candidate, presents, several) for several in experiments]
    return CandidateSignals(candidate.label(), tuple(np.hstack(one) for one in zip(*parts, strict=True)))


def _signals(
    candidate: Candidate, presents: Sequence[AfterExperiment], several: Sequence[Prospect]
) -> list[Float[np.ndarray, "_ signal"]]:
    """Return the signals of one experiment under each model, about the mean interface of the first."""
    pairs = [(present, one, present.now.weights @ one.fields) for present, one in zip(presents, several, strict=True)]
    whole = [present.observing(field, candidate.look) for present, _, field in pairs]
    observing = [one.focused(candidate.look, along=whole[0].seen) for one in whole]
    first = observing[0]
    blocks = []
    for seen, (present, one, _) in zip(observing, pairs, strict=True):
        nodes, rows = present.surrogate.by_condition(one.fields), []
        for name, view in first.views.items():
            reference = view.seen(first.reference[name])
            moves = seen.views[name].points(nodes[name]) - reference.points
            rows.append(view.along(reference, moves))
        blocks.append(np.hstack(rows))
    signals = signals_of(np.vstack(blocks), first.information)
    return np.split(signals, np.cumsum([len(one) for one in blocks])[:-1])


def _alike(presents: Sequence[AfterExperiment], candidate: Candidate, several: Sequence[Prospect]) -> bool:
    """Return whether the whole interfaces of all models have corresponding points."""
    pairs = zip(presents, several, strict=True)
    seen = [present.observing(present.now.weights @ one.fields, candidate.look).seen for present, one in pairs]
    return all(len({one[name].points.shape for one in seen}) == 1 for name in seen[0])
