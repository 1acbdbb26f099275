"""Progress: bars on a terminal, plain lines elsewhere; with `--verbose` also each run, step and setting."""

import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, TextIO

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from strandline.calibration import STAGES, Observer, part_note, run_note, step_note
from strandline.calibration import Settings as Stated
from strandline.foundations import inputs_text
from strandline.runs import Executor, RunRecord, told_folder
from strandline.runs import Progress as Runs
from strandline.runs import note as journal_note
from strandline.smc import StepInfo
from strandline.studies import Study

SECONDS_BETWEEN_LINES = 15.0


@contextmanager
def observing(
    *,
    quiet: bool = False,
    log: TextIO | None = None,
    details: Callable[[Callable[[str], None]], Observer] | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Observer]:
    """Yield an observer that shows the progress of the study on standard error, nothing if `quiet`.

    The `log` gets a line with its time for each step. `details` takes a function that shows a line, and returns an
    observer that adds its lines to all that is shown and logged. `clock` returns the seconds since some time.
    """
    console = Console(stderr=True)
    with ExitStack() as opened:
        if quiet:
            shown = Observer()
        elif console.is_terminal:
            shown = opened.enter_context(_bars(console))
        else:
            shown = _lines(partial(_say, console), clock)
        if log is not None:
            shown = _both(shown, _lines(_adding_to(log), clock))
        yield shown if details is None else _both(shown, details(shown.note))


def _adding_to(log: TextIO) -> Callable[[str], None]:
    """Return a function that adds a line to a log, after the time."""
    handler = logging.StreamHandler(log)
    handler.setFormatter(logging.Formatter("%(asctime)s %(message)s", "%Y-%m-%d %H:%M:%S"))

    def add(text: str) -> None:
        handler.handle(logging.makeLogRecord({"msg": text}))

    return add


def _both(first: Observer, second: Observer) -> Observer:
    def of(name: str) -> Callable[..., None]:
        def tell(*given: object) -> None:
            getattr(first, name)(*given)
            getattr(second, name)(*given)

        return tell

    return Observer(**{one.name: of(one.name) for one in fields(Observer)})


@contextmanager
def _bars(console: Console) -> Iterator[Observer]:
    name, words = TextColumn("{task.description:<18}"), TextColumn("{task.fields[note]}")
    columns = SpinnerColumn(finished_text="✓"), name, BarColumn(bar_width=12), words, TimeElapsedColumn()
    with Progress(*columns, console=console) as progress:
        tasks: list[TaskID] = []

        def end_stage() -> None:
            for task in tasks[-1:]:
                progress.update(task, total=1, completed=1)

        def stage(name: str) -> None:
            end_stage()
            tasks.append(progress.add_task(STAGES.get(name, name), total=None, note=""))

        def run(record: RunRecord, state: Runs) -> None:
            progress.update(tasks[-1], total=state.total, completed=state.finished, note=run_note(state))

        def step(info: StepInfo) -> None:
            progress.update(tasks[-1], total=1.0, completed=float(info.temperature), note=step_note(info))

        def part(state: Runs) -> None:
            progress.update(tasks[-1], total=state.total, completed=state.finished, note=part_note(state))

        say = partial(_say, progress.console)
        yield Observer(stage=stage, run=run, step=step, part=part, batch=lambda report: say(report.line), note=say)
        end_stage()


def _lines(say: Callable[[str], None], clock: Callable[[], float]) -> Observer:
    last, current = [clock()], [""]

    def stage(name: str) -> None:
        last[0], current[0] = clock(), name
        say(f"{STAGES.get(name, name)} …")

    def due(finished: bool) -> bool:
        if not finished and clock() - last[0] < SECONDS_BETWEEN_LINES:
            return False
        last[0] = clock()
        return True

    def run(record: RunRecord, state: Runs) -> None:
        if due(state.waiting or state.finished == state.total):
            say(f"  {state.finished}/{state.total} {run_note(state)}")

    def step(info: StepInfo) -> None:
        if due(current[0] == "sampling" and float(info.temperature) >= 1.0):
            say(f"  {step_note(info)}")

    def part(state: Runs) -> None:
        if due(state.finished == state.total):
            say(f"  {part_note(state)}")

    return Observer(stage=stage, run=run, step=step, part=part, batch=lambda report: say(f"  {report.line}"), note=say)


def _say(console: Console, text: str) -> None:
    console.print(text, highlight=False, soft_wrap=True, markup=False)


KEY = 12
"""Characters of a run's key, as in the names of the folders that are kept."""


def detailed(study: Study, executor: Executor, say: Callable[[str], None]) -> Observer:
    """Return an observer that says what the progress leaves out, a line at a time."""
    settings = _settings(study.settings, executor)

    def stage(name: str) -> None:
        if name in settings:
            say(f"  {settings.pop(name)}")

    def run(record: RunRecord, state: Runs) -> None:
        for line in _run_lines(record, study.folder / "runs"):
            say(f"  {line}")

    def step(info: StepInfo) -> None:
        say(f"  step to tempering exponent {info.temperature:.4f}: ESS {info.ess:.0f}, accepted {info.acceptance:.0%}")

    return Observer(stage=stage, run=run, step=step)


def set_aside_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return a line for each run that ended ok and was not used, with the reason."""
    return [f"  run {one['key'][:KEY]} set aside ({one['kind']}): {one['why']}" for one in summary["set_aside"]]


def _run_lines(record: RunRecord, kept: Path) -> list[str]:
    inputs = inputs_text(record.inputs)
    state = record.state if record.ok else f"{record.state} ({record.failure_kind})"
    folders = sorted(kept.glob(f"{record.key[:KEY]}-*"), key=lambda path: (len(path.name), path.name))
    told = told_folder(record) or (f"its folder: {folders[-1]}" if folders else "no folder is kept")
    origin = f"; taken over from {record.origin}" if record.origin else ""
    lines = [f"run {record.key[:KEY]} {state} in {record.seconds:.3g} s at {inputs}; {told}{origin}"]
    reason = (record.message or "").partition("\n")[0]
    return lines if record.ok or not reason else [*lines, f"  {reason}"]


def _settings(stated: Stated, executor: Executor) -> dict[str, str]:
    by = "the field" if stated.surrogate == "field" else f"the log-likelihood, kernel {stated.kernel}"
    found = {
        "forward": f"{stated.planned_runs} runs{' at most' if stated.active else ''} by {_in_words(executor)}",
        "surrogate": f"of {by}",
        "sampling": f"{stated.particles} particles, seed {stated.seed}, {_in_words(stated.smc)}",
    }
    if stated.active is not None:
        found["choice"] = _in_words(stated.active)
    elif stated.refine.rounds:
        found["refinement"] = _in_words(stated.refine)
    return found


def _in_words(chosen: Any) -> str:
    """Return a class and its options that are set: ``LocalProcesses: timeout 60.0``."""
    name = type(chosen).__name__
    if not is_dataclass(chosen):
        return name
    given = ((one.name, getattr(chosen, one.name)) for one in fields(chosen) if one.init)
    shown = ", ".join(f"{key} {value}" for key, value in given if value is not None)
    return f"{name}: {shown}" if shown else name


def say_journal(study: Study, *, quiet: bool) -> None:
    """Print on standard error that the ledger of `study` has a rollback journal, and why."""
    line = journal_note(study.ledger_path)
    if line and not quiet:
        click.echo(line, err=True)
