"""A campaign: make the runs of a design that the ledger does not hold yet, and keep every outcome as it arrives."""

import contextlib
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from strandline.foundations import InvalidInput, LedgerError, NumericsError
from strandline.models import ForwardModel, asks_sensitivities, fingerprint, prepare_runs, run_identity
from strandline.runs.executors import Executor
from strandline.runs.executors.shared import require_count
from strandline.runs.failures import FailurePolicy, Outages, aborted
from strandline.runs.ledger.ledger import Ledger
from strandline.runs.ledger.ledger_schema import EXCLUDED, INTERRUPTED, another_model
from strandline.runs.ledger.record import NOT_NOW, RunRecord, RunRequest, run_key


@dataclass(frozen=True)
class Progress:
    """How far a campaign has come; counts are of distinct runs.

    Of the `total` that the design asks for, `finished` are settled: ok, or failed for good; `reused` were settled
    before this campaign began, `elapsed` seconds ago. It is `waiting` if it waits for the model's server, which runs in
    a row did not reach.
    """

    total: int
    finished: int
    ok: int
    failed: int
    reused: int
    elapsed: float
    waiting: bool = False

    @property
    def remaining_seconds(self) -> float | None:
        """Estimated time to the end at the pace so far; None before the first run is settled."""
        made = self.finished - self.reused
        return self.elapsed / made * (self.total - self.finished) if made else None


def run_campaign(
    model: ForwardModel,
    inputs: Sequence[Mapping[str, float]],
    *,
    ledger: Ledger,
    executor: Executor,
    on_record: Callable[[RunRecord, Progress], None] | None = None,
    maximum_attempts: int = 3,
    policy: FailurePolicy | None = None,
) -> tuple[RunRecord, ...]:
    """Return one record per entry of `inputs`, in that order; only what the ledger lacks is run.

    A run whose process vanished, or that was lost with its driver, is tried up to `maximum_attempts` times in total;
    every other end is final, unless `policy` says otherwise. Equal inputs are run once. A run that does not end ``ok``
    is data: look at `state`.
    If an executor makes runs without a driver (its `outstanding` says which), the campaign waits for them and does not
    start them again. If the model must return sensitivities, a run that the ledger holds without them is run again, and
    its new outcome replaces the old one. If several runs in a row do not reach the server of the model, the campaign
    waits for it.

    Args:
        model: The simulator.
        inputs: Design: one mapping of inputs by name per run.
        ledger: Ledger of this model, opened for writing; only the caller of this function writes to it.
        executor: Executor that makes the runs.
        on_record: Function called with each record as it arrives, including killed runs that will be tried again.
        maximum_attempts: Number of times that a run may take its process down.
        policy: What to do about failed runs; None leaves them out, however many there are.

    Raises:
        CampaignStopped: The `policy` ends the campaign, or the server does not answer; finished runs are in the ledger.
        LedgerError: the ledger belongs to another model, or cannot be written.
    """
    policy = policy or FailurePolicy(stop_share=2.0)
    campaign = Campaign(model, inputs, ledger, executor, on_record, maximum_attempts, policy)
    while campaign.pending:
        campaign.run_pending()
    return campaign.results()


