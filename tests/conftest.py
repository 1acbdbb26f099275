"""Shared by all tests: double precision, a picture backend without a screen, one thread a process, signals as usual.

JAX keeps what it compiles for the other processes of a run and for the next run. A cache of bounded size is written
under a lock; without the bound, another process could read half a file.
"""

import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Generator, Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
# JAX reads these at its import, which not every test needs.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "compiled"))
os.environ |= {
    "JAX_ENABLE_X64": "true",
    "JAX_COMPILATION_CACHE_MAX_SIZE": str(2**31),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.02",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}

# A background job ignores Ctrl-C, and a job under nohup ignores SIGHUP; the programs that they start inherit this.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

import hypothesis
import pytest

TIERS = ("study", "doors", "statistical", "unit", "check")
"""Folders of tests, slowest files first: the quick ones come last, so that all processes finish together."""
OPTIONAL = {
    "arviz", "axe_playwright_python", "blackjax", "cryptography", "dask", "dask_jobqueue", "distributed", "httpx",
    "ipykernel", "meshio", "nbclient", "nbformat", "playwright", "shapely", "skimage", "sklearn", "tifffile",
    "tornado", "umbridge",
}  # fmt: skip
"""Packages of extras, and those that tests alone need."""


def pytest_xdist_auto_num_workers() -> int:
    """Return the number of processes for ``-n auto``: one above the cores, for many tests wait for simulators."""
    return 1 + (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


def pytest_configure(config: pytest.Config) -> None:
    """Draw the same examples each time in `make test`, others each time in `make test-all`.

    Short tests compile more than they compute: without optimising, XLA compiles in four fifths of the time.

    ArviZ warns at its first import of a day, which it notes in a file: processes that do so together get in each
    other's way, and the warning would be an error.
    """
    if "not long" in config.getoption("markexpr"):
        unoptimised = "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
        os.environ.setdefault("XLA_FLAGS", unoptimised)
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        with warnings.catch_warnings(action="ignore"), suppress(ImportError):
            import arviz  # noqa: F401
    hypothesis.settings.register_profile("other", deadline=None)  # a test must not fail for other work on the machine
    hypothesis.settings.register_profile("same", derandomize=True, deadline=None)
    hypothesis.settings.load_profile("same" if "not long" in config.getoption("markexpr") else "other")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the doors; put the slow tiers first, where several processes share the tests by file."""
    doors = Path(__file__).parent / "doors"
    for item in items:
        if item.path.is_relative_to(doors):
            item.add_marker("doors")
    if config.getoption("dist", "no") != "loadfile":
        return
    rank = {folder: k for k, folder in enumerate(TIERS)}
    tests = Path(__file__).parent
    items.sort(key=lambda item: rank.get(item.path.relative_to(tests).parts[0], len(rank)))


def needed(report: pytest.CollectReport | pytest.TestReport) -> str | None:
    """Return the package of an extra that is not installed, if that is why something failed.

    Only errors and what was printed count: the lines of the test itself may name an extra too.
    """
    errors = [line for line in str(report.longrepr).splitlines() if line.startswith("E ")]
    said = "\n".join([*errors, *(text for _, text in report.sections)])
    absent = [name for name in sorted(OPTIONAL) if find_spec(name) is None]
    if absent and re.search(r"pip install .strandline\[", said):  # as strandline itself says it
        return ", ".join(absent)
    return next((name for name in re.findall(r"No module named '(\w+)", said) if name in absent), None)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Skip a file that needs a package of an extra that is not installed."""
    report = yield
    if report.failed and (name := needed(report)):
        report.outcome, report.longrepr = "skipped", (str(collector.path), 0, f"Skipped: needs the package {name}")
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Skip a test that needs a package of an extra that is not installed."""
    report = yield
    if report.failed and (name := needed(report)):
        report.outcome, report.longrepr = "skipped", (str(item.path), 0, f"Skipped: needs the package {name}")
    return report


def pytest_collection_finish(session: pytest.Session) -> None:
    """Leave the programs that tests start to choose their precision themselves."""
    os.environ.pop("JAX_ENABLE_X64", None)


@pytest.fixture(autouse=True)
def _written_modules_go_with_their_test(request: pytest.FixtureRequest) -> Iterator[None]:
    """Forget what a test imported from its own folder: another test may write a module of the same name."""
    written = str(request.getfixturevalue("tmp_path")) if "tmp_path" in request.fixturenames else None
    yield
    if written is None:
        return
    for name, module in list(sys.modules.items()):
        if (getattr(module, "__file__", None) or "").startswith(written):
            del sys.modules[name]
