"""Processes that save figures while the next ones are drawn: a figure takes as long to save as to draw."""

import pickle
import subprocess
import sys
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

from strandline.foundations import threads
from strandline.report.plots.style import Captioned, saved

MOST = 4
"""Processes; each takes a second to start."""
SERVE = "import sys; sys.path[:] = {path!r}; from strandline.report.savers import serve; serve()"


class Savers:
    """Saves figures into a folder, see `saved`; use it as a context.

    Each thread but one has a process; with ``OMP_NUM_THREADS`` of 1, and for a figure that cannot be pickled, `save`
    does the work itself.
    """

    def __init__(self, folder: Path, *, draft: bool) -> None:
        self._folder, self._draft, self._own = folder, draft, threading.local()
        self._processes: list[subprocess.Popen[bytes]] = []
        number = min(threads() - 1, MOST)
        self._pool = ThreadPoolExecutor(number, initializer=self._start) if number else None

    def __enter__(self) -> "Savers":
        return self

    def __exit__(self, *error: object) -> None:
        if self._pool:
            self._pool.shutdown(cancel_futures=True)
        for process in self._processes:
            process.communicate()

    def save(self, captioned: Captioned) -> Future[dict[str, str]]:
        """Save a figure, which may change afterwards; the result is that of `saved`."""
        if self._pool:
            with suppress(AttributeError, TypeError, pickle.PicklingError):
                return self._pool.submit(self._elsewhere, pickle.dumps((captioned, self._folder, self._draft)))
        done: Future[dict[str, str]] = Future()
        done.set_result(saved(captioned, self._folder, draft=self._draft))
        return done

    def _start(self) -> None:
        """Give this thread a process, which ends once its input does."""
        command, pipe = [sys.executable, "-c", SERVE.format(path=sys.path)], subprocess.PIPE
        self._own.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, start_new_session=True)
        self._processes.append(self._own.process)

    def _elsewhere(self, task: bytes) -> Any:
        process = self._own.process
        try:
            process.stdin.write(task)
            process.stdin.flush()
            found = pickle.load(process.stdout)
        except (EOFError, OSError):
            remedy = "Give it more memory, or set OMP_NUM_THREADS=1 to do without it."
            raise RuntimeError(f"the process that saves figures ended too early. {remedy}") from None
        if isinstance(found, Exception):
            raise found
        return found


def serve() -> None:
    """Save the figures that come on standard input until it ends, and answer with what `saved` returns or raises."""
    while True:
        try:
            captioned, folder, draft = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        found: Any
        try:
            found = saved(captioned, folder, draft=draft)
        except Exception as error:
            found = RuntimeError(f"{type(error).__name__}: {error}")
        pickle.dump(found, sys.stdout.buffer)
        sys.stdout.buffer.flush()