class Campaign:
    """State of one call of `run_campaign`, or of `run_batches`, whose design grows."""

    def __init__(
        self,
        model: ForwardModel,
        inputs: Sequence[Mapping[str, float]],
        ledger: Ledger,
        executor: Executor,
        on_record: Callable[[RunRecord, Progress], None] | None,
        maximum_attempts: int,
        policy: FailurePolicy,
    ) -> None:
        self.policy = policy
        self.model, self.ledger, self.executor, self.on_record = model, ledger, executor, on_record
        require_count("maximum_attempts", maximum_attempts, remedy="Allow at least one attempt.")
        self.maximum_attempts, self.began = maximum_attempts, time.monotonic()
        self.identity = fingerprint(model)
        if ledger.model != self.identity:
            raise another_model(ledger.path, ledger.model, self.identity)
        self.order: list[str] = []
        self.requests: dict[str, RunRequest] = {}
        self.before: dict[str, tuple[int, int]] = {}
        self.settled: dict[str, RunRecord] = {}
        self.failed = 0
        self.reused = 0
        self.made: list[RunRecord] = []
        self.outstanding: set[str] = set()
        self.outages = Outages(model)
        self.pending = self.add(inputs)

    def add(self, inputs: Sequence[Mapping[str, float]], *, plain: bool = False) -> list[RunRequest]:
        """Add runs to the end of the design, `plain` ones without sensitivities; return those that must be made."""
        keys = [run_key(run_identity(self.model, self.identity, entry), entry) for entry in inputs]
        new = {
            key: RunRequest(key, dict(entry), plain)
            for key, entry in zip(keys, inputs, strict=True)
            if key not in self.requests
        }
        self.order += keys
        self.requests |= new
        known = self.ledger.latest(new)
        asked = asks_sensitivities(self.model) and not plain
        again = {key for key, record in known.items() if self.policy.tries_again(record)}
        self.before |= {key: (self.ledger.attempts(key), self.ledger.open_attempts(key)) for key in again}
        settled = {
            key: record
            for key, record in known.items()
            if key not in again and record.settles(sensitivities=asked) and not self._deserves_another(record)
        }
        for record in settled.values():
            self._settle(record)
        self.reused += len(settled)
        self.outstanding |= self._still_out(self.ledger.open_runs(new))
        return self._plan(new.values())

    def run_pending(self, further: "Further | None" = None) -> None:
        """Run what is pending once, then plan what must be tried again.

        `further` returns more runs when none is waiting; with it, runs that deserve another attempt are tried again at
        once.
        """
        self.outages.require_server(self.ledger.latest(request.key for request in self.pending).values())
        starts = Starts(self.ledger, self.pending, self.outstanding, further, getattr(self.model, "at_once", None))
        try:
            self._consume(starts)
        except BaseException:
            starts.interrupt(self._still_out(frozenset(starts.running)))
            raise
        self.outstanding.clear()
        if not starts.begun:
            raise NumericsError("the executor ended without starting a single run; report it to its author")
        self.pending = self._plan(self.requests.values())

    def results(self) -> tuple[RunRecord, ...]:
        return tuple(self.settled[key] for key in self.order if key in self.settled)

    def _consume(self, starts: "Starts") -> None:
        prepare_runs(self.model)
        records = self.executor(self.model, starts)
        if not isinstance(records, Iterable):
            raise self._misused(f"a {type(records).__name__}", "records, one after the other, by `yield`")
        with contextlib.ExitStack() as stack:
            if hasattr(records, "close"):
                stack.callback(records.close)
            for record in records:
                self._require_answer(record, starts)
                self.ledger.finished(record)
                starts.running.pop(record.key, None)
                self.outages.note(record)
                if self._deserves_another(record):
                    starts.put_back(self.requests[record.key])
                else:
                    self._settle(record)
                    self.made.append(record)
                if self.on_record is not None:
                    self.on_record(record, self._progress())
                self._heed(record)

    def _require_answer(self, record: object, starts: "Starts") -> None:
        """Refuse anything but the record of a run that was started and has no record yet."""
        if not isinstance(record, RunRecord):
            raise self._misused(f"a {type(record).__name__}", "a RunRecord for each request")
        if record.key not in starts.running:
            raise self._misused(f"a record of the run {record.key}", "one record for each run that was started")

    def _misused(self, value: str, expected: str) -> InvalidInput:
        what = f"what the executor {type(self.executor).__name__} yields"
        return InvalidInput(what, value=value, expected=expected, remedy="Check it with strandline.testing.executors.")

    def _heed(self, record: RunRecord) -> None:
        """Stop the campaign if the policy says so."""
        if self.policy.aborts(record):
            raise aborted(record)
        if not record.ok or len(self.made) <= self.policy.stop_after:
            self.policy.require_worth_going_on(self.made)
        self.outages.require_server()

    def _settle(self, record: RunRecord) -> None:
        self.settled[record.key] = record
        self.failed += not record.ok

    def _plan(self, candidates: Iterable[RunRequest]) -> list[RunRequest]:
        """Return the runs that may be tried (again); settle those that have used up their attempts."""
        pending = []
        for request in candidates:
            if request.key in self.settled:
                continue
            if request.key not in self.outstanding and self._given_up_on(request.key):
                self._settle(self._given_up(request))
            else:
                pending.append(request)
        return pending

    def _deserves_another(self, record: RunRecord) -> bool:
        """Return whether a run that ended like this is to be tried again."""
        if record.state == EXCLUDED:
            return False
        allowed = self.policy.attempts(record, killed=self.maximum_attempts)
        return not record.ok and self._attempts(record.key, since_final=record.state == "killed") < allowed

    def _attempts(self, key: str, *, since_final: bool) -> int:
        """Return how often a run was tried since it last ended for good, or in total; a repeated run starts at zero."""
        before = self.before.get(key, (0, 0))
        if since_final:
            return max(self.ledger.open_attempts(key) - before[1], 0)
        return self.ledger.attempts(key) - before[0]

    def _given_up_on(self, key: str) -> bool:
        """Return whether a run without a final end, killed or lost, has used up its attempts."""
        attempts, allowed = self._attempts(key, since_final=True), self.maximum_attempts
        known = self.ledger.latest([key]).get(key) if attempts else None
        if known is not None and known.state == "killed" and known.failure_kind != INTERRUPTED:
            allowed = self.policy.attempts(known, killed=allowed)
        return attempts >= allowed

    def _still_out(self, keys: frozenset[str]) -> frozenset[str]:
        """Return the started runs in `keys` that go on without a driver, if the executor makes such runs."""
        ask = getattr(self.executor, "outstanding", None)
        return frozenset() if ask is None or not keys else frozenset(ask(self.model, keys))

    def _given_up(self, request: RunRequest) -> RunRecord:
        """Return the record of a run that was killed or lost too often, in this campaign or before."""
        known = self.ledger.latest([request.key]).get(request.key)
        if known is not None and known.ok:  # it only lacks its sensitivities
            return known
        times = f"{self.ledger.open_attempts(request.key)} attempts"
        advice = "Look for what stops the process (memory?), or raise maximum_attempts."
        if known is not None and known.failure_kind != INTERRUPTED:
            return replace(known, message=f"{known.message}\ngiven up after {times}. {advice}")
        message = f"lost: started and never ended, given up after {times}. {advice}"
        return RunRecord(request.key, request.inputs, "killed", failure_kind="lost", message=message)

    def _progress(self) -> Progress:
        finished, failed = len(self.settled), self.failed
        elapsed, total = time.monotonic() - self.began, len(self.requests)
        return Progress(total, finished, finished - failed, failed, self.reused, elapsed, self.outages.suspected)


