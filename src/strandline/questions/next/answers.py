"""What each candidate for the next experiment can be expected to teach, as one answer for each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strandline.calibration.experiment import Errors
from strandline.planning.candidate import Candidate
from strandline.planning.identifiability import Direction
from strandline.planning.outlook import Outlook
from strandline.posterior.weighted import Weighted
from strandline.runs import RunRecord

__all__ = ["Answer", "Answers", "problem_of", "ranked"]


@dataclass(frozen=True, eq=False)
class Answer:
    """What one candidate can be expected to teach.

    Args:
        candidate: The candidate.
        outlook: What it can be expected to teach; None if its run failed.
        failing: Probability that the specimen folds or the run fails; None if nothing is known about it.
        displacement: Displacement of the interface from its undeformed state, in standard deviations of the points'
            errors; None if the model does not know that state.
        problem: Why there is no outlook; empty if there is one.
    """

    candidate: Candidate
    outlook: Outlook | None
    failing: float | None
    displacement: float | None
    problem: str = ""

    @property
    def worth(self) -> float:
        """Expected information gain, nats, with nothing learnt where the experiment fails."""
        return -np.inf if self.outlook is None else self.outlook.gain * (1 - (self.failing or 0.0))


@dataclass(frozen=True, eq=False)
class Answers:
    """What the candidates can be expected to teach.

    Args:
        source: What is known before: the ``prior`` or the ``posterior``.
        now: Draws of it.
        errors: Errors of the observed points by condition.
        answers: Answers, one for each candidate.
        directions: Combinations of the inputs in prior standard deviations, from the least to the best known: after
            the present experiment, or before any data after the planned one.
        new: Number of forward runs made now.
        reused: Number of runs that were known.
    """

    source: str
    now: Weighted
    errors: Mapping[str, Errors]
    answers: tuple[Answer, ...]
    directions: tuple[Direction, ...]
    new: int
    reused: int


def ranked(answers: Sequence[Answer]) -> tuple[Answer, ...]:
    """Return the answers in the order of their worth, single experiments before several together."""
    return tuple(sorted(answers, key=lambda one: (len(one.candidate.settings), -one.worth)))


def problem_of(record: RunRecord) -> str:
    """Return why a run failed, in a line."""
    said = (record.message or "").partition("\n")[0]
    return f"its run failed: {record.failure_kind or record.state}{f': {said}' if said else ''}"
