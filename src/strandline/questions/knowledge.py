"""What every question takes from a finished study: the interface learnt from its runs, and further runs."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.calibration import Baseline, Observer, baseline, known_field
from strandline.design import Knowledge, RunFilter, as_by_model
from strandline.foundations import InvalidInput, InvalidStudy, NoCommonPoints, TooFewRuns, __version__, require
from strandline.models import WithCheaper, with_sensitivities
from strandline.posterior import Posterior
from strandline.runs import Executor, Ledger, RunRecord, outcome_digest, run_campaign, run_key
from strandline.studies import NEXT_LEDGER, Study, cheaper_dropped, observations_of, require_study, settled


def chosen_measure(study: Study, name: str | None, of: str) -> str:
    """Return the name of a measure of the study, by default its first; `of` is what it is for."""
    require_study(study)
    known = f"one of the study's: {', '.join(study.discrepancies)}"
    remedy = "Name one of them, or add it to study.yaml under discrepancy."
    require(name is None or name in study.discrepancies, f"measure of {of}", name, known, remedy)
    return name or next(iter(study.discrepancies))


def require_seed(seed: int, of: str) -> None:
    """Refuse a negative seed; `of` says what it is for."""
    require(seed >= 0, f"seed of {of}", seed, "0 or above")


MOST_ROWS, FEWEST_RUNS = 400, 50
"""Values and derivatives from which the interface is learnt in a study that learns the log-likelihood; fewest runs."""


def field_knowledge(
    study: Study, measure: str | None = None, *, purpose: str = "coverage", more: Sequence[RunRecord] = ()
) -> Knowledge:
    """Learn the interface from the runs of a finished study, and `more` of its model, and what a measure says of it.

    The measure is the first one by default; `purpose` is what needs the interface, a noun for the message.

    Raises:
        InvalidStudy: The runs have no common points, or the synthetic observation is missing.
        TooFewRuns: Too few runs succeeded.
    """
    measure, observed = measure or next(iter(study.discrepancies)), observations_of(study)
    what, value = "the synthetic observation is not in the ledger", "no run that ended ok"
    words = "the run at the inputs of observation.synthetic", f"Run the study first: strandline run {study.folder}"
    require(observed, what, value, *words, InvalidStudy)
    judge = RunFilter(study.observations(observed), {measure: study.discrepancies[measure]}, study.settings.failures)
    records = (*runs_to_learn_from(study), *more)
    points = np.array([[record.inputs[name] for name in study.space.names] for record in records], float)
    try:
        return known_field(points, records, judge, study.space)[0]
    except NoCommonPoints as error:
        what, value = f"{purpose} needs a surrogate of the interface", str(error.value)
        expected = "runs whose interfaces can be brought to common points"
        remedy = "Let the simulator return interfaces of the same kind, best with the same nodes in all runs."
        raise InvalidStudy(what, value=value, expected=expected, remedy=remedy) from error


def baseline_of(study: Study, posterior: Posterior, *, purpose: str) -> Baseline:
    """Return the posterior of a finished study beside the surrogate of the interface, if one can be learnt."""
    try:
        return baseline(posterior, field_knowledge(study, purpose=purpose))
    except (InvalidStudy, TooFewRuns) as error:
        return baseline(posterior, None, why_not=f"there is no surrogate of the interface ({error.value})")


def runs_to_learn_from(study: Study) -> tuple[RunRecord, ...]:
    """Return the finished runs of a study from which the interface is learnt."""
    return _thinned(study, _finished(study))


def _finished(study: Study) -> tuple[RunRecord, ...]:
    """Return the study's runs in the order in which it asked for them, those of a cheaper model corrected."""
    runs = study.runs
    keys = [*runs.design_keys, *(key for some in runs.rounds for key in some)]
    with Ledger.open(study.ledger_path, model=runs.identity, read_only=True) as ledger:
        found = {record.key: record for record in settled(ledger, keys, sensitivities=study.sensitivities)}
    records = [found[key] for key in dict.fromkeys(keys) if key in found]
    return as_by_model(records, study.space.names, dropped=cheaper_dropped(study.folder))


def _thinned(study: Study, records: tuple[RunRecord, ...]) -> tuple[RunRecord, ...]:
    """Return all runs if the study learns the interface, else the first and last ones, few enough to learn quickly."""
    rows = 1 + (study.space.dim if study.sensitivities else 0)
    most = max(MOST_ROWS // rows, FEWEST_RUNS)
    if study.settings.surrogate == "field" or len(records) <= most:
        return records
    return (*records[: most // 2], *records[-(most // 2) :])


def digest_of(study: Study, measure: str, seed: int, **more: Any) -> str:
    """Return a digest of what an answer depends on: study, runs, inputs, measure, seed, this version, and `more`."""
    facts = {
        "study": study.text_digest,
        "model": study.runs.identity,
        "runs": outcome_digest(study.ledger_path, frozenset(study.runs.needed_keys)),
        "inputs": repr(study.space),
        "measure": f"{measure}: {study.discrepancies[measure]!r}",
        "seed": seed,
        "version": __version__,
        **more,
    }
    return sha256(json.dumps(facts).encode()).hexdigest()


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
    model, identity, counts = plain, study.runs.identity, Counter[str]()
    with suppress(InvalidInput):
        model = with_sensitivities(plain)
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


def problem_of(record: RunRecord) -> str:
    """Return why a run failed, in a line."""
    said = (record.message or "").partition("\n")[0]
    return f"its run failed: {record.failure_kind or record.state}{f': {said}' if said else ''}"
