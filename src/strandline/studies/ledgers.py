"""What the ledgers of a study hold of the runs that it needs."""

import json
from collections.abc import Iterable, Mapping, Sequence

from strandline.design import sobol
from strandline.errors import InvalidStudy
from strandline.models.protocol import fingerprint
from strandline.runs import Ledger, RunRecord, run_key
from strandline.runs.plans import Plan
from strandline.runs.tables import ATTEMPTS
from strandline.studies.build import failure_words
from strandline.studies.folder import REFINEMENT, write_json
from strandline.studies.study import Study

__all__ = [
    "check_ledgers",
    "design_inputs",
    "design_keys",
    "failure_kinds",
    "known_runs",
    "needed_keys",
    "open_runs",
    "plan_of",
    "planned_runs",
    "refinement_keys",
    "require_finished",
    "settled",
    "take_over",
    "unheard_kinds",
    "write_round",
]


def design_inputs(study: Study) -> list[dict[str, float]]:
    """Return the inputs of the study's Sobol design, in its order."""
    design = study.space.to_physical(sobol(study.settings.runs, study.space.dim, scramble=study.settings.scramble))
    return [{**study.fixed, **study.space.as_mapping(x)} for x in design]


def design_keys(study: Study) -> list[str]:
    """Return the ledger keys of the study's Sobol design, in its order."""
    identity = fingerprint(study.model)
    return [run_key(identity, inputs) for inputs in design_inputs(study)]


def refinement_keys(study: Study) -> list[list[str]]:
    """Return the keys of each round of refinement that study.yaml as it is has come to so far.

    Where the rounds make their runs follows from the runs before them: refinement.json says it of those that began.
    """
    try:
        found = json.loads((study.folder / REFINEMENT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    if not isinstance(found, dict) or found.get("study_sha256") != study.text_digest:
        return []
    rounds = found.get("rounds")
    return [list(keys) for keys in rounds] if isinstance(rounds, list) else []


def write_round(study: Study, number: int, inputs: Sequence[Mapping[str, float]]) -> None:
    """Note the runs of round `number`, the first being 0, in refinement.json; rounds behind it are forgotten."""
    identity = fingerprint(study.model)
    rounds = [*refinement_keys(study)[:number], [run_key(identity, entry) for entry in inputs]]
    write_json(study.folder / REFINEMENT, {"study_sha256": study.text_digest, "rounds": rounds})


def planned_runs(study: Study) -> int:
    """Return the number of runs of the design and of all rounds of refinement."""
    begun = refinement_keys(study)
    left = study.settings.refine.rounds - len(begun)
    return study.settings.runs + sum(len(keys) for keys in begun) + left * study.settings.refine.runs


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
        failed = [record for record in ledger.latest(needed_keys(study)).values() if not record.ok]
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


def _lacks_sensitivities(record: RunRecord, study: Study) -> bool:
    return record.final and not record.settles(sensitivities=study.sensitivities)
