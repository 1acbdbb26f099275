"""The expected widths of the posterior as soon as the first runs of a campaign have ended."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from strandline.calibration import Observer
from strandline.errors import InvalidInput, NumericsError
from strandline.interface import Interface, UnknownErrors
from strandline.models.fidelities import WithCheaper, is_cheaper
from strandline.parameters import ParameterSpace
from strandline.runs import Progress, RunRecord
from strandline.studies.expected_widths import Slopes, expected_sd, slopes_by_sensitivities, width_lines
from strandline.studies.study import Study
from strandline.surrogate.field import FieldTraining, fit_field

__all__ = ["noting_widths", "predicted_at"]

RUNS_PER_INPUT = 4
"""Successful runs for each input, and for the mean, from which slopes are estimated."""
STEP = 1e-3
"""Step of the differences, in widths of the box."""


def noting_widths(observer: Observer, study: Study) -> Observer:
    """Return an observer that also notes the expected widths, once: after the first runs, without any of its own."""
    first: list[RunRecord] = []
    needed = 1 if study.sensitivities else RUNS_PER_INPUT * (study.space.dim + 1)

    def run(record: RunRecord, progress: Progress) -> None:
        """Report a run, and after enough runs the widths."""
        observer.run(record, progress)
        by_one = not isinstance(study.model, WithCheaper) or is_cheaper(record.inputs)
        if record.ok and by_one and len(first) < needed:
            first.append(record)
            if len(first) == needed:
                for line in _lines(study, first):
                    observer.note(line)

    return replace(observer, run=run)


def predicted_at(
    records: Sequence[RunRecord], space: ParameterSpace, at: Float[np.ndarray, " dim"]
) -> tuple[dict[str, Interface], Slopes] | None:
    """Return the interfaces at some inputs, and d(points)/d(input) there, mm per unit of the input, by condition.

    They come from a surrogate of the field, learnt from successful runs. Slopes in the mean over a wide box would hide
    that two inputs have nearly the same effect. Returns None for runs that define no field.
    """
    x = np.array([[record.inputs[name] for name in space.names] for record in records], float)
    interfaces = [record.interfaces for record in records]
    try:
        field = fit_field(FieldTraining(x, interfaces, None, space.low, space.high))
    except (InvalidInput, NumericsError):
        return None
    steps = STEP * (space.high - space.low)
    ahead, back = (field.points(field.mean(at + np.diag(one))) for one in (steps, -steps))
    slopes = {name: np.moveaxis(ahead[name] - back[name], 0, -1) / (2 * steps) for name in ahead}
    return field.interfaces(at), slopes


def _lines(study: Study, records: Sequence[RunRecord]) -> list[str]:
    """Return the expected widths in sentences; none if they cannot be computed."""
    names, seen = study.space.names, study.observed or records[0].interfaces
    if any(isinstance(study.noise_of(condition), UnknownErrors) for condition in seen):
        return []
    x = np.array([[record.inputs[name] for name in names] for record in records], float)
    middle = records[int(np.argmin((((x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 1e-300)) ** 2).sum(axis=1)))]
    slopes, interfaces, source = slopes_by_sensitivities(middle, names), middle.interfaces, "the sensitivities of a run"
    if slopes is None:
        found = predicted_at(records, study.space, np.array([middle.inputs[name] for name in names], float))
        if found is None:
            return []
        (interfaces, slopes), source = found, f"the first {len(records)} runs"
    try:
        return list(width_lines(study, expected_sd(study, interfaces, slopes, study.observed), source))
    except (InvalidInput, NumericsError):
        return []  # what the measure refuses is reported elsewhere
