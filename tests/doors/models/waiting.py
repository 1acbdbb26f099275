"""Waiting for what another thread or process does."""

import time
from collections.abc import Callable


def until(happened: Callable[[], bool], patience: float = 30.0) -> None:
    """Wait until something has happened."""
    deadline = time.monotonic() + patience
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.02)
