"""Threads for work in parts, one thread for BLAS, JAX in double precision, and what functions compiled by it share.

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
from numpy.polynomial import Chebyshev, Polynomial
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
    pool = _pool(workers, os.getpid()) if workers > 1 else None
    if pool is None or pool.submit(double).result() != double():
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


_controller = cache(ThreadpoolController)


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
        remedy = 'Leave `with jax.enable_x64(False)`, or call jax.config.update("jax_enable_x64", True) first.'
        raise InvalidInput("precision of JAX", value="float32", expected="float64", remedy=remedy)


WIDEST = {"xla_cpu_prefer_vector_width": 512}
"""Option of `jax.jit`: 512-bit registers if the processor has them; the compiler's default is 256 bits."""
WHOLE = 1.5 * 2.0**52
"""Adding it to a number leaves the nearest integer in the last bits."""
_POWERS = Chebyshev.interpolate(np.exp2, 9, domain=[-0.5, 0.5]).convert(kind=Polynomial).coef
"""Coefficients of 2**t on |t| ≤ 1/2, with a relative error of 2e-14."""


def exp2_of_minus(x: Any, whole: Any, *, bounded: bool) -> Any:
    """Return 2**-x for x above -1000 with a relative error of 2e-14, in half the time of `jnp.exp2`.

    `whole` is `WHOLE`, passed in so that the compiler cannot cancel it. If not all values are below 1000 (`bounded`),
    the result is below 1e-270 wherever it should be smaller.
    """
    from jax import lax

    x = x if bounded else lax.min(x, 900.0)
    shifted = whole - x
    return assembled((whole - shifted) - x, shifted)


def assembled(share: Any, shifted: Any) -> Any:
    """Return 2**(share + n) for shares in [-1/2, 1/2]; `shifted` is `WHOLE` + n for integers n."""
    from jax import lax

    power = _POWERS[-1]
    for coefficient in _POWERS[-2::-1]:
        power = power * share + coefficient
    bits = lax.bitcast_convert_type(shifted, np.dtype(np.int64)) << 52
    return lax.bitcast_convert_type(lax.bitcast_convert_type(power, np.dtype(np.int64)) + bits, np.dtype(np.float64))
