"""What all requests share: the study, the threads that do the work, and a bell that rings when something is new."""

import asyncio
import gc
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from strandline.foundations import StrandlineError
from strandline.view.viewed import ViewedStudy

PAUSE = 0.5
"""Seconds between two looks at the ledger."""
PATIENCE = 5.0
"""Seconds for which the first counts and the first posterior wait until a page has got the runs."""
KEEP_ALIVE = 15.0
"""Seconds after which a silent stream of events says that it is alive."""


@dataclass
class Session:
    """What all requests share: the study, threads that do the work, and a bell that rings when something is new.

    `streams` counts the open streams of events, which end when it is `closing`; `problem` says what is wrong with the
    ledger.
    """

    viewed: ViewedStudy
    patience: float = PATIENCE
    rings: int = 0
    streams: int = 0
    closing: bool = False
    problem: str = ""
    _reading: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "ledger"))
    _answering: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(2, "answers"))
    _solving: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "flow"))
    _sampling: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "posterior"))
    _changed: asyncio.Condition = field(default_factory=asyncio.Condition)
    _runs_given: asyncio.Event = field(default_factory=asyncio.Event)
    _counted: asyncio.Event = field(default_factory=asyncio.Event)
    _state: dict[str, Any] = field(default_factory=dict)
    _stamp: tuple[Any, ...] = ()
    _rest_until: float = 0.0

    async def read(self, task: Callable[[], Any]) -> Any:
        """Do a task that reads the ledger; one at a time."""
        return await asyncio.get_running_loop().run_in_executor(self._reading, _without_collection(task))

    async def runs_since(self, version: int) -> dict[str, Any]:
        """Return the runs that changed after a version of the feed."""
        found: dict[str, Any] = await self.read(lambda: self.viewed.feed.since(version))
        self._runs_given.set()
        return found

    async def answer(self, task: Callable[[], Any]) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._answering, task)

    async def solve(self, task: Callable[[], Any]) -> Any:
        """Do a task that runs the model; one at a time."""
        return await asyncio.get_running_loop().run_in_executor(self._solving, task)

    async def watch_runs(self) -> None:
        """Look at the ledger again and again, and ring when something is new; at first, only for the runs."""
        with suppress(StrandlineError, OSError, TimeoutError):
            await self.read(self.viewed.feed.update)
            self._state = {"version": self.viewed.feed.version}
            await self.ring()
            await asyncio.wait_for(self._runs_given.wait(), self.patience)
        while True:
            try:
                new = await self.read(self._look)
            except (StrandlineError, OSError) as error:
                new, self.problem = str(error) != self.problem, str(error)
            self._counted.set()
            if new:
                await self.ring()
            await asyncio.sleep(PAUSE)

    def _look(self) -> bool:
        """Read what is new; return whether there is anything. A large ledger is not counted all the time."""
        self.viewed.require_ledger()
        self.viewed.feed.update()
        stamp, begun = self.viewed.stamp, time.monotonic()
        if (stamp == self._stamp and not self.problem) or begun < self._rest_until:
            return False
        state = self.viewed.state
        self._rest_until = time.monotonic() + time.monotonic() - begun
        new, self._state, self._stamp, self.problem = state != self._state or bool(self.problem), state, stamp, ""
        return new

    async def watch_posterior(self) -> None:
        """Compute the posterior again when there are enough new runs, or read it when the study has ended."""
        loop, newest = asyncio.get_running_loop(), self.viewed.newest
        await self._counted.wait()
        while True:
            made = self.viewed.feed.succeeded
            try:
                if await self.read(lambda made=made: newest.due(made)):  # type: ignore[misc]
                    await loop.run_in_executor(self._sampling, newest.refresh, made)
                    await self.read(self._look)
                    await self.ring()
            except (StrandlineError, OSError):
                pass  # `watch_runs` reports what is wrong with the ledger
            await asyncio.sleep(PAUSE)

    async def ring(self) -> None:
        """Wake all streams of events."""
        async with self._changed:
            self.rings += 1
            self._changed.notify_all()

    async def heard(self, rings: int) -> int:
        """Wait until the bell has rung since; return how often it has."""
        async with self._changed:
            try:
                await asyncio.wait_for(self._changed.wait_for(lambda: self.closing or self.rings > rings), KEEP_ALIVE)
            except TimeoutError:
                return rings
        return self.rings

    @property
    def state(self) -> dict[str, Any]:
        """The state at the last look, and what is wrong with the ledger."""
        return {**self._state, "problem": self.problem}

    async def close(self) -> None:
        """Let all streams of events end."""
        self.closing = True
        await self.ring()
        for _ in range(100):
            if not self.streams:
                break
            await asyncio.sleep(0.01)
        for some in (self._reading, self._answering, self._solving, self._sampling):
            some.shutdown(wait=False, cancel_futures=True)


def _without_collection(task: Callable[[], Any]) -> Callable[[], Any]:
    """Return the task with garbage collection paused: the many objects that it makes for a large ledger all stay."""

    def paused() -> Any:
        gc.disable()
        try:
            return task()
        finally:
            gc.enable()

    return paused
