"""Shared by all tests: double precision, a picture backend without a screen, one thread a process, signals as usual.

JAX keeps what it compiles, so that the same program of another test is not compiled again. All processes of a run share
one folder, which goes with the first of them. A cache of bounded size is written under a lock; without the bound,
another process could read half a file.
"""

import atexit
import io
import os
import shutil
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# A background job ignores Ctrl-C, and a job under nohup ignores SIGHUP; the programs that they start inherit this.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

import hypothesis
import jax
import pytest
from _pytest.runner import runtestprotocol
from matplotlib.backends import _backend_pdf_ps

SLOW_FIRST = ("studies", "calibration", "runs", "cli", "report", "docs", "design", "smc", "models")
"""Folders with slow tests, slowest first: the quick ones come last, so that all processes finish together."""
FRAME = 1 << 16
"""Values: half a megabyte, of a piece of one."""
DEJAVU_ASCII = range(3, 98)
"""Glyphs of the letters that most figures have, in the font that Matplotlib brings."""


def _remove(folder: str, owner: int) -> None:
    """Remove the folder at the end of the process that made it; a fork of it comes here too."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


if "STRANDLINE_TEST_COMPILED" not in os.environ:
    os.environ["STRANDLINE_TEST_COMPILED"] = tempfile.mkdtemp(prefix="strandline-compiled-")
    atexit.register(_remove, os.environ["STRANDLINE_TEST_COMPILED"], os.getpid())
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", os.environ["STRANDLINE_TEST_COMPILED"])
jax.config.update("jax_compilation_cache_max_size", 2**32)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.02)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def pytest_xdist_auto_num_workers() -> int:
    """Return the number of processes for ``-n auto``: one above the cores, for many tests wait for simulators."""
    return 1 + (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


def pytest_configure(config: pytest.Config) -> None:
    """Draw the same examples each time in `make test`, others each time in `make test-all`.

    ArviZ warns at its first import of a day, which it notes in a file: processes that do so together get in each
    other's way, and the warning would be an error.
    """
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        with warnings.catch_warnings(action="ignore"):
            import arviz  # noqa: F401
    hypothesis.settings.register_profile("other", deadline=None)  # a test must not fail for other work on the machine
    hypothesis.settings.register_profile("same", derandomize=True, deadline=None)
    hypothesis.settings.load_profile("same" if config.getoption("markexpr") == "not long" else "other")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put the tests of slow folders first, where several processes share the tests by file."""
    if config.getoption("dist", "no") != "loadfile":
        return
    rank = {folder: k for k, folder in enumerate(SLOW_FIRST)}
    tests = Path(__file__).parent
    items.sort(key=lambda item: rank.get(item.path.relative_to(tests).parts[0], len(rank)))


def _in_one_piece(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Run a test in a frame so large that those of all its calls fit into the same piece of memory.

    Python 3.11 takes memory for frames in pieces of 16 KB and gives each back when its first frame ends. A test that
    makes its calls across such a border would ask the system for a piece and give it back for every call.
    """
    runtestprotocol(item, nextitem=nextitem)


_in_one_piece.__code__ = _in_one_piece.__code__.replace(co_stacksize=FRAME)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool:
    """Run a test as pytest does."""
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    _in_one_piece(item, nextitem)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


@pytest.fixture(scope="session", autouse=True)
def _subsets_of_fonts_made_once() -> Iterator[None]:
    """Embed the same letters in most PDFs: cutting a font to those of each figure takes a third of a small study."""
    cut, written = _backend_pdf_ps.get_glyphs_subset, _backend_pdf_ps.font_as_file

    @cache
    def made(font: Any, glyphs: frozenset[int]) -> tuple[bytes, dict[int, int]]:
        with cut(font, glyphs) as found:
            return written(found.font).getvalue(), found.glyph_index_map

    def kept(font: Any, glyphs: Iterable[int]) -> Any:
        usual = DEJAVU_ASCII if "DejaVuSans" in os.fspath(font) else ()
        data, numbers = made(font, frozenset([*glyphs, *usual]))
        return nullcontext(SimpleNamespace(font=data, glyph_index_map=numbers))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_backend_pdf_ps, "get_glyphs_subset", kept)
        patch.setattr(_backend_pdf_ps, "font_as_file", io.BytesIO)
        yield


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium without a window; a test that asks for it is skipped where it or Playwright is missing."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs the package playwright")
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("needs Chromium")
    with playwright.sync_playwright() as started:
        launched = started.chromium.launch(executable_path=chromium)
        yield launched
        launched.close()


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


@pytest.fixture(scope="session", autouse=True)
def _coarse_misfit() -> Iterator[None]:
    """Judge the fit from few runs and draws: every calibration does it."""
    with pytest.MonkeyPatch.context() as patch:
        few = {"prediction.MOST_RUNS": 16, "reference.DRAWS": 400, "reference.PER_PART": 0, "predictive.DRAWS": 32}
        for place, value in few.items():
            patch.setattr(f"strandline.calibration.misfit.{place}", value)
        yield


@pytest.fixture(scope="session", autouse=True)
def _coarse_pictures() -> Iterator[None]:
    """Draw pictures of reports at a fifth of the dots: 300 an inch take as long as the rest of a small study."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.report.page.DOTS_PER_INCH", 60)
        yield


@pytest.fixture
def without_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out figures and page: they take most of the time of a small study."""

    def write_report(calibration: Any, summary: Any, *, folder: Path, **others: Any) -> Path:
        return folder / "report.html"

    monkeypatch.setattr("strandline.studies.run.write_report", write_report)
