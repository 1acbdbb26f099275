"""The runs of a study and its posterior as the page gets them, kept up to date from its ledger and its results."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from strandline.calibration import Baseline, interim_posterior
from strandline.foundations import InvalidInput, InvalidStudy, NumericsError, TooFewRuns, one_thread, use_double
from strandline.posterior import systematic_indices
from strandline.questions import baseline_of, field_knowledge
from strandline.report import DRAWS, by_name, rounded
from strandline.runs import EXCLUDED, OPEN, Attempt, Overview
from strandline.studies import SUMMARY, Study, finished_posterior, results_of

GROWTH, FEWEST_NEW = 0.1, 4
"""New runs, as a share of those used and at least, after which the posterior is computed again."""
SEED = 1


@dataclass
class _Row:
    """A run as the page shows it, and when it changed last."""

    key: str
    attempt: Attempt
    excluded: str | None
    version: int


@dataclass
class RunsFeed:
    """All runs in a ledger, which need not exist yet, in the order of their first starts; `inputs` are shown."""

    path: Path
    inputs: Sequence[str]
    version: int = 0
    _rows: dict[str, _Row] = field(default_factory=dict)
    _open: dict[int, str] = field(default_factory=dict)
    _last: int = 0

    def update(self) -> bool:
        """Read what is new in the ledger; return whether there is anything."""
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


@dataclass(frozen=True)
class CurrentPosterior:
    """A posterior with all that belongs to it, replaced as a whole: another thread reads it meanwhile.

    `now` is the newest one, None if there is none; it has come from ``none``, the runs ``so far`` or is ``stored``.
    `few` has so few of its draws that they can be weighted again while a slider moves. `history` has runs, means and
    standard deviations of each posterior, the newest last.
    """

    now: Baseline | None = None
    few: Baseline | None = None
    source: str = "none"
    why_none: str = "too few forward runs have ended yet"
    history: tuple[dict[str, Any], ...] = ()


@dataclass
class PosteriorFeed:
    """The newest posterior of a study, and the means and standard deviations of all before it."""

    study: Study
    shown: CurrentPosterior = CurrentPosterior()
    _tried: int = 0
    _stored: int = 0

    def due(self, succeeded: int) -> bool:
        """Return whether there is a newer posterior than this one: stored, or worth computing with so many runs."""
        if results_of(self.study) == "current":
            return self._stored != changed_at(self.study.folder / SUMMARY)
        return succeeded - self._tried >= max(FEWEST_NEW, math.ceil(GROWTH * self._tried))

    def refresh(self, succeeded: int) -> None:
        """Read the stored posterior if the study is finished, else compute that of so many good runs."""
        use_double()
        self._tried, self._stored = succeeded, changed_at(self.study.folder / SUMMARY)
        with one_thread():
            try:
                found, source = self._posterior()
            except (InvalidStudy, InvalidInput, TooFewRuns, NumericsError) as error:
                self.shown = replace(self.shown, why_none=f"no posterior yet: {error}")
                return
        before, moved = self.shown, None
        if before.now is not None:  # the largest shift of a mean, in earlier standard deviations
            moved = float(np.abs((found.mean - before.now.mean) / before.now.sd).max())
        step = {
            "runs": succeeded if found.knowledge is None else found.knowledge.surrogate.runs,
            "source": source,
            "mean": by_name(self.study.space, found.mean),
            "sd": by_name(self.study.space, found.sd),
            "moved": moved,
        }
        self.shown = CurrentPosterior(found, _thinned(found), source, before.why_none, (*before.history, step))

    def _posterior(self) -> tuple[Baseline, str]:
        if results_of(self.study) == "current":
            stored = finished_posterior(self.study, purpose="show")
            return baseline_of(self.study, stored, purpose="the page"), "stored"
        knowledge = field_knowledge(self.study, purpose="the page")
        return interim_posterior(knowledge, self.study.space, seed=SEED), "so far"


def _thinned(now: Baseline) -> Baseline:
    """Return a posterior with equally weighted draws, few enough to be weighted again while a slider moves."""
    chosen = systematic_indices(np.exp(now.log_weights), DRAWS, np.random.default_rng(SEED))
    return replace(
        now,
        draws=now.draws[chosen],
        log_weights=np.full(DRAWS, -math.log(DRAWS)),
        log_likelihood=now.log_likelihood[chosen],
        log_prior=now.log_prior[chosen],
    )


def changed_at(path: Path) -> int:
    """Return when a file has changed last, in nanoseconds; 0 if there is none."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0
