"""What executors share: how requests and records are handed over, and checks of options."""

import re
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

from strandline.foundations import require, unfit
from strandline.runs.ledger.record import NOT_NOW, RunRecord, RunRequest

Place = TypeVar("Place")
"""Where one run at a time is made."""

SPARE_SECONDS = 60.0
"""Part of its walltime that a job needs before and after a run."""
LONGEST = 366 * 24 * 3600.0
"""Seconds; longer times overflow clocks and pipes."""
DAYS = re.compile(r"(?P<days>\d+)-(?P<hours>\d+)(:(?P<minutes>\d+))?(:(?P<seconds>\d+))?")
CLOCK = re.compile(r"((?P<hours>\d+):)?(?P<minutes>\d+):(?P<seconds>\d+)")


def require_count(what: str, value: int | None, *, remedy: str, least: int = 1) -> None:
    """Refuse a number below `least`; None is left to the executor."""
    require(value is None or value >= least, what, value, f"at least {least}", remedy)


def require_seconds(what: str, seconds: float | None, *, remedy: str = "Leave it out for no limit.") -> None:
    """Refuse seconds that are not above 0, or more than a year."""
    expected = f"seconds above 0, at most {LONGEST:.0f} (a year)"
    require(seconds is None or 0 < seconds <= LONGEST, what, seconds, expected, remedy)


def require_room_in_walltime(timeout: float | None, walltime: str | None) -> None:
    """Refuse a timeout longer than the job of a run may last: the run would be killed and tried again and again."""
    if timeout is None or walltime is None:
        return
    longest = walltime_seconds(walltime) - SPARE_SECONDS
    what, found = "timeout and walltime of a job", f"{timeout:g} s in a job of {walltime}"
    expected = f"at most {max(longest, 0.0):g} s, the walltime less {SPARE_SECONDS:g} s for start and end"
    require(timeout <= longest, what, found, expected, "Ask for a longer walltime, or shorten the timeout.")


def walltime_seconds(text: str) -> float:
    """Return the seconds of MM:SS, HH:MM:SS, D-HH, D-HH:MM or D-HH:MM:SS; refuse a bare number: units differ."""
    found = DAYS.fullmatch(text) or CLOCK.fullmatch(text)
    if found is None:
        expected = 'hours:minutes:seconds, e.g. "02:30:00", or days-hours, e.g. "1-12"'
        raise unfit("walltime", text, expected, "Write it like this, in quotes.")
    parts = {name: int(number or 0) for name, number in found.groupdict().items()}
    hours = 24 * parts.get("days", 0) + parts["hours"]
    return 3600.0 * hours + 60.0 * parts["minutes"] + parts["seconds"]


class Dispatcher(ABC, Generic[Place]):
    """Pulls a request when a place is free, starts its run there, and hands over one record after the other.

    A place whose record is not handed over yet is not free. After `NOT_NOW`, requests are pulled again once all records
    that have come meanwhile are handed over.
    """

    def __init__(self, requests: Iterator[RunRequest]) -> None:
        self.requests = requests
        self.exhausted = self.told_to_wait = False
        self.held: RunRequest | None = None
        self.done: deque[tuple[Place, RunRecord]] = deque()

    @abstractmethod
    def free(self) -> Place | None:
        """Return a place where a run can start now."""

    @abstractmethod
    def submit(self, request: RunRequest, place: Place) -> None:
        """Start a run."""

    @abstractmethod
    def hear(self, *, wait: bool) -> None:
        """Put the runs that have ended into `done`; `wait` for news, but not for ever."""

    @abstractmethod
    def busy(self) -> bool:
        """Return whether a run is under way."""

    def changed(self) -> bool:
        """Return whether places may have gone while a request was pulled."""
        return False

    def no_more(self) -> None:
        """Note that there are no more requests."""

    def records(self) -> Iterator[RunRecord]:
        """Yield each record as its run ends, and keep all places busy until no request is left."""
        while True:
            while self.done:
                _, record = self.done.popleft()
                self._fill()
                yield record
            if self.told_to_wait:
                self.hear(wait=False)  # the requests may wait for what has come meanwhile
                if self.done:
                    continue
                self.told_to_wait = False
            self._fill()
            if self.exhausted and self.held is None and not self.busy() and not self.done:
                return
            self.hear(wait=True)

    def _fill(self) -> None:
        """Pull a request for each free place and start it there."""
        while (place := self.free()) is not None:
            if self.held is None:
                self.held = self._pulled()
                if self.held is None:
                    return
                if self.changed():
                    continue
            request, self.held = self.held, None
            self.submit(request, place)

    def _pulled(self) -> RunRequest | None:
        """Return the next request; None if there is none now, or there are no more."""
        if self.exhausted or self.told_to_wait:
            return None
        try:
            request = next(self.requests)
        except StopIteration:
            self.exhausted = True
            self.no_more()
            return None
        self.told_to_wait = request is NOT_NOW
        return None if self.told_to_wait else request
