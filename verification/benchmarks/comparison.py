"""Two programs on the same task, in turns, and the table of their times."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

REPEATS = 7


class NotMeasured(Exception):
    """The reason why a figure could not be measured; its text goes into the results."""


@dataclass(frozen=True)
class Comparison:
    """Median seconds of a task, by strandline and by another program; None with a remark if not measured.

    `case` distinguishes this line from others of the same task. The seconds of all cores together are given if both
    programs ran in their own processes.
    """

    what: str
    peer_name: str
    ours: float | None
    peer: float | None
    ratio: float | None
    repeats: int
    case: str = ""
    remark: str = ""
    cpu_ours: float | None = None
    cpu_peer: float | None = None


def compare_all(*tasks: Callable[[], Comparison]) -> list[dict[str, Any]]:
    """Print each comparison as it is made; return them all."""
    print(f"{'task':<52} {'peer':<30} {'ours [ms]':>10} {'peer [ms]':>10} {'ratio':>7}")
    found = []
    for task in tasks:
        result = task()
        found.append(asdict(result))
        print(line(result), flush=True)
    return found


def line(result: Comparison) -> str:
    what = f"{result.what}, {result.case}" if result.case else result.what
    if result.ours is None or result.peer is None or result.ratio is None:
        return f"{what:<52} {result.peer_name:<30} {result.remark}"
    times = f"{1e3 * result.ours:>10.4g} {1e3 * result.peer:>10.4g} {result.ratio:>7.2f}"
    return f"{what:<52} {result.peer_name:<30} {times}"


def compared(
    what: str,
    peer_name: str,
    ours: Callable[[], Any],
    peer: Callable[[], Any],
    *,
    rtol: float,
    atol: float = 1e-9,
    repeats: int = REPEATS,
) -> Comparison:
    """Time both in turns, after a first call of each; the answers of these calls must agree."""
    np.testing.assert_allclose(ours(), peer(), rtol=rtol, atol=atol)
    return summarised(what, peer_name, [(timed(ours), timed(peer)) for _ in range(repeats)])


def summarised(
    what: str,
    peer_name: str,
    seconds: Sequence[tuple[float, float]],
    *,
    cpu: Sequence[tuple[float, float]] | None = None,
    case: str = "",
    remark: str = "",
) -> Comparison:
    """Return medians of (ours, peer); `cpu` are the seconds of all cores together."""
    ours, peer = medians(seconds)
    cores = medians(cpu) if cpu else (None, None)
    return Comparison(what, peer_name, ours, peer, peer / ours, len(seconds), case, remark, *cores)


def unmeasured(what: str, peer_name: str, why: object, *, case: str = "") -> Comparison:
    return Comparison(what, peer_name, None, None, None, 0, case, f"not measured: {why}")


def medians(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    ours, peer = (statistics.median(column) for column in zip(*pairs, strict=True))
    return ours, peer


def timed(task: Callable[[], object]) -> float:
    begun = time.perf_counter()
    task()
    return time.perf_counter() - begun
