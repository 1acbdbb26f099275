"""Two programs on the same task, in turns, and the table of their times."""

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

REPEATS = 7


@dataclass(frozen=True)
class Comparison:
    """Median seconds of a task, by strandline and by another program."""

    what: str
    peer_name: str
    ours: float
    peer: float
    ratio: float
    repeats: int


def compare_all(*tasks: Callable[[], Comparison]) -> list[dict[str, Any]]:
    """Print each comparison as it is made; return them all."""
    print(f"{'task':<52} {'peer':<26} {'ours [ms]':>10} {'peer [ms]':>10} {'ratio':>7}")
    found = []
    for task in tasks:
        result = task()
        found.append(asdict(result))
        print(
            f"{result.what:<52} {result.peer_name:<26} {1e3 * result.ours:>10.3g} {1e3 * result.peer:>10.3g}"
            f" {result.ratio:>7.2f}",
            flush=True,
        )
    return found


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
    """Time both in turns, after a call of each whose answers must agree."""
    np.testing.assert_allclose(ours(), peer(), rtol=rtol, atol=atol)
    return summarised(what, peer_name, [(timed(ours), timed(peer)) for _ in range(repeats)])


def summarised(what: str, peer_name: str, seconds: list[tuple[float, float]]) -> Comparison:
    ours, peer = (statistics.median(column) for column in zip(*seconds, strict=True))
    return Comparison(what, peer_name, ours, peer, peer / ours, len(seconds))


def timed(task: Callable[[], object]) -> float:
    begun = time.perf_counter()
    task()
    return time.perf_counter() - begun
