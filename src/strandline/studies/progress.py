"""How far a study is, read from its ledger while it may be running."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import median

from strandline.models.protocol import fingerprint
from strandline.runs import Ledger, RunRecord
from strandline.studies.run import design_keys
from strandline.studies.study import Study

__all__ = ["StudyProgress", "progress_of"]


@dataclass(frozen=True)
class StudyProgress:
    """Counts of the design's runs by how they ended, and examples of failures."""

    name: str
    planned: int
    ok: int = 0
    failed: int = 0
    open: int = 0
    open_word: str = "running or lost"
    by_kind: Mapping[str, int] = field(default_factory=dict)
    examples: Mapping[str, str] = field(default_factory=dict)
    median_seconds: float | None = None
    slowest: float | None = None
    has_results: bool = False

    @property
    def to_do(self) -> int:
        """Runs neither done nor under way."""
        return max(self.planned - self.ok - self.failed - self.open, 0)


def progress_of(study: Study) -> StudyProgress:
    """Return how far `study` is; reads the ledger without the lock of its driver."""
    keys = design_keys(study)
    has_results = (study.folder / "summary.json").is_file()
    if not study.ledger_path.is_file():
        return StudyProgress(study.name, len(keys), has_results=has_results)
    with Ledger.open(study.ledger_path, model=fingerprint(study.model), read_only=True) as ledger:
        records = [record for record in ledger.latest(keys).values() if record.final]
        open_runs = ledger.counts().open
    failed = [record for record in records if not record.ok]
    seconds = [record.seconds for record in records]
    return StudyProgress(
        study.name,
        len(keys),
        ok=len(records) - len(failed),
        failed=len(failed),
        open=open_runs,
        by_kind=Counter(_kind(record) for record in failed),
        examples={_kind(record): _example(record) for record in reversed(failed)},
        median_seconds=median(seconds) if seconds else None,
        slowest=max(seconds, default=None),
        has_results=has_results,
    )


def _kind(record: RunRecord) -> str:
    return record.failure_kind or record.state


def _example(record: RunRecord) -> str:
    inputs = ", ".join(f"{name} = {value:.6g}" for name, value in record.inputs.items())
    return f"{inputs}: {(record.message or '').splitlines()[0] if record.message else 'no message'}"
