"""A figure of the benchmark: a number, or the seconds of strandline and of another program, measured in turns."""

import resource
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

REPEATS = 7
Pair = tuple[float, float]


class NotMeasured(Exception):
    """The reason why a figure could not be measured; its text goes into the results."""


@dataclass(frozen=True)
class Figure:
    """A line of results.json, which leaves out what is as here by default: a task, and a case of it.

    `ours` and `peer` are median seconds, or values in another unit, after so many repeats; None if not measured. `cpu`
    are the seconds of all cores, ours and the peer's. The remark says where numbers come from, or why there are none.
    """

    what: str
    case: str = ""
    ours: float | None = None
    unit: str = "s"
    remark: str = ""
    peer_name: str = ""
    peer: float | None = None
    repeats: int = 0
    cpu: Pair | None = None
    part: str = ""

    @property
    def task(self) -> str:
        """The task with its case."""
        return ", ".join(filter(None, (self.what, self.case)))

    @property
    def ratio(self) -> float | None:
        """The peer's seconds divided by ours: above 1 if strandline is faster."""
        return None if self.ours is None or self.peer is None else self.peer / self.ours

    @property
    def ratio_per_core(self) -> float | None:
        """The same of the seconds of all cores."""
        return None if self.cpu is None else self.cpu[1] / self.cpu[0]


def compared(
    what: str,
    peer_name: str,
    ours: Callable[[], Any],
    peer: Callable[[], Any],
    *,
    rtol: float,
    atol: float = 1e-9,
    repeats: int = REPEATS,
) -> Figure:
    """Time both in turns, after a first call of each; the answers of these calls must agree."""
    np.testing.assert_allclose(ours(), peer(), rtol=rtol, atol=atol)
    return in_turns(what, peer_name, [(timed(ours), timed(peer)) for _ in range(repeats)])


def in_turns(
    what: str, peer_name: str, seconds: Sequence[Pair], *, cpu: Sequence[Pair] = (), case: str = "", remark: str = ""
) -> Figure:
    """Return the medians of seconds (ours, peer); `cpu` are the seconds of all cores together."""
    ours, peer = medians(seconds)
    cores = medians(cpu) if cpu else None
    return Figure(what, case, ours, "s", remark, peer_name, peer, len(seconds), cores)


def medians(pairs: Sequence[Pair]) -> Pair:
    """Return the median of each side of some pairs."""
    ours, peer = (statistics.median(column) for column in zip(*pairs, strict=True))
    return ours, peer


def timed(task: Callable[..., object], *arguments: object) -> float:
    """Return the seconds of a call."""
    begun = time.perf_counter()
    task(*arguments)
    return time.perf_counter() - begun


def peak_memory() -> float:
    """Return the peak memory of this process, MiB.

    Linux reports it since the start of the program; `getrusage` would include the process that started this one.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text("ascii").splitlines() if line.startswith("VmHWM:"))
        return float(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
