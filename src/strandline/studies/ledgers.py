"""What the ledgers of a study hold of the runs that it needs."""

from collections.abc import Iterable

from strandline.design import sobol
from strandline.errors import InvalidStudy
from strandline.models.protocol import fingerprint
from strandline.runs import Ledger, RunRecord, run_key
from strandline.studies.study import Study

__all__ = ["check_ledgers", "design_keys", "known_runs", "needed_keys", "require_finished", "settled", "take_over"]

ATTEMPTS = 3
"""Starts after which a campaign gives up a run whose process vanishes each time."""


def design_keys(study: Study) -> list[str]:
    """Return the ledger keys of the study's design, in its order."""
    identity = fingerprint(study.model)
    design = study.space.to_physical(sobol(study.settings.runs, study.space.dim, scramble=study.settings.scramble))
    return [run_key(identity, {**study.fixed, **study.space.as_mapping(x)}) for x in design]


def needed_keys(study: Study) -> list[str]:
    """Return the keys of the design and, in front, of the run that makes a synthetic observation."""
    synthetic = [] if study.truth is None else [run_key(fingerprint(study.model), study.truth)]
    return list(dict.fromkeys([*synthetic, *design_keys(study)]))


def settled(ledger: Ledger, keys: Iterable[str], *, sensitivities: bool = False) -> list[RunRecord]:
    """Return the records of the runs `keys` that will not be tried again, given whether `sensitivities` are wanted."""
    return [
        record
        for record in ledger.latest(keys).values()
        if record.settles(sensitivities=sensitivities) or ledger.open_attempts(record.key) >= ATTEMPTS
    ]


def known_runs(study: Study) -> int:
    """Return how many runs of the design are in the study's ledger, or in one that it may take runs from."""
    keys = design_keys(study)
    known: set[str] = set()
    for path in (study.ledger_path, *study.reuse):
        if path.is_file():
            with Ledger.open(path, model=fingerprint(study.model), read_only=True) as ledger:
                known.update(record.key for record in settled(ledger, keys, sensitivities=study.sensitivities))
    return len(known)


def check_ledgers(study: Study) -> None:
    """Refuse a ledger of another model, a damaged one, or one that a newer strandline made; own and reused.

    Raises:
        LedgerError: with the ledger that cannot be used.
    """
    for path in (study.ledger_path, *study.reuse):
        if path.is_file():
            with Ledger.open(path, model=fingerprint(study.model), read_only=True):
                pass


def require_finished(study: Study) -> None:
    """Refuse a study that needs runs which are not made yet.

    Raises:
        InvalidStudy: with the number of runs done.
    """
    keys, done = needed_keys(study), 0
    if study.ledger_path.is_file():
        with Ledger.open(study.ledger_path, model=fingerprint(study.model), read_only=True) as ledger:
            done = len(settled(ledger, keys, sensitivities=study.sensitivities))
    if done < len(keys):
        raise InvalidStudy(
            "the study is not finished",
            value=f"{done} of {len(keys)} forward runs done{', the synthetic one included' if study.truth else ''}",
            expected="all runs done, for results to be made of them",
            remedy=f"Run it first: strandline run {study.folder}",
        )


def take_over(study: Study, ledger: Ledger) -> None:
    """Copy runs of other studies that this one needs and has not made itself."""
    keys = needed_keys(study)
    for other in study.reuse:
        known = ledger.latest(keys)
        missing = [key for key in keys if key not in known or _lacks_sensitivities(known[key], study)]
        if missing and other.is_file():
            ledger.copy_from(other, missing, sensitivities=study.sensitivities)


def _lacks_sensitivities(record: RunRecord, study: Study) -> bool:
    return record.final and not record.settles(sensitivities=study.sensitivities)
