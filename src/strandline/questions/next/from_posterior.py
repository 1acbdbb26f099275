"""What each candidate can be expected to teach after the experiment of a study, from its posterior."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from strandline.calibration import Observer
from strandline.planning.candidate import Candidate, Look
from strandline.planning.observing import Observing
from strandline.planning.outlook import expected_outlook
from strandline.questions.next.answers import Answer, Answers
from strandline.questions.next.prospects import Present, Prospect, prospects_of
from strandline.runs import Executor
from strandline.studies.study import Study

__all__ = ["answers_from_posterior"]

INFORMATIONS = 16
"""Draws at which the Fisher information is taken where a gain is linearised."""


def answers_from_posterior(
    study: Study, candidates: Sequence[Candidate], *, draws: int, seed: int, executor: Executor, observer: Observer
) -> Answers:
    """Return what each candidate can be expected to teach, given the posterior of a finished study.

    Args:
        study: The study.
        candidates: The candidates.
        draws: Number of draws of the posterior.
        seed: Seed of all random numbers.
        executor: Where runs are made.
        observer: Receives the progress.

    Raises:
        InvalidStudy: The study has no posterior, or no surrogate of the interface can be learnt.
        InvalidInput: No independent errors of the points have the stated σ_N².
    """
    found = prospects_of(study, candidates, draws=draws, seed=seed, executor=executor, observer=observer)
    observer.stage("gains")
    return Answers(
        source="posterior",
        now=found.present.now,
        errors=found.present.experiment.errors,
        answers=tuple(_answer(found.present, candidate, found.of(candidate), seed) for candidate in candidates),
        directions=found.present.directions,
        new=found.new,
        reused=found.reused,
    )


def _answer(present: Present, candidate: Candidate, made: Sequence[Prospect], seed: int) -> Answer:
    """Return what one candidate can be expected to teach."""
    problem = next((one.problem for one in made if one.problem), "")
    if problem:
        return Answer(candidate, None, None, None, problem)
    now = present.now
    observing = [present.observing(now.weights @ one.fields, candidate.look) for one in made]
    pairs = list(zip(observing, made, strict=True))
    signals = np.hstack([seen.signals(present.nodes(one.fields)) for seen, one in pairs])

    def informations() -> list[Float[np.ndarray, "dim dim"]]:
        some = now.draws[np.linspace(0, len(now.draws) - 1, INFORMATIONS).astype(int)]
        return [np.sum([_information(present, one, candidate.look, x) for one in made], axis=0) for x in some]

    outlook = expected_outlook(now, signals, informations, interest=present.study.space.calibrated, seed=seed)
    failing = [one.failing for one in made]
    known = [1 - one for one in failing if one is not None]
    sizes = [] if present.undeformed is None else [_displacement(present, seen) for seen in observing]
    return Answer(
        candidate,
        outlook,
        1 - float(np.prod(known)) if len(known) == len(failing) else None,
        max(sizes) if sizes else None,
    )


def _information(
    present: Present, one: Prospect, look: Look, x: Float[np.ndarray, " dim"]
) -> Float[np.ndarray, "dim dim"]:
    assert one.forecast is not None
    return present.observing(one.forecast.fields(x[None])[0], look).fisher(one.forecast.slopes(x))


def _displacement(present: Present, observing: Observing) -> float:
    assert present.undeformed is not None
    nodes = present.nodes(present.undeformed[None])
    return observing.displacement({name: points[0] for name, points in nodes.items()})
