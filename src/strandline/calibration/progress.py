"""The progress of a calibration in words, and below the cell of a notebook."""

import html
import sys
from collections.abc import Callable
from importlib import import_module

from strandline.calibration.problem import Observer
from strandline.runs import Progress, RunRecord
from strandline.smc import StepInfo

STAGES = {
    "forward": "forward runs",
    "draws": "runs at draws",
    "refinement": "draws for a round",
    "choice": "next batch",
    "cut": "cut reading",
    "check": "checks",
    "candidates": "runs of candidates",
    "gains": "information gains",
    "report": "figures and report",
}
"""Stages whose names in words differ from those in the program."""
KERNEL = "ZMQInteractiveShell"
"""Shell of a Jupyter kernel; others have a terminal."""


def run_note(state: Progress) -> str:
    """Return how many runs have ended well, how many not, and the time left, or that a server is waited for."""
    rest = ", waiting for the model's server" if state.waiting else _left(state)
    return f"{state.ok} ok, {state.failed} failed{rest}"


def part_note(state: Progress) -> str:
    """Return how many parts are done, and the time left."""
    return f"{state.finished} of {state.total}{_left(state)}"


def _left(state: Progress) -> str:
    remaining = state.remaining_seconds
    return "" if remaining is None or state.finished == state.total else f", {_duration(remaining)} left"


def step_note(info: StepInfo) -> str:
    """Return the tempering exponent, the effective sample size and the share of accepted moves."""
    return f"tempering exponent {info.temperature:.4f}, ESS {info.ess:.0f}, accepted {info.acceptance:.0%}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def observer_or_default(observer: Observer | None) -> Observer:
    """Return `observer`; if there is none, one that shows the progress in a notebook, and nothing elsewhere."""
    if observer is not None:
        return observer
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if type(shell).__name__ != KERNEL:
        return Observer()
    display = import_module("IPython.display")
    handle = display.display(display.HTML(""), display_id=True)
    return cell_observer(lambda text: handle.update(display.HTML(text)))


def cell_observer(show: Callable[[str], None]) -> Observer:
    """Return an observer that shows the stages so far as HTML, one a line, with how far each has got."""
    lines: list[list[str]] = []

    def refresh() -> None:
        rows = "<br>".join(f"{html.escape(stage)} {html.escape(note)}" for stage, note in lines)
        show(f'<div role="status" style="font-size: 90%">{rows}</div>')

    def stage(name: str) -> None:
        words = STAGES.get(name, name)
        if not lines or lines[-1][0] != words:
            lines.append([words, "…"])
        refresh()

    def noted(text: str) -> None:
        if lines:
            lines[-1][1] = text
            refresh()

    def run(record: RunRecord, state: Progress) -> None:
        noted(f"{state.finished}/{state.total}: {run_note(state)}")

    def step(info: StepInfo) -> None:
        noted(step_note(info))

    def part(state: Progress) -> None:
        noted(part_note(state))

    return Observer(stage=stage, run=run, step=step, part=part, batch=lambda report: noted(report.line), note=noted)
