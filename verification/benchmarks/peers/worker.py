"""The part that the programs of all peers share: a task from a file, done on request and timed in its own process.

A program is called with the path of an .npz as its last argument. It writes one JSON object per line: ``{"ready":
versions}`` after a first, unmeasured answer, then for each line that it reads ``{"wall": s, "cpu": s, "answer":
[...]}``, until its input ends. The environment variable PEER_CORES limits its number of cores. It needs NumPy and knows
nothing about strandline.
"""

import json
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from typing import Any

CORES = "PEER_CORES"

Task = Callable[[], Sequence[float]]


def serve(packages: Sequence[str], prepare: Callable[[Mapping[str, Any]], Task]) -> None:
    """Answer requests; `prepare` imports the packages, after the cores are limited."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # keep what libraries print out of the replies
    limit_cores(int(os.environ.get(CORES, "1")))
    import numpy as np

    with np.load(sys.argv[-1]) as content:
        task = prepare(dict(content))
    task()
    say(replies, ready={package: metadata.version(package) for package in packages})
    for _ in sys.stdin:
        wall, cpu = time.perf_counter(), time.process_time()
        answer = task()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        say(replies, wall=wall, cpu=cpu, answer=[float(value) for value in answer])


def limit_cores(number: int) -> None:
    """Keep this process and the threads of its libraries on `number` cores, if the system allows it."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:number])


def say(stream: Any, **content: object) -> None:
    """Write one object on a line."""
    stream.write(json.dumps(content) + "\n")
    stream.flush()
