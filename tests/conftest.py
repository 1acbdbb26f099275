"""Shared by all tests: double precision, a picture backend without a screen, one thread a process, Ctrl-C as usual."""

import os
import signal
import threading

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# A background job of a shell ignores Ctrl-C and hands that down to the programs that the tests interrupt.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)

import jax

jax.config.update("jax_enable_x64", True)
