"""One mutant against tests, in a copy of the process that has already imported the libraries."""

import contextlib
import importlib
import os
import re
import signal
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

LIBRARIES = (
    "pytest", "hypothesis", "jax.numpy", "jax.scipy.special", "scipy.optimize", "scipy.stats", "scipy.spatial",
    "scipy.interpolate", "xarray", "pandas", "matplotlib.pyplot", "matplotlib.backends._backend_pdf_ps", "beartype",
    "jaxtyping", "pydantic", "rich", "click", "yaml", "jinja2", "skimage", "shapely", "h5netcdf", "arviz",
    "coverage",
)  # fmt: skip
NO_REWRITE = "ignore::pytest.PytestAssertRewriteWarning"
OPTIONS = ("-q", "-x", "-rf", "-m", "not long", "-p", "no:cacheprovider", "-W", NO_REWRITE)


@dataclass(frozen=True)
class Outcome:
    """What tests made of a mutant: which one failed, if any, or that they could not begin, or took too long."""

    end: Literal["passed", "failed", "broke", "hung"]
    test: str
    seconds: float


def prepare() -> None:
    """Import what tests need, but nothing of strandline."""
    importlib.import_module("tests.conftest")  # settings that JAX reads at its import
    for name in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def tried(package: Path, tests: Sequence[str], output: Path, limit: float) -> Outcome:
    """Return what tests make of a changed package, in a fork of this process that may take `limit` seconds.

    `package` is the folder that contains it; pytest prints into the file `output`.
    """

    def run() -> int:
        sys.path.insert(0, str(package))
        os.environ["PYTHONPATH"] = str(package)
        return run_tests(tests)

    return forked(run, output, limit)


def run_tests(tests: Sequence[str], plugins: Sequence[object] = ()) -> int:
    """Return pytest's exit code, 0 if there is no test."""
    import pytest

    code = pytest.main([*OPTIONS, *tests], plugins=list(plugins))
    return 0 if code == pytest.ExitCode.NO_TESTS_COLLECTED else int(code)


def forked(run: Callable[[], int], output: Path, limit: float) -> Outcome:
    """Return how a function that runs tests, and returns pytest's exit code, ends in a fork of this process."""
    start = time.monotonic()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # JAX warns of its threads; it has not started any
        child = os.fork()
    if not child:
        _run_and_exit(run, output)
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        seconds = time.monotonic() - start
        if ended:
            break
        if seconds > limit:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return Outcome("hung", "", seconds)
        time.sleep(0.05)
    code, text = os.waitstatus_to_exitcode(status), output.read_text("utf-8", errors="replace")
    if code == 0:
        return Outcome("passed", "", seconds)
    failed = re.search(r"^FAILED (\S+)", text, re.MULTILINE)
    return Outcome("failed" if failed else "broke", failed[1] if failed else "", seconds)


def _run_and_exit(run: Callable[[], int], output: Path) -> None:
    code = 70
    try:
        os.setsid()
        with output.open("w") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        code = run()
        sys.stdout.flush()
    finally:
        os._exit(code)
