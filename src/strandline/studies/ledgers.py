"""What the ledgers of a study hold of the runs that it needs."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.design import sobol
from strandline.errors import InvalidStudy
from strandline.models.protocol import fingerprint
from strandline.runs import Ledger, RunRecord, run_key
from strandline.runs.plans import Plan
from strandline.runs.tables import ATTEMPTS, EXCLUDED
from strandline.studies.build import failure_words
from strandline.studies.folder import REFINEMENT, write_json
from strandline.studies.study import Study

__all__ = [
    "begin_active",
    "check_ledgers",
    "design_inputs",
    "design_keys",
    "end_active",
    "failure_kinds",
    "given_inputs",
    "known_runs",
    "needed_keys",
    "note_batch",
    "open_runs",
    "plan_of",
    "planned_runs",
    "refinement_keys",
    "require_finished",
    "settled",
    "take_over",
    "tell_backup",
    "unheard_kinds",
    "write_round",
]


def design_inputs(study: Study) -> list[dict[str, float]]:
    """Return the inputs of the study's first design, in its order: the Sobol design, or runs given to begin with."""
    given = given_inputs(study)
    if given is not None:
        return given
    design = study.space.to_physical(sobol(study.settings.runs, study.space.dim, scramble=study.settings.scramble))
    return [{**study.fixed, **study.space.as_mapping(x)} for x in design]


def design_keys(study: Study) -> list[str]:
    """Return the ledger keys of the study's Sobol design, in its order."""
    identity = fingerprint(study.model)
    return [run_key(identity, inputs) for inputs in design_inputs(study)]


def refinement_keys(study: Study) -> list[list[str]]:
    """Return the keys of each round of refinement, or batch, that study.yaml as it is has come to so far.

    Where the rounds make their runs follows from the runs before them: refinement.json says it of those that began.
    """
    rounds = _noted(study).get("rounds")
    return [list(keys) for keys in rounds] if isinstance(rounds, list) else []


def given_inputs(study: Study) -> list[dict[str, float]] | None:
    """Return the inputs of the runs that an active design was given to begin with; None where there are none."""
    given = _noted(study).get("given")
    return [dict(entry) for entry in given] if isinstance(given, list) and given else None


def write_round(study: Study, number: int, inputs: Sequence[Mapping[str, float]]) -> None:
    """Note the runs of round `number`, the first being 0, in refinement.json; rounds behind it are forgotten."""
    identity = fingerprint(study.model)
    rounds = [*refinement_keys(study)[:number], [run_key(identity, entry) for entry in inputs]]
    _note(study, rounds=rounds, finished=False)


def begin_active(study: Study, ledger: Ledger) -> Float[np.ndarray, "run dim"] | None:
    """Return the inputs of the runs that an active design begins with; None for its Sobol design.

    They are those that the ledgers, its own and the reused ones, hold of another study.yaml, at least as many as the
    design would begin with. What is found the first time is noted, so that the study goes on with the same.
    """
    if study.settings.active is None:
        return None
    if "given" not in _noted(study):
        found = _runs_at_hand(study, ledger)
        _note(study, given=found if len(found) >= study.settings.runs else [], rounds=[], finished=False)
    given = given_inputs(study)
    return None if given is None else np.array([[entry[name] for name in study.space.names] for entry in given])


def note_batch(study: Study, line: str) -> None:
    """Note what the last batch of an active design came to, for `strandline status`."""
    _note(study, last_batch=line)


def end_active(study: Study) -> None:
    """Note that an active design has ended, so that its runs are all that the study needs."""
    if study.settings.active is not None:
        _note(study, finished=True)


def _runs_at_hand(study: Study, ledger: Ledger) -> list[dict[str, float]]:
    """Return the inputs of the settled runs, in the box and with the known inputs of `study`, in a fixed order."""
    truth = None if study.truth is None else run_key(ledger.model, study.truth)
    found: dict[str, dict[str, float]] = {}
    for path in (None, *(path for path in study.reuse if path.is_file())):
        with nullcontext(ledger) if path is None else Ledger.open(path, model=ledger.model, read_only=True) as source:
            for record in source:
                if record.final and record.state != EXCLUDED and record.key != truth and _belongs(record, study):
                    found[record.key] = dict(record.inputs)
    return [found[key] for key in sorted(found)]


def _belongs(record: RunRecord, study: Study) -> bool:
    if set(record.inputs) != {*study.fixed, *study.space.names}:
        return False
    known = all(record.inputs[name] == value for name, value in study.fixed.items())
    box = zip(study.space.names, study.space.low, study.space.high, strict=True)
    useful = not study.sensitivities or not record.ok or bool(record.sensitivities)
    return known and useful and all(low <= record.inputs[name] <= high for name, low, high in box)


