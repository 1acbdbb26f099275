"""The driver of one call of the Dask executor: it gives each run to a free thread, and looks after the workers."""

import contextlib
import itertools
import math
import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from typing import Any

from strandline.errors import InvalidInput
from strandline.runs.executors.dask_cluster import Cluster
from strandline.runs.executors.options import SPARE_SECONDS
from strandline.runs.executors.seat import Seat
from strandline.runs.record import NOT_NOW, RunRecord, RunRequest

SESSIONS_REMEMBERED = 1000


@dataclass(frozen=True)
class DaskStart:
    """The start of one worker process as Dask sees it; `DaskJob` uses the process.

    Args:
        session: call of the executor that it belongs to.
        setup: model, from `packed_model`.
    """

    session: str
    setup: bytes

    def __call__(self) -> bool:
        """Start a new worker process and return whether it is ready.

        Raises:
            InvalidInput: the worker process cannot load the model.
        """
        _seats.end_others(self.session)
        with _seats.kept(self.session, Seat(self.setup)) as seat:
            return seat.start(wanted=_wanted())


@dataclass(frozen=True)
class DaskJob:
    """One run as Dask sees it: it returns a record whatever the simulator does.

    Args:
        session: the call of the executor that it belongs to.
        setup: the model, from `packed_model`.
        request: the run.
        timeout: seconds after which it is killed.
    """

    session: str
    setup: bytes
    request: RunRequest
    timeout: float | None

    def __call__(self) -> RunRecord | None:
        """Make the run and return its record; the record is lost if the driver has gone meanwhile.

        Raises:
            InvalidInput: the worker process cannot load the model.
        """
        with _seats.kept(self.session, _seats.idle_one(self.session) or Seat(self.setup)) as seat:
            return seat.run(self.request, self.timeout, wanted=_wanted())


def end_session(session: str) -> None:
    """End the worker processes of `session` on this Dask worker: the idle ones now, the others after their run."""
    _seats.end(session)


class _Seats:
    """The idle seats of this process, by the session for which they are set up."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.idle: dict[str, list[Seat]] = {}
        self.ended: deque[str] = deque(maxlen=SESSIONS_REMEMBERED)

    def idle_one(self, session: str) -> Seat | None:
        """Take an idle seat of `session`; None if there is none."""
        with self.lock:
            mine = self.idle.get(session)
            return mine.pop() if mine else None

    @contextmanager
    def kept(self, session: str, seat: Seat) -> Iterator[Seat]:
        """Yield `seat`, which is idle afterwards; close it if the session has ended, or after an error."""
        try:
            yield seat
        except BaseException:
            seat.close()
            raise
        with self.lock:
            ended = session in self.ended
            if not ended:
                self.idle.setdefault(session, []).append(seat)
        if ended:
            seat.close()

    def end(self, session: str) -> None:
        """Close the idle seats of `session`, and let none of its seats become idle again."""
        with self.lock:
            self.ended.append(session)
            seats = self.idle.pop(session, [])
        for seat in seats:
            seat.close()

    def end_others(self, session: str) -> None:
        """Close the idle seats of other sessions: their drivers may be gone; if not, they start new ones."""
        with self.lock:
            others = [self.idle.pop(of) for of in list(self.idle) if of != session]
        for seat in itertools.chain.from_iterable(others):
            seat.close()


_seats = _Seats()


def _wanted() -> Callable[[], bool]:
    """Return a function that says whether the scheduler still wants the task of the calling thread."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state != "cancelled"

    return wanted


SECONDS_BETWEEN_DISMISSALS = 2.0
SECONDS_BETWEEN_LOOKS = 1.0
SECONDS_BETWEEN_QUESTIONS = 0.25
"""How long the driver waits for news before it asks again for requests, if there were none the last time."""
SILENCE_BORNE_SECONDS = 60.0
"""How long the scheduler may be unreachable."""
FETCH_SECONDS = 30.0


@dataclass
class _Out:
    """A run that was given to a worker."""

    request: RunRequest
    worker: str
    future: Any
    began: float


