"""The posterior that the page shows: of the runs so far, or the study's own result, and how it took shape."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from strandline.calibration.alternative import Present, present
from strandline.calibration.so_far import posterior_so_far
from strandline.errors import InvalidInput, InvalidStudy, NumericsError, TooFewRuns
from strandline.numerics.one_thread import one_thread
from strandline.numerics.precision import use_double
from strandline.posterior import systematic_indices
from strandline.questions.knowledge import field_knowledge
from strandline.studies.check import finished_posterior
from strandline.studies.folder import SUMMARY
from strandline.studies.progress import results_of
from strandline.studies.study import Study

__all__ = ["DRAWS", "SEED", "PosteriorFeed", "Shown", "changed_at"]

DRAWS = 2000
"""Draws of the posterior that the page gets."""
GROWTH, FEWEST_NEW = 0.1, 4
"""New runs, as a share of those used and at least, after which the posterior is computed again."""
SEED = 1


@dataclass(frozen=True)
class Shown:
    """A posterior with all that belongs to it, replaced as a whole: another thread reads it meanwhile.

    Args:
        now: The newest posterior; None if there is none.
        few: Some of its draws, few enough to be weighted again while a slider moves.
        source: Where it comes from: ``none``, ``so far`` or ``stored``.
        why_none: Why there is none.
        history: Runs, means and standard deviations of each posterior, the newest last.
    """

    now: Present | None = None
    few: Present | None = None
    source: str = "none"
    why_none: str = "too few forward runs have ended yet"
    history: tuple[dict[str, Any], ...] = ()


@dataclass
class PosteriorFeed:
    """The newest posterior of a study, and the means and standard deviations of all before it.

    Args:
        study: The study.
        shown: What the page shows.
    """

    study: Study
    shown: Shown = Shown()
    _tried: int = 0
    _stored: int = 0

    def due(self, succeeded: int) -> bool:
        """Return whether there is a newer posterior than this one: stored, or worth computing.

        Args:
            succeeded: Number of runs that have succeeded.
        """
        if results_of(self.study) == "current":
            return self._stored != changed_at(self.study.folder / SUMMARY)
        return succeeded - self._tried >= max(FEWEST_NEW, math.ceil(GROWTH * self._tried))

    def refresh(self, succeeded: int) -> None:
        """Read the stored posterior if the study is finished, else compute the one of the runs so far.

        Args:
            succeeded: Number of runs that have succeeded.
        """
        use_double()
        self._tried, self._stored = succeeded, changed_at(self.study.folder / SUMMARY)
        with one_thread():
            try:
                found, source = self._posterior()
            except (InvalidStudy, InvalidInput, TooFewRuns, NumericsError) as error:
                self.shown = replace(self.shown, why_none=f"no posterior yet: {error}")
                return
        before, names = self.shown, self.study.space.names
        told = {
            "runs": succeeded if found.knowledge is None else found.knowledge.surrogate.runs,
            "source": source,
            "mean": dict(zip(names, found.mean.tolist(), strict=True)),
            "sd": dict(zip(names, found.sd.tolist(), strict=True)),
            "moved": None if before.now is None else _moved(before.now, found),
        }
        self.shown = Shown(found, _thinned(found), source, before.why_none, (*before.history, told))

    def _posterior(self) -> tuple[Present, str]:
        study, measure = self.study, next(iter(self.study.discrepancies))
        if results_of(study) == "current":
            stored = finished_posterior(study, purpose="show")
            try:
                knowledge, why_not = field_knowledge(study, measure, purpose="the page"), ""
            except (InvalidStudy, TooFewRuns) as error:
                knowledge, why_not = None, f"there is no surrogate of the interface ({error.value})"
            return present(stored, knowledge, why_not=why_not), "stored"
        knowledge = field_knowledge(study, measure, purpose="the page")
        return posterior_so_far(knowledge, study.space, seed=SEED), "so far"


def _thinned(now: Present) -> Present:
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


def _moved(before: Present, after: Present) -> float:
    """Return the largest shift of a mean, in earlier standard deviations."""
    return float(np.abs((after.mean - before.mean) / before.sd).max())
