"""What a ledger keeps beside its runs: those that a study asks for, and those excluded by hand.

A study's driver records its plan, to show progress without loading the study. Standard library only.
"""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import takewhile

from strandline.foundations import LedgerError, require

COLUMNS = "study_sha256, part, name, model, inputs, sensitivities, planned, keys"


@dataclass(frozen=True)
class Plan:
    """The runs that a study, known by the SHA-256 of the text of study.yaml, asks for, as far as they are known.

    `model` is the fingerprint of its model, `inputs` are the names of the unknown ones. `planned` is the number of runs
    of the design and of all rounds of refinement, also to come; `parts` are keys of the runs of the design, then of
    each round begun.
    """

    study_sha256: str
    name: str
    model: str
    inputs: tuple[str, ...]
    sensitivities: bool
    planned: int
    parts: tuple[tuple[str, ...], ...]

    @property
    def keys(self) -> list[str]:
        return list(dict.fromkeys(key for part in self.parts for key in part))


def read_plan(connection: sqlite3.Connection, study_sha256: str) -> Plan | None:
    """Return the recorded plan of a study, or None; a row holds one part and replaces that and all later ones."""
    plan = None
    sql = f"SELECT {COLUMNS} FROM plans WHERE study_sha256 = ? ORDER BY plan"
    for digest, part, name, model, inputs, sensitivities, planned, keys in connection.execute(sql, (study_sha256,)):
        parts = (*(plan.parts if plan else ())[:part], tuple(json.loads(keys)))
        plan = Plan(digest, name, model, tuple(json.loads(inputs)), bool(sensitivities), planned, parts)
    return plan


def rows_to_write(plan: Plan, known: Plan | None) -> list[tuple[object, ...]]:
    """Return the rows, values of `COLUMNS`, that turn the `known` plan into `plan`; none if it is part of `known`."""
    first = 0
    if known is not None and replace(known, planned=plan.planned, parts=plan.parts) == plan:
        first = len([*takewhile(lambda pair: pair[0] == pair[1], zip(plan.parts, known.parts, strict=False))])
        if known.parts == plan.parts and known.planned != plan.planned:  # an active design has ended
            first = len(plan.parts) - 1
    facts = (plan.name, plan.model, json.dumps(plan.inputs), int(plan.sensitivities), plan.planned)
    return [(plan.study_sha256, part, *facts, json.dumps(plan.parts[part])) for part in range(first, len(plan.parts))]


@dataclass(frozen=True)
class Exclusion:
    """Why a run is excluded, in words, and since when, seconds since 1970."""

    why: str
    decided_at: float


def read_exclusions(connection: sqlite3.Connection) -> Mapping[str, Exclusion]:
    """Return the runs that are excluded now, by key."""
    found: dict[str, Exclusion] = {}
    sql = "SELECT key, excluded, why, decided_at FROM exclusions ORDER BY exclusion"
    for key, excluded, why, decided_at in connection.execute(sql):
        if excluded:
            found[key] = Exclusion(why, decided_at)
        else:
            found.pop(key, None)
    return found


def require_reason(why: str) -> str:
    """Return the reason on one line; raise LedgerError if it is empty."""
    what, remedy = "reason for excluding a run", 'Say why: --why "the mesh folded over".'
    require(why.strip(), what, "an empty text", "a few words", remedy, LedgerError)
    return " ".join(why.split())


def write_exclusion(
    connection: sqlite3.Connection, session: int, key: str, *, excluded: bool, why: str, at: float
) -> None:
    """Add a row that excludes a run from now on, or not; LedgerError if it has not ended, or nothing would change."""
    ended = "SELECT count(*) FROM starts JOIN outcomes USING (attempt) WHERE key = ?"
    known = read_exclusions(connection)
    if not connection.execute(ended, (key,)).fetchone()[0]:
        raise _refused(key, "no outcome yet", "a run that has ended")
    if excluded == (key in known):
        raise _refused(key, "excluded already" if excluded else "not excluded", "a run in the opposite state")
    sql = "INSERT INTO exclusions (session, key, excluded, why, decided_at) VALUES (?, ?, ?, ?, ?)"
    connection.execute(sql, (session, key, int(excluded), why, at))


def _refused(key: str, found: str, expected: str) -> LedgerError:
    remedy = "`strandline runs STUDY` lists the runs with their states."
    return LedgerError(f"run {key[:12]}", value=found, expected=expected, remedy=remedy)
