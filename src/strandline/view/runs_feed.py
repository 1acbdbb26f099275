"""The runs of a study as rows for the page, kept up to date from its ledger; no interface is read."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from strandline.runs.ledger_schema import EXCLUDED
from strandline.runs.overview import OPEN, Attempt, Overview

__all__ = ["RunsFeed", "rounded"]

DIGITS = 6
"""Significant digits of the numbers that the page gets."""
LARGEST_STEP = 300
"""Decimals that a number may have at most; a power of ten must not overflow."""


@dataclass
class _Row:
    """A run as the page shows it, and when it changed last."""

    key: str
    attempt: Attempt
    excluded: str | None
    version: int


@dataclass
class RunsFeed:
    """All runs in a ledger, in the order in which they were first started.

    Args:
        path: The ledger; it need not exist yet.
        inputs: Names of the inputs that the page shows.
    """

    path: Path
    inputs: Sequence[str]
    version: int = 0
    _rows: dict[str, _Row] = field(default_factory=dict)
    _open: dict[int, str] = field(default_factory=dict)
    _last: int = 0

    def update(self) -> bool:
        """Read what is new in the ledger; return whether there is anything.

        Raises:
            LedgerError: The ledger is damaged or of a newer version.
        """
        if not self.path.is_file():
            return False
        with Overview(self.path) as ledger:
            found, exclusions = ledger.changes(self._last, self._open), ledger.exclusions()
        version = self.version + 1
        for key, attempt in found:
            self._note(key, attempt, version)
        for key, row in self._rows.items():
            why = exclusions[key].why if key in exclusions else None
            if row.excluded != why:
                row.excluded, row.version = why, version
        changed = any(row.version == version for row in self._rows.values())
        self.version = version if changed else self.version
        return changed

    def _note(self, key: str, attempt: Attempt, version: int) -> None:
        self._last = max(self._last, attempt.number)
        ended = attempt.state != OPEN
        if ended:
            self._open.pop(attempt.number, None)
        else:
            self._open[attempt.number] = key
        row = self._rows.get(key)
        if row is None:
            self._rows[key] = _Row(key, attempt, None, version)
        elif attempt.number > row.attempt.number or (attempt.number == row.attempt.number and attempt != row.attempt):
            row.attempt, row.version = attempt, version

    def since(self, version: int) -> dict[str, Any]:
        """Return the rows that changed after a version, as columns; `row` is the place of each among all runs."""
        rows = [(place, row) for place, row in enumerate(self._rows.values()) if row.version > version]
        inputs = json.loads(f"[{','.join(row.attempt.inputs for _, row in rows)}]")
        return {
            "version": self.version,
            "total": len(self._rows),
            "row": [place for place, _ in rows],
            "number": [row.attempt.number for _, row in rows],
            "state": [EXCLUDED if row.excluded is not None else row.attempt.state for _, row in rows],
            "kind": [row.attempt.kind for _, row in rows],
            "seconds": rounded([row.attempt.seconds for _, row in rows]),
            "ended": rounded([row.attempt.finished_at for _, row in rows], 13),
            "inputs": {name: rounded([one.get(name) for one in inputs]) for name in self.inputs},
        }

    def key_at(self, place: int) -> tuple[str, Attempt] | None:
        """Return key and last start of the run in this place; None if there is none."""
        rows = list(self._rows.values())
        return (rows[place].key, rows[place].attempt) if 0 <= place < len(rows) else None

    @property
    def succeeded(self) -> int:
        """Number of runs that ended ok and are not excluded."""
        return sum(row.attempt.state == "ok" and row.excluded is None for row in self._rows.values())


def rounded(values: Sequence[float | None], digits: int = DIGITS) -> list[float | None]:
    """Return numbers with so many significant digits; None for those that are not finite."""
    given = np.array(values, dtype=float)
    finite = np.isfinite(given)
    size = np.floor(np.log10(np.abs(given), where=finite & (given != 0.0), out=np.zeros_like(given)))
    step = np.minimum(digits - 1 - size, LARGEST_STEP)
    up, down = 10.0 ** np.maximum(step, 0.0), 10.0 ** np.maximum(-step, 0.0)
    short = np.where(step >= 0, np.round(given * up) / up, np.round(given / down) * down).tolist()
    return short if finite.all() else [one if good else None for one, good in zip(short, finite, strict=True)]
