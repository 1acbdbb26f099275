"""The interface learnt from the runs of a finished study, which every question looks through."""

import json
from collections.abc import Sequence
from hashlib import sha256
from typing import Any

import numpy as np

from strandline.calibration import Baseline, baseline, known_field
from strandline.design import Knowledge, RunFilter, as_by_model
from strandline.foundations import InvalidInput, InvalidStudy, NoCommonPoints, TooFewRuns, __version__
from strandline.posterior import Posterior
from strandline.runs import Ledger, RunRecord, outcome_digest
from strandline.studies import Study, cheaper_dropped, observations_of, settled

OTHER = "Choose another one."


def require(
    right: bool, what: str, value: object, expected: str, remedy: str = OTHER, error: type[InvalidInput] = InvalidInput
) -> None:
    """Refuse what is not right."""
    if not right:
        raise error(what, value=value, expected=expected, remedy=remedy)


def chosen_measure(study: Study, name: str | None, of: str) -> str:
    """Return the name of a measure of the study, by default its first; `of` is what it is for."""
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
    if not observed:
        raise InvalidStudy(
            "the synthetic observation is not in the ledger",
            value="no run that ended ok",
            expected="the run at the inputs of observation.synthetic",
            remedy=f"Run the study first: strandline run {study.folder}",
        )
    judge = RunFilter(study.observations(observed), {measure: study.discrepancies[measure]}, study.settings.failures)
    records = (*runs_to_learn_from(study), *more)
    points = np.array([[record.inputs[name] for name in study.space.names] for record in records], float)
    try:
        return known_field(points, records, judge, study.space)[0]
    except NoCommonPoints as error:
        raise InvalidStudy(
            f"{purpose} needs a surrogate of the interface",
            value=str(error.value),
            expected="runs whose interfaces can be brought to common points",
            remedy="Let the simulator return interfaces of the same kind, best with the same nodes in all runs.",
        ) from error


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
    """Return all runs if the study learns the interface, else at most as many as its surrogate can use quickly.

    The first ones of a design are spread over the box, and so are the last ones, unless these are where the posterior
    lies.
    """
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
