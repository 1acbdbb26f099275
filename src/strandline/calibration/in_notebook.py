"""The progress of a calibration below the cell of a notebook."""

import html
import sys
from collections.abc import Callable
from importlib import import_module

from strandline.calibration.problem import Observer
from strandline.calibration.progress_text import STAGES, part_note, run_note, step_note
from strandline.runs import Progress, RunRecord
from strandline.smc import StepInfo

__all__ = ["cell_observer", "observer_or_default"]

KERNEL = "ZMQInteractiveShell"
"""Shell of a Jupyter kernel; others have a terminal."""


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
    """Return an observer that shows the stages so far, one a line, with how far each has got.

    Args:
        show: Function that replaces what is shown by an HTML text.
    """
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
