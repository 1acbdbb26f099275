"""How far a study has got, read from its ledger while it may be running.

If a driver has noted the study's plan in the ledger, no model is loaded and nothing numerical is imported.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Literal

from strandline.foundations import read_json
from strandline.runs import EXCLUDED, INTERRUPTED, OPEN, Attempt, Driver, Overview, Plan, Run
from strandline.studies.keys.folder import LEDGER, REFINEMENT, STUDY, SUMMARY, digest_of

if TYPE_CHECKING:
    from strandline.studies.load.study import Study


Results = Literal["none", "current", "outdated"]
RATE_RUNS = 50
"""Number of runs, the last to end, that give the pace."""
LOG_LINES = 2


@dataclass(frozen=True)
class RunReported:
    """A run to show: key, unknown inputs, seconds, first line of its message, last lines of its log."""

    key: str
    inputs: Mapping[str, float]
    seconds: float
    message: str = ""
    log: tuple[str, ...] = ()


@dataclass(frozen=True)
class Failures:
    """The failures of one kind: their number, and the first one started."""

    count: int
    example: RunReported


@dataclass(frozen=True)
class StudyProgress:
    """Counts of the planned runs by outcome; each run counts once, as ok, failed, open or to do.

    At work on `open` runs is, or may be, a driver; that of `lost` runs is gone, so they count as to do. Other studies
    have made `reused` runs, which the first start takes over. If jobs of a SLURM array are `detached`, they go on
    without a driver, and may be among the open ones. `failures` come by kind, the commonest first. `rate` is in runs
    per minute of the last driver that finished any; the estimate of `seconds_left` needs one at work. An `active`
    design may stop before `planned` runs; `last_batch` is the outcome of its last batch in a line.
    """

    name: str
    planned: int
    ok: int = 0
    failed: int = 0
    open: int = 0
    lost: int = 0
    reused: int = 0
    detached: bool = False
    failures: Mapping[str, Failures] = field(default_factory=dict)
    rate: float | None = None
    seconds_left: float | None = None
    median_seconds: float | None = None
    slowest: RunReported | None = None
    driver: Driver | None = None
    active: bool = False
    last_batch: str = ""
    results: Results = "none"

    @property
    def done(self) -> int:
        return self.ok + self.failed

    @property
    def to_do(self) -> int:
        """Runs neither done nor under way."""
        return max(self.planned - self.done - self.open - self.reused, 0)

    def as_dict(self) -> dict[str, Any]:
        """Return everything that the status shows, in types that JSON has."""
        content = asdict(self) | {"done": self.done, "to_do": self.to_do}
        content["runs_per_minute"] = content.pop("rate")
        if self.driver is not None:
            driver = self.driver
            stated = {"pid": driver.pid, "host": driver.host, "since": driver.opened_at, "at_work": driver.at_work}
            content["driver"] = stated
        return content


def progress_in(folder: Path) -> StudyProgress:
    """Return the progress of the study in `folder`: from the plan in its ledger if there is one, else by loading it.

    The plan does not show that a model has changed while study.yaml stayed the same.

    Raises:
        InvalidStudy: There is no plan, and the study cannot be loaded.
        LedgerError: The ledger cannot be used.
    """
    plan = recorded_plan(folder)
    if plan is not None:
        return _progress(folder, plan)
    from strandline.studies.load.load import load_study

    return progress_of(load_study(folder))


def progress_of(study: "Study") -> StudyProgress:
    """Return the progress of `study`; reads the ledger without the lock of its driver."""
    state = _progress(study.folder, study.runs.plan)
    return replace(state, reused=max(study.runs.known - state.done - state.open, 0)) if study.reuse else state


def progress_as_planned(study: "Study") -> StudyProgress:
    """Return the progress of `study` as it was loaded, by the plan that its driver has noted, if there is one."""
    plan = _plan(study.folder, study.text_digest)
    return progress_of(study) if plan is None else _progress(study.folder, plan)


def recorded_plan(folder: Path) -> Plan | None:
    """Return the plan that a driver has noted for the present study.yaml; None if there is no plan or no study.yaml."""
    try:
        text = (folder / STUDY).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    return _plan(folder, digest_of(text))


def _plan(folder: Path, study_sha256: str) -> Plan | None:
    if not (folder / LEDGER).is_file():
        return None
    with Overview(folder / LEDGER) as ledger:
        return ledger.plan(study_sha256)


def results_of(study: "Study") -> Results:
    """Return whether the study has results, and whether they belong to the present study.yaml."""
    return _results(study.folder, study.text_digest)


def _progress(folder: Path, plan: Plan) -> StudyProgress:
    results, path = _results(folder, plan.study_sha256), folder / LEDGER
    if not path.is_file():
        return StudyProgress(plan.name, plan.planned, results=results)
    with Overview(path, model=plan.model) as ledger:
        wanted, driver = frozenset(plan.keys), ledger.driver()
        runs = [run for run in ledger.runs() if run.key in wanted]
        detached = any((folder / "slurm").glob("*/batch.json"))  # each batch has a folder until it is collected
        state = _Counted(plan, driver, runs, detached=detached).told(ledger, results)
    noted = read_json(folder / REFINEMENT)
    noted = noted if noted.get("study_sha256") == plan.study_sha256 else {}
    under_way = "given" in noted and not noted.get("finished")
    return replace(state, active=under_way, last_batch=str(noted.get("last_batch", "")))


class _Counted:
    """The planned runs that were started, sorted by outcome."""

    def __init__(self, plan: Plan, driver: Driver | None, runs: Sequence[Run], *, detached: bool) -> None:
        self.plan, self.driver, self.runs, self.detached = plan, driver, runs, detached
        self.ok: list[Attempt] = []
        self.failed: list[Attempt] = []
        self.open = self.lost = 0
        self.keys = {attempt.number: run.key for run in runs for attempt in run.attempts}
        for run in runs:
            self._count(run)

    def _count(self, run: Run) -> None:
        if run.last.state == OPEN and self._may_be_under_way(run.last):
            self.open += 1
        elif (outcome := run.outcome) is not None and run.settled(sensitivities=self.plan.sensitivities):
            ended = outcome if run.exclusion is None else outcome._replace(state=EXCLUDED, kind=EXCLUDED)
            (self.ok if ended.state == "ok" else self.failed).append(ended)
        elif run.last.state == OPEN:
            self.lost += 1

    def _may_be_under_way(self, start: Attempt) -> bool:
        driver = self.driver
        if self.detached:
            return True
        return driver is not None and driver.at_work is not False and start.session == driver.session

    def told(self, ledger: Overview, results: Results) -> StudyProgress:
        """Return the counts, with examples from the ledger."""
        ended = [*self.ok, *self.failed]
        slowest = max(ended, key=_seconds, default=None)
        rate, left = self._pace()
        return StudyProgress(
            self.plan.name,
            self.plan.planned,
            ok=len(self.ok),
            failed=len(self.failed),
            open=self.open,
            lost=self.lost,
            failures=self._failures(ledger),
            rate=rate,
            seconds_left=left,
            median_seconds=median(map(_seconds, ended)) if ended else None,
            slowest=None if slowest is None else self._shown(slowest),
            driver=self.driver,
            results=results,
            detached=self.detached,
        )

    def _failures(self, ledger: Overview) -> dict[str, Failures]:
        failed = sorted(self.failed, key=lambda attempt: attempt.number)
        counts = Counter(attempt.kind or attempt.state for attempt in failed).most_common()
        examples = {attempt.kind or attempt.state: attempt for attempt in reversed(failed)}
        return {kind: Failures(count, self._explained(examples[kind], ledger)) for kind, count in counts}

    def _shown(self, attempt: Attempt, message: str = "", log: tuple[str, ...] = ()) -> RunReported:
        known = json.loads(attempt.inputs)
        inputs = {name: known[name] for name in self.plan.inputs}
        return RunReported(self.keys[attempt.number], inputs, _seconds(attempt), message, log)

    def _explained(self, attempt: Attempt, ledger: Overview) -> RunReported:
        details = ledger.details([attempt.number])[attempt.number]
        log = [line.rstrip() for line in details.log.splitlines() if line.strip()][-LOG_LINES:]
        return self._shown(attempt, next(iter(details.message.splitlines()), ""), tuple(log))

    def _pace(self) -> tuple[float | None, float | None]:
        """Return the runs per minute of the last driver that finished any, and the seconds left at its pace."""
        made = [
            attempt
            for run in self.runs
            for attempt in run.attempts
            if attempt.finished_at is not None and attempt.origin is None and attempt.kind != INTERRUPTED
        ]
        session = max((attempt.session for attempt in made), default=None)
        rate = _per_minute([attempt for attempt in made if attempt.session == session])
        left = self.plan.planned - len(self.ok) - len(self.failed)
        at_work = self.driver is not None and self.driver.at_work and self.driver.session == session
        return rate, 60.0 * left / rate if rate and at_work else None


def _per_minute(made: Sequence[Attempt]) -> float | None:
    """Return the pace of the last `RATE_RUNS` runs that one driver has made.

    If there are no earlier ones, time counts from the first start: parallel runs may all end at once.
    """
    ends = sorted(attempt.finished_at or 0.0 for attempt in made)
    if not ends:
        return None
    number = min(len(ends), RATE_RUNS)
    begun = min(attempt.started_at for attempt in made) if number == len(ends) else ends[-number - 1]
    return 60.0 * number / (ends[-1] - begun) if ends[-1] > begun else None


def _results(folder: Path, study_sha256: str) -> Results:
    summary = read_json(folder / SUMMARY)
    if not summary:
        return "none"
    return "current" if summary.get("study_sha256") == study_sha256 else "outdated"


def _seconds(attempt: Attempt) -> float:
    return attempt.seconds or 0.0
