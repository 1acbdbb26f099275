"""Threads for work in parts, one thread for BLAS, and JAX in double precision.

Threads compute at the same time because NumPy and compiled functions release the interpreter lock. Their number is
``OMP_NUM_THREADS``, which limits BLAS as well; by default, it is the number of cores of the process.
"""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import cache, lru_cache
from typing import Any, TypeVar

import numpy as np
from threadpoolctl import ThreadpoolController

from strandline.foundations.errors import InvalidInput

Part = TypeVar("Part")
Result = TypeVar("Result")


def side_by_side(task: Callable[[Part], Result], parts: Iterable[Part]) -> Iterator[Result]:
    """Yield the result of `task` for each part, in order; at most two parts per thread are drawn ahead.

    The result of a part does not depend on the number of threads, as long as the parts do not. Tasks may call compiled
    functions: if JAX's float64 is enabled for the calling thread only, that thread does all the work. A task must not
    call this function itself.
    """
    workers = threads()
    if workers == 1:
        yield from map(task, parts)
        return
    pool = _pool(workers, os.getpid())
    if pool.submit(double).result() != double():
        yield from map(task, parts)
        return
    waiting: deque[Future[Result]] = deque()
    try:
        for part in parts:
            waiting.append(pool.submit(task, part))
            if len(waiting) == 2 * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


@lru_cache(maxsize=4)
def _pool(workers: int, process: int) -> ThreadPoolExecutor:
    """Return the threads of this process; they are reused, since each new thread would hold on to memory it freed."""
    return ThreadPoolExecutor(workers, thread_name_prefix=f"strandline-{process}")


def double() -> bool:
    """Return whether JAX computes in float64, in this thread."""
    import jax.numpy as jnp

    return bool(jnp.zeros(()).dtype == np.float64)


def threads() -> int:
    """Return the number of threads to use."""
    limit = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    if limit.isdigit() and int(limit) > 0:
        return int(limit)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def one_thread() -> AbstractContextManager[Any]:
    """Return a context in which BLAS computes on one thread."""
    return _controller().limit(limits=1)  # type: ignore[no-any-return]


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


def use_double() -> None:
    """Switch JAX to double precision for the whole process, unless it already uses it.

    Raises:
        InvalidInput: JAX stays in single precision, for example inside ``with jax.enable_x64(False)``.
    """
    import jax

    if double():
        return
    jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]
    if not double():
        raise InvalidInput(
            "precision of JAX",
            value="float32",
            expected="float64",
            remedy='Leave `with jax.enable_x64(False)`, or call jax.config.update("jax_enable_x64", True) first.',
        )