class Driver:
    """One call: the runs that are out, the records not handed over yet, and the workers present.

    A thread gets runs only when it has a worker process that has loaded the model, so no run waits for that.

    Args:
        cluster: Cluster that makes the runs.
        setup: Model, from `packed_model`.
        requests: Runs to make.
        timeout: Seconds after which a run is killed; None: never.
        life: Seconds that a worker lives; None: no limit.
        least: Number of jobs to keep when fewer runs than jobs are left.
        most: Maximum number of threads to use.
        silence_borne_seconds: How long the scheduler may be unreachable.
    """

    def __init__(
        self,
        cluster: Cluster,
        setup: bytes,
        requests: Iterator[RunRequest],
        *,
        timeout: float | None,
        life: float | None,
        least: int,
        most: int,
        silence_borne_seconds: float = SILENCE_BORNE_SECONDS,
    ) -> None:
        self.cluster, self.setup, self.requests = cluster, setup, requests
        self.timeout, self.life, self.least, self.most = timeout, life, least, most
        self.silence_borne_seconds = silence_borne_seconds
        self.session, self.number = uuid.uuid4().hex, 0
        self.exhausted = self.told_to_wait = False
        self.held: RunRequest | None = None
        self.out: dict[str, _Out] = {}
        self.starts: dict[str, tuple[str, Any]] = {}
        self.news: SimpleQueue[str] = SimpleQueue()
        self.done: deque[tuple[str, RunRecord]] = deque()
        self.threads: dict[str, int] = {}
        self.ready: dict[str, int] = {}
        self.first_seen: dict[str, float] = {}
        self.retired: dict[str, float] = {}
        self.looked = self.reached = time.monotonic()

    def records(self) -> Iterator[RunRecord]:
        """Yield records until every request that was pulled is answered."""
        self._look()
        while True:
            while self.done:
                _, record = self.done.popleft()
                self._fill()
                yield record
            if self.told_to_wait:
                self._hear(0.0)  # the requests may wait for what has come meanwhile
                if self.done:
                    continue
                self.told_to_wait = False
            self._fill()
            if self.exhausted and self.held is None and not self.out and not self.done:
                return
            self._hear(self._patience())

    def close(self) -> None:
        """Stop the runs that are still out."""
        if self.looked > self.reached:
            return  # the scheduler is gone, or was a moment ago
        client: Any = self.cluster.client
        futures = [out.future for out in self.out.values()] + [future for _, future in self.starts.values()]
        with contextlib.suppress(Exception):  # the scheduler may be gone, and the runs with it
            client.cancel(futures, force=True)
            client.run(end_session, self.session, on_error="ignore")

    def _fill(self) -> None:
        """Pull a request for each free thread and start it there."""
        while (worker := self._free_worker()) is not None:
            if self.held is None:
                self.held = self._pulled()
                if self.held is None:
                    return
                if time.monotonic() >= self.looked + SECONDS_BETWEEN_LOOKS:
                    self._look()  # a worker may have gone while the next run was chosen
                    continue
            request, self.held = self.held, None
            self._submit(request, worker)

    def _free_worker(self) -> str | None:
        """Return a worker with a free thread; let workers go whose job has too little time left."""
        taken = Counter(out.worker for out in self.out.values()) + Counter(worker for worker, _ in self.done)
        free = None
        for worker, ready in self.ready.items():
            if self._spent(worker):
                if not taken[worker]:
                    self._retire(worker)
            elif free is None and taken[worker] < ready:
                free = worker
        return free

    def _pulled(self) -> RunRequest | None:
        """Return the next request; None if there is none now, or there are no more."""
        if self.exhausted or self.told_to_wait:
            return None
        try:
            request = next(self.requests)
        except StopIteration:
            self._no_more()
            return None
        self.told_to_wait = request is NOT_NOW
        return None if self.told_to_wait else request

    def _submit(self, request: RunRequest, worker: str) -> None:
        key, future = self._sent(DaskJob(self.session, self.setup, request, self.timeout), worker)
        self.out[key] = _Out(request, worker, future, time.monotonic())
        future.add_done_callback(lambda done: self.news.put(done.key))

    def _start_processes(self) -> None:
        """Start worker processes for the threads that have none, up to the maximum number of threads."""
        starting = Counter(worker for worker, _ in self.starts.values())
        room = self.most - sum(self.ready.values()) - starting.total()
        for worker, threads in self.threads.items():
            for _ in range(min(room, threads - self.ready.setdefault(worker, 0) - starting[worker])):
                room -= 1
                key, future = self._sent(DaskStart(self.session, self.setup), worker)
                self.starts[key] = worker, future
                future.add_done_callback(lambda done: self.news.put(done.key))

    def _sent(self, job: DaskJob | DaskStart, worker: str) -> tuple[str, Any]:
        self.number += 1
        key = f"strandline-{self.session}-{self.number}"
        future = self.cluster.client.submit(
            job, key=key, workers=[worker], allow_other_workers=False, pure=False, retries=0
        )
        return key, future

    def _patience(self) -> float:
        """Return the seconds until something must be done even without news."""
        if not self.threads:
            return 0.1
        return SECONDS_BETWEEN_QUESTIONS if self.told_to_wait else SECONDS_BETWEEN_LOOKS

    def _hear(self, longest: float) -> None:
        """Wait for news, up to `longest` seconds, and deal with all of it; look after the workers now and then."""
        with contextlib.suppress(Empty):
            self._take(self.news.get(timeout=longest) if longest else self.news.get_nowait())
        while not self.news.empty():
            self._take(self.news.get())
        if time.monotonic() >= self.looked + SECONDS_BETWEEN_LOOKS or not self.threads:
            self._look()

    def _take(self, key: str) -> None:
        """Keep the record of a run that has ended, or note that a thread is ready."""
        if key in self.starts:
            self._note_start(*self.starts.pop(key))
        elif key in self.out:
            out = self.out.pop(key)
            self.done.append((out.worker, self._record(out)))

    def _note_start(self, worker: str, future: Any) -> None:
        if self._result(future) is True and worker in self.ready:
            self.ready[worker] += 1

    def _record(self, out: _Out) -> RunRecord:
        result = self._result(out.future)
        if isinstance(result, RunRecord):
            return replace(result, key=out.request.key, inputs=out.request.inputs)
        if isinstance(result, Exception):
            self._look()  # if the scheduler is gone, nothing must be given to it
            return _vanished(out, type(result).__name__)
        return _vanished(out, "it was cancelled")

    def _result(self, future: Any) -> Any:
        """Return what a future holds, or the error that says that its worker is gone.

        Raises:
            InvalidInput: the worker cannot make any run.
        """
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        try:
            return future.result(timeout=FETCH_SECONDS)
        except InvalidInput:
            raise
        except (KilledWorker, FutureCancelledError, TimeoutError, OSError) as error:
            return error
        except Exception as error:
            raise _unusable(error) from error
        finally:
            future.release()

    def _look(self) -> None:
        """Find out which workers are present; the runs of those that are gone are lost."""
        self.looked = time.monotonic()
        try:
            self.threads = dict(self.cluster.client.nthreads())
        except (OSError, TimeoutError, RuntimeError) as error:
            self.threads, self.ready = {}, {}
            if time.monotonic() > self.reached + self.silence_borne_seconds:
                raise _out_of_reach(self.cluster.address, error) from error
            return
        self.reached = self.looked
        self.cluster.replace_the_lost()
        if self.cluster.refused is not None and not self.threads:
            raise _refused(self.cluster.refused)
        self._forget_the_gone()
        for worker in self.threads:
            self.first_seen.setdefault(worker, self.looked)
        self._start_processes()

    def _forget_the_gone(self) -> None:
        """Record as lost the runs of workers that are no longer there."""
        self.ready = {worker: ready for worker, ready in self.ready.items() if worker in self.threads}
        for key in [key for key, (worker, _) in self.starts.items() if worker not in self.threads]:
            self.starts.pop(key)[1].cancel(force=True)
        for key in [key for key, out in self.out.items() if out.worker not in self.threads]:
            if self.out[key].future.status == "finished":
                continue
            out = self.out.pop(key)
            out.future.cancel(force=True)
            self.done.append((out.worker, _vanished(out, f"the Dask worker {out.worker} is gone")))

    def _spent(self, worker: str) -> bool:
        """Return whether a run started there now might not end before its job does."""
        if self.life is None or self.timeout is None:
            return False
        return time.monotonic() > self.first_seen[worker] + self.life - self.timeout - 0.5 * SPARE_SECONDS

    def _retire(self, worker: str) -> None:
        """Let a worker go whose job has too little time left; another job takes its place.

        Dask silently keeps a worker that holds the only copy of a result, for example of a run that has just ended. So
        the request is repeated until the worker is gone.
        """
        now = time.monotonic()
        if now < self.retired.get(worker, -math.inf) + SECONDS_BETWEEN_DISMISSALS:
            return
        self.retired[worker] = now
        with contextlib.suppress(OSError, TimeoutError):
            self.cluster.client.retire_workers([worker], close_workers=True)

    def _no_more(self) -> None:
        """Release jobs that have nothing left to do."""
        self.exhausted = True
        self.cluster.shrink(max(self.least, len({out.worker for out in self.out.values()})))


