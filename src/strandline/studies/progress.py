"""How far a study is, read from its ledger while it may be running."""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import median
from typing import Literal

from strandline.models.protocol import fingerprint
from strandline.runs import Ledger, RunRecord
from strandline.studies.folder import SUMMARY
from strandline.studies.ledgers import design_keys, planned_runs, refinement_keys, settled
from strandline.studies.study import Study

__all__ = ["StudyProgress", "progress_of", "results_of"]

Results = Literal["none", "current", "outdated"]


@dataclass(frozen=True)
class StudyProgress:
    """Counts of the planned runs by how they ended, and examples of failures.

    Args:
        name: of the study.
        planned: runs of the design and of all rounds of refinement.
        ok: those that gave an interface.
        failed: those that did not and will not be tried again.
        open: runs started and not ended: under way if a driver is at work, lost otherwise.
        by_kind: number of failures by kind.
        examples: for each kind, inputs and message of its first failure.
        median_seconds: of the finished runs.
        slowest: seconds of the slowest one.
        results: whether summary.json is there, and of study.yaml as it is now.
    """

    name: str
    planned: int
    ok: int = 0
    failed: int = 0
    open: int = 0
    by_kind: Mapping[str, int] = field(default_factory=dict)
    examples: Mapping[str, str] = field(default_factory=dict)
    median_seconds: float | None = None
    slowest: float | None = None
    results: Results = "none"

    @property
    def to_do(self) -> int:
        """Runs neither done nor under way."""
        return max(self.planned - self.ok - self.failed - self.open, 0)


def progress_of(study: Study) -> StudyProgress:
    """Return how far `study` is; reads the ledger without the lock of its driver."""
    keys = [*design_keys(study), *(key for some in refinement_keys(study) for key in some)]
    results, planned = results_of(study), planned_runs(study)
    if not study.ledger_path.is_file():
        return StudyProgress(study.name, planned, results=results)
    with Ledger.open(study.ledger_path, model=fingerprint(study.model), read_only=True) as ledger:
        records = settled(ledger, keys, sensitivities=study.sensitivities)
        open_runs = ledger.counts().open
    failed = [record for record in records if not record.ok]
    seconds = [record.seconds for record in records]
    return StudyProgress(
        study.name,
        planned,
        ok=len(records) - len(failed),
        failed=len(failed),
        open=open_runs,
        by_kind=dict(Counter(_kind(record) for record in failed).most_common()),
        examples={_kind(record): _example(record, study) for record in reversed(failed)},
        median_seconds=median(seconds) if seconds else None,
        slowest=max(seconds, default=None),
        results=results,
    )


def results_of(study: Study) -> Results:
    """Tell whether the study has results, and whether they are of study.yaml as it is."""
    try:
        summary = json.loads((study.folder / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return "none"
    return "current" if summary.get("study_sha256") == study.text_digest else "outdated"


def _kind(record: RunRecord) -> str:
    return record.failure_kind or record.state


def _example(record: RunRecord, study: Study) -> str:
    inputs = ", ".join(f"{name} = {record.inputs[name]:.6g}" for name in study.space.names)
    return f"{inputs}: {(record.message or '').splitlines()[0] if record.message else 'no message'}"
