"""What `--verbose` adds to the progress: each run, each step of the sampler, the settings of each stage."""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from strandline.calibration import Observer
from strandline.calibration import Settings as Stated
from strandline.runs import Executor, RunRecord
from strandline.runs import Progress as Runs
from strandline.runs.record import told_folder
from strandline.smc import StepInfo
from strandline.studies import Study

__all__ = ["detailed", "set_aside_lines"]

KEY = 12
"""Characters of a run's key, as in the names of the folders that are kept."""


def detailed(study: Study, executor: Executor, say: Callable[[str], None]) -> Observer:
    """Return an observer that says what the progress leaves out.

    Args:
        study: The study.
        executor: Where the runs are made.
        say: Function that shows a line.
    """
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
    """Return how a run ended, where its folder is, and why it failed."""
    inputs = ", ".join(f"{name} = {value:.6g}" for name, value in record.inputs.items())
    state = record.state if record.ok else f"{record.state} ({record.failure_kind})"
    told = told_folder(record) or next(
        (f"its folder: {one}" for one in _folders(kept, record.key)), "no folder is kept"
    )
    origin = f"; taken over from {record.origin}" if record.origin else ""
    lines = [f"run {record.key[:KEY]} {state} in {record.seconds:.3g} s at {inputs}; {told}{origin}"]
    reason = (record.message or "").partition("\n")[0]
    return lines if record.ok or not reason else [*lines, f"  {reason}"]


def _folders(kept: Path, key: str) -> list[Path]:
    """Return the folders of a run that are kept, the last attempt first."""
    return sorted(kept.glob(f"{key[:KEY]}-*"), key=lambda path: (len(path.name), path.name), reverse=True)


def _settings(stated: Stated, executor: Executor) -> dict[str, str]:
    """Return the settings of each stage in words."""
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