def _noted(study: Study) -> dict[str, Any]:
    """Return what refinement.json says of study.yaml as it is; nothing where it belongs to another."""
    try:
        found = json.loads((study.folder / REFINEMENT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) and found.get("study_sha256") == study.text_digest else {}


def _note(study: Study, **content: Any) -> None:
    write_json(study.folder / REFINEMENT, {"study_sha256": study.text_digest} | _noted(study) | content)


def planned_runs(study: Study) -> int:
    """Return the number of runs of the design and of all rounds of refinement.

    Of an active design, all that it may make, until it has ended: then those that it made.
    """
    begun = refinement_keys(study)
    first, made = len(design_inputs(study)), sum(len(keys) for keys in begun)
    if study.settings.active is not None:
        given = given_inputs(study) is not None
        most = study.settings.active.runs + (first if given else 0)
        return first + made if _noted(study).get("finished") else max(most, first + made)
    left = study.settings.refine.rounds - len(begun)
    return first + made + left * study.settings.refine.runs


def plan_of(study: Study) -> Plan:
    """Return what `study` asks of its ledger, as far as it is known yet."""
    return Plan(
        study_sha256=study.text_digest,
        name=study.name,
        model=fingerprint(study.model),
        inputs=tuple(study.space.names),
        sensitivities=study.sensitivities,
        planned=planned_runs(study),
        parts=(tuple(design_keys(study)), *(tuple(keys) for keys in refinement_keys(study))),
    )


def needed_keys(study: Study) -> list[str]:
    """Return the keys of all runs needed, as far as they are known yet: the synthetic one, the design, the rounds."""
    synthetic = [] if study.truth is None else [run_key(fingerprint(study.model), study.truth)]
    rounds = [key for keys in refinement_keys(study) for key in keys]
    return list(dict.fromkeys([*synthetic, *design_keys(study), *rounds]))


def settled(ledger: Ledger, keys: Iterable[str], *, sensitivities: bool = False) -> list[RunRecord]:
    """Return the records of the runs `keys` that will not be tried again, given whether `sensitivities` are wanted."""
    return [
        record
        for record in ledger.latest(keys).values()
        if record.settles(sensitivities=sensitivities) or ledger.open_attempts(record.key) >= ATTEMPTS
    ]


def known_runs(study: Study) -> int:
    """Return how many planned runs are in the study's ledger, or in one that it may take runs from."""
    keys = [*design_keys(study), *(key for some in refinement_keys(study) for key in some)]
    known: set[str] = set()
    for path in (study.ledger_path, *study.reuse):
        if path.is_file():
            with Ledger.open(path, model=fingerprint(study.model), read_only=True) as ledger:
                known.update(record.key for record in settled(ledger, keys, sensitivities=study.sensitivities))
    return len(known)


def failure_kinds(study: Study) -> set[str]:
    """Return the kinds and states with which runs of the study ended that are not ok."""
    if not study.ledger_path.is_file():
        return set()
    with Ledger.open(study.ledger_path, model=fingerprint(study.model), read_only=True) as ledger:
        latest = ledger.latest(needed_keys(study)).values()
    failed = [record for record in latest if not record.ok and record.state != EXCLUDED]
    return {word for record in failed for word in (record.failure_kind, record.state) if word}


def unheard_kinds(study: Study) -> list[str]:
    """Return the words under ``failures.kinds`` with which no run has ended, where the model does not name its own."""
    named = study.settings.failures.actions
    known = {*failure_words(study.model), *(failure_kinds(study) if named else ())}
    return [kind for kind in named if kind not in known]


def open_runs(study: Study) -> int:
    """Return how many runs of the study's ledger were started and have not ended."""
    if not study.ledger_path.is_file():
        return 0
    with Ledger.open(study.ledger_path, model=None, read_only=True) as ledger:
        return ledger.counts().open


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
    needed = len(keys) + planned_runs(study) - sum(len(some) for some in (design_keys(study), *refinement_keys(study)))
    if study.ledger_path.is_file():
        with Ledger.open(study.ledger_path, model=fingerprint(study.model), read_only=True) as ledger:
            done = len(settled(ledger, keys, sensitivities=study.sensitivities))
    if done < needed:
        raise InvalidStudy(
            "the study is not finished",
            value=f"{done} of {needed} forward runs done{', the synthetic one included' if study.truth else ''}",
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


def tell_backup(ledger: Ledger, note: Callable[[str], None]) -> None:
    """Say where the copy of a ledger lies that was upgraded when it was opened."""
    if ledger.backup is not None:
        note(f"{ledger.path.name} was of an earlier version; a copy of it is {ledger.backup}")


def _lacks_sensitivities(record: RunRecord, study: Study) -> bool:
    return record.final and not record.settles(sensitivities=study.sensitivities)
