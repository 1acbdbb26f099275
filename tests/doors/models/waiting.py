"""Waiting for what another thread or process does."""

import time


def until(happened, patience=60.0):
    deadline = time.monotonic() + patience
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.02)
