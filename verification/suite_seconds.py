"""Where the seconds of the tests go, by kind, by file and by fixture.

    python -m pytest -p verification.suite_seconds [OPTIONS OF PYTEST ...]

Kinds: JAX compiles, the built-in model solves, started programs compute, the test waits (for them, or for the other
processes of this machine), the rest.
"""

import os
import time
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import pytest

KINDS = ("compile", "solve", "programs", "waiting", "rest")
COMPILING = "/jax/core/compile/"
NAME = "strandline seconds"
MOST = 30
"""Most rows of a table."""


class Seconds:
    """Plugin of pytest: measures where the tests run, prints tables where they are reported."""

    def __init__(self) -> None:
        self.inside: dict[str, float] = defaultdict(float)
        self.fixtures: dict[str, float] = {}
        self.files: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
        self.shared: dict[str, list[float]] = defaultdict(list)

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
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
        """Time a fixture, with those that it needs and makes first."""
        begun = time.perf_counter()
        try:
            return (yield)
        finally:
            self.fixtures[f"{fixturedef.baseid}::{fixturedef.argname}"] = time.perf_counter() - begun

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Time a test with its fixtures."""
        self.inside.clear()
        self.fixtures.clear()
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
            report.user_properties.append((NAME, (parts, dict(self.fixtures))))
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Collect what was measured."""
        for parts, fixtures in (value for name, value in report.user_properties if name == NAME):
            total = self.files[report.location[0]]
            total["cases"] += 1
            for kind, seconds in parts.items():
                total[kind] += seconds
            for name, seconds in fixtures.items():
                self.shared[name].append(seconds)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the tables."""
        line = terminalreporter.write_line
        rows = {name: {kind: one[kind] for kind in ("cases", *KINDS)} for name, one in self.files.items()}
        rows = {"all": {kind: sum(one[kind] for one in rows.values()) for kind in ("cases", *KINDS)}, **rows}
        ranked = sorted(rows.items(), key=lambda row: -sum(row[1][kind] for kind in KINDS if kind != "waiting"))
        line(f"{'seconds by file':60}{'cases':>8}" + "".join(f"{kind:>10}" for kind in KINDS))
        for name, row in ranked[:MOST]:
            line(f"{name:60}{row['cases']:8.0f}" + "".join(f"{row[kind]:10.1f}" for kind in KINDS))
        line(f"{'seconds by fixture':60}{'times':>8}{'all':>10}")
        for name, seconds in sorted(self.shared.items(), key=lambda row: -sum(row[1]))[:MOST]:
            line(f"{name:60}{len(seconds):8}{sum(seconds):10.1f}")


def pytest_configure(config: pytest.Config) -> None:
    """Measure in the processes of a run, too: each loads this module as a plugin."""
    config.pluginmanager.register(Seconds())
