"""What each model is expected to show in candidates for the next experiment, to see which tells the models apart."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.calibration import Observer
from strandline.design.candidates import Candidate
from strandline.errors import InvalidStudy
from strandline.models.protocol import declared_conditions
from strandline.questions.knowledge import require
from strandline.questions.next_from_posterior import AfterExperiment, Prospect, Prospects, prospects_of
from strandline.questions.observing import signals_of
from strandline.runs import Executor
from strandline.studies.study import Study

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
    along = presents[0].seen(pairs[0][2], candidate.look)
    observing = [present.observing(field, candidate.look, along=along) for present, _, field in pairs]
    first = observing[0]
    blocks = []
    for seen, (present, one, _) in zip(observing, pairs, strict=True):
        nodes, rows = present.nodes(one.fields), []
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
    seen = [present.seen(present.now.weights @ one.fields, candidate.look) for present, one in pairs]
    return all(len({one[name].points.shape for one in seen}) == 1 for name in seen[0])
