"""Suppress what a compiled library prints."""

import contextlib
import ctypes
import os
from collections.abc import Iterator
from functools import cache
from typing import Any

__all__ = ["without_prints"]

STANDARD_OUTPUT = 1


@contextlib.contextmanager
def without_prints() -> Iterator[None]:
    """Discard what this process writes to standard output, even outside Python.

    The C library buffers its prints, so they are flushed before and after. If standard output is closed, or the
    system is not POSIX, this does nothing.
    """
    library = _c_library()
    try:
        kept = None if library is None else os.dup(STANDARD_OUTPUT)
    except OSError:
        kept = None
    if library is None or kept is None:
        yield
        return
    library.fflush(None)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, STANDARD_OUTPUT)
    os.close(nowhere)
    try:
        yield
    finally:
        library.fflush(None)
        os.dup2(kept, STANDARD_OUTPUT)
        os.close(kept)


@cache
def _c_library() -> Any:
    """Return the C library of this process; None if there is none."""
    try:
        return ctypes.CDLL(None) if os.name == "posix" else None
    except OSError:
        return None