def _vanished(out: _Out, how: str) -> RunRecord:
    return RunRecord(
        out.request.key,
        out.request.inputs,
        "killed",
        seconds=time.monotonic() - out.began,
        failure_kind="worker_died",
        message=f"the Dask worker of this run vanished: {how}",
    )


def _unusable(error: Exception) -> InvalidInput:
    return InvalidInput(
        "runs cannot be made on the Dask workers",
        value=f"{type(error).__name__}: {error}",
        expected="the same strandline, and the model, where the scheduler and its workers are",
        remedy="Install both there, in the same versions as here.",
    )


def _refused(reason: str) -> InvalidInput:
    lines = [line for line in reason.splitlines() if "error" in line.lower()]
    return InvalidInput(
        "the queueing system takes no job for a Dask worker",
        value=lines[-1] if lines else reason,
        expected="jobs with these cores, memory, walltime, queue and account",
        remedy="Correct executor.dask.jobs, and run again: finished runs are kept.",
    )


def _out_of_reach(address: str, error: Exception) -> InvalidInput:
    return InvalidInput(
        f"the Dask scheduler at {address} cannot be reached any more",
        value=f"{type(error).__name__}: {error}",
        expected="an answer within a minute",
        remedy="Start it again and repeat the command: finished runs are kept.",
    )
