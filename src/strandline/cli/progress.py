"""Progress: bars on a terminal, plain lines elsewhere."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from strandline.calibration import Observer
from strandline.design.active import BatchReport
from strandline.runs import Progress as Runs
from strandline.runs import RunRecord
from strandline.smc import StepInfo

__all__ = ["observing"]

STAGES = {
    "observation": "observation",
    "forward": "forward runs",
    "draws": "runs at draws",
    "surrogate": "surrogate",
    "refinement": "draws for a round",
    "choice": "next batch",
    "sampling": "sampling",
    "cut": "cut reading",
    "check": "checks",
    "replicates": "replicates",
    "candidates": "runs of candidates",
    "gains": "information gains",
    "alternatives": "alternatives",
    "specimens": "specimens",
    "population": "population",
    "report": "figures and report",
}
SECONDS_BETWEEN_LINES = 15.0


@contextmanager
def observing(*, quiet: bool = False) -> Iterator[Observer]:
    """Yield an observer that shows the progress of the study on standard error, nothing if `quiet`."""
    console = Console(stderr=True)
    if quiet:
        yield Observer()
    elif console.is_terminal:
        with _bars(console) as bars:
            yield bars
    else:
        yield _lines(console)


@contextmanager
def _bars(console: Console) -> Iterator[Observer]:
    columns = (
        SpinnerColumn(finished_text="✓"),
        TextColumn("{task.description:<18}"),
        BarColumn(bar_width=12),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:
        tasks: list[TaskID] = []

        def end_stage() -> None:
            for task in tasks[-1:]:
                progress.update(task, total=1, completed=1)

        def stage(name: str) -> None:
            end_stage()
            tasks.append(progress.add_task(STAGES.get(name, name), total=None, note=""))

        def run(record: RunRecord, state: Runs) -> None:
            progress.update(tasks[-1], total=state.total, completed=state.finished, note=_run_note(state))

        def step(info: StepInfo) -> None:
            progress.update(tasks[-1], total=1.0, completed=float(info.temperature), note=_step_note(info))

        def part(state: Runs) -> None:
            progress.update(tasks[-1], total=state.total, completed=state.finished, note=_part_note(state))

        def batch(report: BatchReport) -> None:
            _say(progress.console, report.line)

        def note(text: str) -> None:
            _say(progress.console, text)

        yield Observer(stage=stage, run=run, step=step, part=part, batch=batch, note=note)
        end_stage()


def _lines(console: Console) -> Observer:
    last, current = [time.monotonic()], [""]

    def say(text: str) -> None:
        _say(console, text)

    def stage(name: str) -> None:
        last[0], current[0] = time.monotonic(), name
        say(f"{STAGES.get(name, name)} …")

    def due(finished: bool) -> bool:
        if not finished and time.monotonic() - last[0] < SECONDS_BETWEEN_LINES:
            return False
        last[0] = time.monotonic()
        return True

    def run(record: RunRecord, state: Runs) -> None:
        if due(state.finished == state.total):
            say(f"  {state.finished}/{state.total} {_run_note(state)}")

    def step(info: StepInfo) -> None:
        if due(current[0] == "sampling" and float(info.temperature) >= 1.0):
            say(f"  {_step_note(info)}")

    def part(state: Runs) -> None:
        if due(state.finished == state.total):
            say(f"  {_part_note(state)}")

    def batch(report: BatchReport) -> None:
        say(f"  {report.line}")

    return Observer(stage=stage, run=run, step=step, part=part, batch=batch, note=say)


def _say(console: Console, text: str) -> None:
    console.print(text, highlight=False, soft_wrap=True, markup=False)


def _run_note(state: Runs) -> str:
    return f"{state.ok} ok, {state.failed} failed{_left(state)}"


def _part_note(state: Runs) -> str:
    return f"{state.finished} of {state.total}{_left(state)}"


def _left(state: Runs) -> str:
    remaining = state.remaining_seconds
    return "" if remaining is None or state.finished == state.total else f", {_duration(remaining)} left"


def _step_note(info: StepInfo) -> str:
    return f"γ {info.temperature:.4f}, ESS {info.ess:.0f}, accepted {info.acceptance:.0%}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