class Starts:
    """Hands out requests and records each as STARTED at that moment; knows which are running, and since when.

    Runs in `outstanding` were started by an earlier driver and only need waiting for. When no request is waiting,
    `further` may return some; if it returns none for now, `NOT_NOW` is handed out. The first call that finds none
    waiting gets `NOT_NOW` before `further` is called: until all records are handed over, `further` might not know which
    runs have ended. The length hint, of which executors start no more workers, is at most `at_once`.
    """

    def __init__(
        self,
        ledger: Ledger,
        requests: Iterable[RunRequest],
        outstanding: set[str],
        further: "Further | None" = None,
        at_once: int | None = None,
    ) -> None:
        self.ledger, self.waiting, self.outstanding, self.further = ledger, deque(requests), outstanding, further
        self.at_once = at_once
        self.running: dict[str, RunRequest] = {}
        self.begun: dict[str, float] = {}
        self.told_to_wait = False

    def __iter__(self) -> Iterator[RunRequest]:
        return self

    def __next__(self) -> RunRequest:
        if not self.waiting and self.further is not None and not self._filled(self.further):
            self.told_to_wait = True
            return NOT_NOW
        if not self.waiting:
            raise StopIteration
        self.told_to_wait = False
        request = self.waiting.popleft()
        if request.key not in self.outstanding:
            self.ledger.started(request)
        self.running[request.key] = request
        self.begun[request.key] = time.monotonic()
        return request

    def __length_hint__(self) -> int:
        if self.further is None:
            return min(len(self.waiting), self.at_once or len(self.waiting))
        return self.at_once or NotImplemented

    def put_back(self, request: RunRequest) -> None:
        """Let the same call of the executor start a run that has ended once more, if that call goes on."""
        if self.further is not None:
            self.outstanding.discard(request.key)
            self.waiting.append(request)

    def _filled(self, further: "Further") -> bool:
        """Return whether the next step is known: requests are waiting, or this is the end."""
        requests = further(self) if self.told_to_wait else ()
        self.waiting.extend(requests or ())
        return requests is None or bool(self.waiting)

    def interrupt(self, still_out: frozenset[str]) -> None:
        """Record the runs that were stopped together with the campaign; they do not count as attempts.

        Those in `still_out` go on without it.
        """
        with contextlib.suppress(LedgerError):
            for request in (request for key, request in self.running.items() if key not in still_out):
                message = "stopped with its campaign, for no reason of its own; it will be run again"
                record = RunRecord(request.key, request.inputs, "killed", failure_kind=INTERRUPTED, message=message)
                self.ledger.finished(record)


Further = Callable[[Starts], Sequence[RunRequest] | None]
"""Returns what to start next when nothing is waiting: an empty sequence for nothing now, None for the end."""
