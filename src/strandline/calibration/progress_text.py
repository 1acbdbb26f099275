"""The progress of a calibration in words."""

from strandline.runs import Progress
from strandline.smc import StepInfo

__all__ = ["STAGES", "part_note", "run_note", "step_note"]

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
"""Name of each stage in words."""


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
