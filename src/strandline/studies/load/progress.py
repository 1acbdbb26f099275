"""How far a study has got, read from its ledger while it may be running.

If a driver has noted the study's plan in the ledger, no model is loaded and nothing numerical is imported.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from strandline.foundations import read_json
from strandline.runs import EXCLUDED, INTERRUPTED, OPEN, Attempt, Driver, Overview, Plan, Run
from strandline.studies.keys.folder import LEDGER, REFINEMENT, STUDY, Results, digest_of, results_in

if TYPE_CHECKING:
    from strandline.studies.load.study import Study


RATE_RUNS = 50  # number of runs, the last to end, that give the pace
LOG_LINES = 2
_Ended = tuple[str, Attempt]  # the key of a run, and how it ended


@dataclass(frozen=True)
class RunReported:
    """A run to show: key, unknown inputs, seconds, first line of its message, last lines of its log."""

    key: str
    inputs: Mapping[str, float]
    seconds: float
    message: str = ""
    log: tuple[str, ...] = ()


@dataclass(frozen=True)
class FailedRuns:
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
    failures: Mapping[str, FailedRuns] = field(default_factory=dict)
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
        if (one := self.driver) is not None:
            content["driver"] = {"pid": one.pid, "host": one.host, "since": one.opened_at, "at_work": one.at_work}
        return content


def progress_in(folder: Path) -> StudyProgress:
    """Return the progress of the study in `folder`: from the plan in its ledger if there is one, else by loading it.

    The plan does not show that a model has changed while study.yaml stayed the same. Raises InvalidStudy if there is no
    plan and the study cannot be loaded, LedgerError if the ledger cannot be used.
    """
    plan = recorded_plan(folder)
    if plan is not None:
        return _progress(folder, plan)
    from strandline.studies.load.load import load_study

    return progress_of(load_study(folder))


def progress_of(study: "Study") -> StudyProgress:
    """Return the progress of `study`; reads the ledger without the lock of its driver."""
    state = replace(_progress(study.folder, study.runs.plan), active=study.runs.may_end_early)
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


def _progress(folder: Path, plan: Plan) -> StudyProgress:
    results, path = results_in(folder, plan.study_sha256), folder / LEDGER
    if not path.is_file():
        return StudyProgress(plan.name, plan.planned, results=results)
    detached = any((folder / "slurm").glob("*/batch.json"))  # each batch has a folder until it is collected
    with Overview(path, model=plan.model) as ledger:
        state = _counted(plan, ledger, detached=detached)
    noted = read_json(folder / REFINEMENT)
    noted = noted if noted.get("study_sha256") == plan.study_sha256 else {}
    under_way = "given" in noted and not noted.get("finished")
    return replace(state, results=results, active=under_way, last_batch=str(noted.get("last_batch", "")))


def _counted(plan: Plan, ledger: Overview, *, detached: bool) -> StudyProgress:
    wanted, driver = frozenset(plan.keys), ledger.driver()
    runs = [run for run in ledger.runs() if run.key in wanted]
    session = None if driver is None or driver.at_work is False else driver.session
    open_runs, lost, ended = 0, 0, list[_Ended]()
    for run in runs:
        outcome = run.outcome
        if run.last.state == OPEN and (detached or run.last.session == session):
            open_runs += 1
        elif outcome is not None and run.settled(sensitivities=plan.sensitivities):
            excluded = run.exclusion is not None
            ended.append((run.key, outcome._replace(state=EXCLUDED, kind=EXCLUDED) if excluded else outcome))
        elif run.last.state == OPEN:
            lost += 1
    failed = sorted((one for one in ended if one[1].state != "ok"), key=lambda one: one[1].number)
    ok = [one for one in ended if one[1].state == "ok"]
    slowest = max([*ok, *failed], key=lambda one: one[1].seconds or 0.0, default=None)
    rate, left = _pace(runs, driver, plan.planned - len(ended))
    kinds = [attempt.kind or attempt.state for _, attempt in failed]
    failures = {
        kind: FailedRuns(count, _shown(failed[kinds.index(kind)], plan, ledger))
        for kind, count in Counter(kinds).most_common()
    }
    return StudyProgress(
        plan.name,
        plan.planned,
        ok=len(ok),
        failed=len(failed),
        open=open_runs,
        lost=lost,
        failures=failures,
        rate=rate,
        seconds_left=left,
        median_seconds=median(attempt.seconds or 0.0 for _, attempt in ended) if ended else None,
        slowest=None if slowest is None else _shown(slowest, plan),
        driver=driver,
        detached=detached,
    )


def _shown(one: _Ended, plan: Plan, ledger: Overview | None = None) -> RunReported:
    key, attempt = one
    known, message, log = json.loads(attempt.inputs), "", list[str]()
    if ledger is not None:
        details = ledger.details([attempt.number])[attempt.number]
        message = next(iter(details.message.splitlines()), "")
        log = [line.rstrip() for line in details.log.splitlines() if line.strip()][-LOG_LINES:]
    inputs = {name: known[name] for name in plan.inputs}
    return RunReported(key, inputs, attempt.seconds or 0.0, message, tuple(log))


def _pace(runs: Sequence[Run], driver: Driver | None, left: int) -> tuple[float | None, float | None]:
    """Return the runs per minute of the last driver that finished any, and the seconds left at its pace."""
    made = [
        attempt
        for run in runs
        for attempt in run.attempts
        if attempt.finished_at is not None and attempt.origin is None and attempt.kind != INTERRUPTED
    ]
    session = max((attempt.session for attempt in made), default=None)
    rate = _per_minute([attempt for attempt in made if attempt.session == session])
    at_work = driver is not None and driver.at_work and driver.session == session
    return rate, 60.0 * left / rate if rate and at_work else None


def _per_minute(made: Sequence[Attempt]) -> float | None:
    """Return the pace of one driver's last runs; if it made no others, time counts from the first start."""
    ends = sorted(attempt.finished_at or 0.0 for attempt in made)
    if not ends:
        return None
    number = min(len(ends), RATE_RUNS)
    begun = min(attempt.started_at for attempt in made) if number == len(ends) else ends[-number - 1]
    return 60.0 * number / (ends[-1] - begun) if ends[-1] > begun else None
