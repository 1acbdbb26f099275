"""What a Dask worker does with a run: hand it to a worker process of strandline, so a crash harms only that process."""

import itertools
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from strandline.runs.executors.seat import Seat
from strandline.runs.record import RunRecord, RunRequest

__all__ = ["DaskJob", "DaskStart", "end_session"]

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
