"""The expected widths of the posterior as soon as the first runs of a campaign have ended."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from strandline.calibration import Observer
from strandline.errors import InvalidInput, NumericsError
from strandline.interface import UnknownErrors
from strandline.runs import Progress, RunRecord
from strandline.studies.expected_widths import Slopes, expected_sd, slopes_by_sensitivities, width_lines
from strandline.studies.study import Study

__all__ = ["noting_widths", "slopes_by_regression"]

RUNS_PER_INPUT = 4
"""Successful runs for each input, and for the mean, from which slopes are estimated."""


def noting_widths(observer: Observer, study: Study) -> Observer:
    """Return an observer that also notes the expected widths, once: after the first runs, without any of its own."""
    first: list[RunRecord] = []
    needed = 1 if study.sensitivities else RUNS_PER_INPUT * (study.space.dim + 1)

    def run(record: RunRecord, progress: Progress) -> None:
        """Report a run, and after enough runs the widths."""
        observer.run(record, progress)
        if record.ok and len(first) < needed:
            first.append(record)
            if len(first) == needed:
                for line in _lines(study, first):
                    observer.note(line)

    return replace(observer, run=run)


def slopes_by_regression(records: Sequence[RunRecord], names: Sequence[str], middle: RunRecord) -> Slopes | None:
    """Return d(points)/d(input) at a run by least squares, mm per unit of the input; None for runs with other nodes.

    A second-order polynomial is fitted, as far as there are twice as many runs as terms: slopes in the mean over a wide
    box hide that two inputs have nearly the same effect.
    """
    x, at = (np.array([[one.inputs[name] for name in names] for one in some], float) for some in (records, [middle]))
    unit = np.maximum(x.std(axis=0), 1e-300)
    terms = _terms((x - at) / unit)
    found = {}
    for condition, interface in middle.interfaces.items():
        shapes = {record.interfaces[condition].points.shape for record in records}
        if len(shapes) > 1 or np.linalg.matrix_rank(terms) < terms.shape[1]:
            return None
        points = np.array([record.interfaces[condition].points.ravel() for record in records])
        slopes = np.linalg.lstsq(terms, points, rcond=None)[0][1 : 1 + len(names)] / unit[:, None]
        found[condition] = slopes.T.reshape(*interface.points.shape, len(names))
    return found


def _terms(z: Float[np.ndarray, "run dim"]) -> Float[np.ndarray, "run term"]:
    """Return 1, z and, for enough runs, the squares and then also the products of the inputs."""
    runs, dim = z.shape
    linear = np.column_stack([np.ones(runs), z])
    products = [z[:, i] * z[:, j] for i in range(dim) for j in range(i)]
    for more in ([z**2, *products], [z**2]):
        terms = np.column_stack([linear, *more])
        if 2 * terms.shape[1] <= runs:
            return terms
    return linear


def _lines(study: Study, records: Sequence[RunRecord]) -> list[str]:
    """Return the expected widths in sentences; none if they cannot be computed."""
    names, seen = study.space.names, study.observed or records[0].interfaces
    if any(isinstance(study.noise_of(condition), UnknownErrors) for condition in seen):
        return []
    x = np.array([[record.inputs[name] for name in names] for record in records], float)
    middle = records[int(np.argmin((((x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 1e-300)) ** 2).sum(axis=1)))]
    slopes, source = slopes_by_sensitivities(middle, names), "the sensitivities of a run"
    if slopes is None:
        slopes, source = slopes_by_regression(records, names, middle), f"the first {len(records)} runs"
    if slopes is None:
        return []
    try:
        return list(width_lines(study, expected_sd(study, middle.interfaces, slopes, study.observed), source))
    except (InvalidInput, NumericsError):
        return []  # what the measure refuses is reported elsewhere
