"""Where the seconds of the tests go, by file: ``python -m verification.suite_seconds [OPTIONS OF PYTEST ...]``.

Kinds: JAX compiles, the built-in model solves, started programs compute, the test waits (for them, or for the other
processes of this machine), the rest. Fixtures count to the test that makes them; ``--durations`` lists them.
"""

import os
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import Any

import pytest

KINDS = ("compile", "solve", "programs", "waiting", "rest")
COMPILING = "/jax/core/compile/"
NAME = "strandline seconds"
MOST = 30


class Seconds:
    """Plugin of pytest: measures where the tests run, prints a table where they are reported."""

    def __init__(self) -> None:
        self.inside: Counter[str] = Counter()
        self.files: dict[str, Counter[str]] = defaultdict(Counter)

    def pytest_sessionstart(self) -> None:
        """Listen to JAX, and time the runs of the built-in model."""
        from jax import monitoring

        from strandline.models.biofilm.model import Biofilm

        def compiled(event: str, seconds: float, **_: Any) -> None:
            if event.startswith(COMPILING):
                self.inside["compile"] += seconds

        def timed(model: Biofilm, *given: Any, **options: Any) -> Any:
            begun = time.perf_counter()
            try:
                return solve(model, *given, **options)
            finally:
                self.inside["solve"] += time.perf_counter() - begun

        solve = Biofilm.__call__
        Biofilm.__call__ = timed  # type: ignore[method-assign]
        monitoring.register_event_duration_secs_listener(compiled)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Time a test with its fixtures."""
        self.inside.clear()
        self.begun = time.perf_counter(), os.times()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
        """Send what was measured to where it is printed."""
        report = yield
        if report.when == "teardown":
            begun, used = self.begun
            wall, now = time.perf_counter() - begun, os.times()
            own = now.user - used.user + now.system - used.system
            programs = now.children_user - used.children_user + now.children_system - used.children_system
            parts = {**self.inside, "programs": programs, "waiting": max(wall - own - programs, 0.0)}
            parts["rest"] = max(own - self.inside["compile"] - self.inside["solve"], 0.0)
            report.user_properties.append((NAME, parts))
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Collect what was measured."""
        for parts in (value for name, value in report.user_properties if name == NAME):
            for name in (report.location[0], "all"):
                self.files[name].update({"cases": 1, **parts})

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the table, with the files that compute longest first."""
        line, columns = terminalreporter.write_line, ("cases", *KINDS)
        ranked = sorted(self.files.items(), key=lambda row: -sum(row[1][kind] for kind in KINDS if kind != "waiting"))
        line(f"{'seconds by file':60}" + "".join(f"{name:>10}" for name in columns))
        for name, row in ranked[:MOST]:
            line(f"{name:60}" + "".join(f"{row[column]:10.1f}" for column in columns))


def pytest_configure(config: pytest.Config) -> None:
    """Measure in the processes of a run, too: each loads this module as a plugin."""
    config.pluginmanager.register(Seconds())


if __name__ == "__main__":
    sys.exit(pytest.main(["-p", "verification.suite_seconds", *sys.argv[1:]]))
