"""What a Dask worker does with a run: hand it to a worker process of strandline, which takes the harm."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from strandline.runs.executors.seat import Seat
from strandline.runs.record import RunRecord, RunRequest

__all__ = ["DaskJob", "end_session"]


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
        """Make the run; nobody hears of it where the driver went away meanwhile.

        Raises:
            InvalidInput: the worker process cannot load the model.
        """
        with _seats.taken(self.session, self.setup) as seat:
            return seat.run(self.request, self.timeout, wanted=_wanted())


def end_session(session: str) -> None:
    """End the worker processes of `session` that are idle on this Dask worker."""
    _seats.end_idle(session)


class _Seats:
    """The seats of this process: one for each thread that has made runs, and the session that it is set up for."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.idle: dict[int, tuple[str, Seat]] = {}

    @contextmanager
    def taken(self, session: str, setup: bytes) -> Iterator[Seat]:
        """Give the seat of the calling thread; a new one where its last one was of another session."""
        me = threading.get_ident()
        with self.lock:
            of, seat = self.idle.pop(me, ("", None))
        if seat is not None and of != session:
            seat.close()
            seat = None
        seat = seat or Seat(setup)
        try:
            yield seat
        except BaseException:
            seat.close()
            raise
        with self.lock:
            self.idle[me] = (session, seat)

    def end_idle(self, session: str) -> None:
        """Close the seats of `session` that are not taken."""
        with self.lock:
            mine = [me for me, (of, _) in self.idle.items() if of == session]
            seats = [self.idle.pop(me)[1] for me in mine]
        for seat in seats:
            seat.close()


_seats = _Seats()


def _wanted() -> Callable[[], bool]:
    """Return what tells whether the scheduler still wants the task of the calling thread."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state != "cancelled"

    return wanted
