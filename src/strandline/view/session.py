"""What all requests for the page of a study share."""

import asyncio
import gc
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from strandline.foundations import StrandlineError
from strandline.view.viewed import ViewedStudy

PAUSE = 0.5
"""Seconds between two looks at the ledger."""
PATIENCE = 5.0
"""Seconds for which the first counts and the first posterior wait until a page has got the runs."""


@dataclass
class Session:
    """What all requests share: the study, threads that do the work, and the state at the last look.

    `streams` counts the open streams of events, which end when it is `closing`; `problem` says what is wrong with the
    ledger.
    """

    viewed: ViewedStudy
    patience: float = PATIENCE
    streams: int = 0
    closing: bool = False
    problem: str = ""
    _reading: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "ledger"))
    _answering: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(2, "answers"))
    _solving: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "flow"))
    _sampling: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "posterior"))
    _runs_given: asyncio.Event = field(default_factory=asyncio.Event)
    _counted: asyncio.Event = field(default_factory=asyncio.Event)
    _state: dict[str, Any] = field(default_factory=dict)
    _stamp: tuple[Any, ...] = ()
    _rest_until: float = 0.0

    async def read(self, task: Callable[[], Any]) -> Any:
        """Do a task that reads the ledger; one at a time."""
        return await _done(self._reading, partial(_without_collection, task))

    async def runs_since(self, version: int) -> dict[str, Any]:
        """Return the runs that changed after a version of the feed."""
        found: dict[str, Any] = await self.read(lambda: self.viewed.feed.since(version))
        self._runs_given.set()
        return found

    async def answer(self, task: Callable[[], Any]) -> Any:
        return await _done(self._answering, task)

    async def solve(self, task: Callable[[], Any]) -> Any:
        """Do a task that runs the model; one at a time."""
        return await _done(self._solving, task)

    async def watch_runs(self) -> None:
        """Look at the ledger again and again; at first, only for the runs."""
        with suppress(StrandlineError, OSError, TimeoutError):
            await self.read(self.viewed.feed.update)
            self._state = {"version": self.viewed.feed.version}
            await asyncio.wait_for(self._runs_given.wait(), self.patience)
        while True:
            try:
                await self.read(self._look)
            except (StrandlineError, OSError) as error:
                self.problem = str(error)
            self._counted.set()
            await asyncio.sleep(PAUSE)

    def _look(self) -> None:
        """Read what is new. A large ledger is not counted all the time."""
        self.viewed.require_ledger()
        self.viewed.feed.update()
        stamp, begun = self.viewed.stamp, time.monotonic()
        if (stamp == self._stamp and not self.problem) or begun < self._rest_until:
            return
        self._state = self.viewed.state
        self._rest_until = time.monotonic() + time.monotonic() - begun
        self._stamp, self.problem = stamp, ""

    async def watch_posterior(self) -> None:
        """Compute the posterior again when there are enough new runs, or read it when the study has ended."""
        newest = self.viewed.newest
        await self._counted.wait()
        while True:
            made = self.viewed.feed.succeeded
            try:
                if await self.read(partial(newest.due, made)):
                    await _done(self._sampling, partial(newest.refresh, made))
                    await self.read(self._look)
            except (StrandlineError, OSError):
                pass  # `watch_runs` reports what is wrong with the ledger
            await asyncio.sleep(PAUSE)

    @property
    def state(self) -> dict[str, Any]:
        """The state at the last look, and what is wrong with the ledger."""
        return {**self._state, "problem": self.problem}

    async def close(self) -> None:
        """Let all streams of events end."""
        self.closing = True
        for _ in range(100):
            if not self.streams:
                break
            await asyncio.sleep(0.01)
        for some in (self._reading, self._answering, self._solving, self._sampling):
            some.shutdown(wait=False, cancel_futures=True)


async def _done(pool: ThreadPoolExecutor, task: Callable[[], Any]) -> Any:
    return await asyncio.get_running_loop().run_in_executor(pool, task)


def _without_collection(task: Callable[[], Any]) -> Any:
    """Do a task with garbage collection paused: the many objects that it makes for a large ledger all stay."""
    gc.disable()
    try:
        return task()
    finally:
        gc.enable()
