"""Forward runs of candidates, with sensitivities if the model offers them; they have their own ledger, next.sqlite."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.calibration import Errors, Observer
from strandline.design import Candidate
from strandline.foundations import InvalidInput
from strandline.models import WithCheaper, with_sensitivities
from strandline.posterior import Weighted
from strandline.questions.information import Direction, Outlook
from strandline.runs import Executor, Ledger, RunRecord, run_campaign, run_key
from strandline.studies import NEXT_LEDGER, Study, settled


@dataclass(frozen=True, eq=False)
class PointRuns:
    """The runs at one point, and without usable sensitivities the `others`, one `beside` it for each input."""

    x: Float[np.ndarray, " dim"]
    beside: Float[np.ndarray, "dim dim"]
    run: RunRecord
    others: tuple[RunRecord, ...]

    @property
    def failed(self) -> RunRecord | None:
        """The first run that failed."""
        return next((one for one in (self.run, *self.others) if not one.ok), None)


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs at several points, and how many of them were made now or known."""

    points: tuple[PointRuns, ...]
    new: int
    reused: int


def runs_at(
    study: Study,
    points: Sequence[tuple[Mapping[str, float], Float[np.ndarray, " dim"]]],
    steps: Float[np.ndarray, " dim"],
    usable: Callable[[RunRecord], bool],
    executor: Executor,
    observer: Observer,
) -> Runs:
    """Return the runs at points, none for no points; a run that next.sqlite holds is not made again.

    Each point has the quantities that differ from the study's, and the inputs. If the sensitivities of its run are not
    `usable`, further runs are made at a distance of `steps` in one input each, inside the box.
    """
    if not points:
        return Runs((), 0, 0)
    plain = study.model.model if isinstance(study.model, WithCheaper) else study.model
    model, identity, counts = _sensitive(plain), study.runs.identity, Counter[str]()
    beside = [np.asarray(x + np.diag(np.where(x + steps > study.space.high, -steps, steps))) for _, x in points]
    at_points = [_inputs(study, setting, x) for setting, x in points]
    around = [[_inputs(study, setting, row) for row in rows] for (setting, _), rows in zip(points, beside, strict=True)]

    def made(model: Any, inputs: Sequence[Mapping[str, float]]) -> tuple[RunRecord, ...]:
        keys = {run_key(identity, entry) for entry in inputs}
        known = len(settled(ledger, keys, sensitivities=getattr(model, "sensitivities", False) is True))
        counts.update(new=len(keys) - known, reused=known)
        return run_campaign(model, inputs, ledger=ledger, executor=executor, on_record=observer.run)

    with Ledger.open(study.folder / NEXT_LEDGER, model=identity, description=f"{study.name}, next") as ledger:
        records = made(model, at_points)
        if any(one.failure_kind == "no_sensitivities" for one in records):
            model = plain
            records = made(model, at_points)
        bare = [one.ok and not usable(one) for one in records]
        entries = [entry for some, is_bare in zip(around, bare, strict=True) if is_bare for entry in some]
        others = iter(made(model, entries) if entries else ())
    found = tuple(
        PointRuns(x, rows, record, tuple(next(others) for _ in rows) if is_bare else ())
        for (_, x), rows, record, is_bare in zip(points, beside, records, bare, strict=True)
    )
    return Runs(found, counts["new"], counts["reused"])


def _inputs(study: Study, setting: Mapping[str, float], x: Float[np.ndarray, " dim"]) -> dict[str, float]:
    return {**study.fixed, **study.space.as_mapping(x), **setting}


def _sensitive(model: Any) -> Any:
    try:
        return with_sensitivities(model)
    except InvalidInput:
        return model


@dataclass(frozen=True, eq=False)
class CandidateAnswer:
    """What one candidate can be expected to teach.

    `outlook` is None if its run failed, and `problem` then says why. `failing` is the probability that the specimen
    folds or the run fails, None if nothing is known about it; `displacement` that of the interface from its undeformed
    state, in standard deviations of the points' errors, None if the model does not know that state.
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

    `source` is what is known before, the ``prior`` or the ``posterior``, and `now` draws of it; `errors` are those of
    the observed points by condition. `directions` are combinations of the inputs in prior standard deviations, from the
    least to the best known: after the present experiment, or before any data after the planned one. `new` runs were
    made now.
    """

    source: str
    now: Weighted
    errors: Mapping[str, Errors]
    answers: tuple[CandidateAnswer, ...]
    directions: tuple[Direction, ...]
    new: int
    reused: int


def ranked(answers: Sequence[CandidateAnswer]) -> tuple[CandidateAnswer, ...]:
    """Return the answers in the order of their worth, single experiments before several together."""
    return tuple(sorted(answers, key=lambda one: (len(one.candidate.settings), -one.worth)))


def problem_of(record: RunRecord) -> str:
    """Return why a run failed, in a line."""
    said = (record.message or "").partition("\n")[0]
    return f"its run failed: {record.failure_kind or record.state}{f': {said}' if said else ''}"
