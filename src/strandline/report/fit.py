"""Whether the model fits: how near the runs come to the observation, and the entries of summary.json."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.calibration import ConditionMisfit, Misfit, Problem, Region
from strandline.discrepancy import (
    Discrepancy,
    apart,
    axes_mistake,
    count_of_distances,
    extent,
    extent_ratio,
    noise_units,
    unit_mistake,
)
from strandline.foundations import InvalidInput, NumericsError, inputs_text
from strandline.interface import Observation
from strandline.likelihood import InterfaceLikelihood, compared, noise_length, sd_of_distances
from strandline.report.html import number
from strandline.runs import RunRecord

TO_MICROMETRES = 1e3
FAR = 5.0
"""Residual in units of the noise above which a run is not near the observation."""
SPACINGS = 2.0
"""A run is not near if the observation is further away than this many times the distance of neighbouring runs."""
TELLING = 2.0
"""Smallest ratio of extents, or inverse of it, that the message mentions."""


def fit_as_json(found: Misfit | None, far: str | None) -> dict[str, Any] | None:
    """Return the entry of summary.json; None if the fit was not judged.

    `far` says that no run comes near the observation, if none does; then the model does not explain it either.
    """
    if found is None:
        return None
    return {
        "verdict": found.verdict if found.flagged or far is None else far,
        "flagged": found.flagged or far is not None,
        "p": found.p_value,
        "region_p": found.region_p,
        "smooth_p": found.smooth_p,
        "predictive_p": found.predictive_p,
        "conditions": [_condition(one) for one in found.conditions],
        "notes": list(found.notes),
    }


def _condition(found: ConditionMisfit) -> dict[str, Any]:
    return {
        "condition": found.condition,
        "sd_um": TO_MICROMETRES * found.rms,
        "length_um": TO_MICROMETRES * found.found.length,
        "stated_sd_um": TO_MICROMETRES * found.expected.sd,
        "stated_length_um": TO_MICROMETRES * found.expected.length,
        "assumed": found.stated.assumed,
        "ratio": found.ratio,
        "p": found.p_value,
        "predictive_p": found.predictive_p,
        "regions": [_region(one) for one in found.regions],
        "removed": _removed(found.removed),
    }


def _removed(found: Mapping[str, tuple[float, ...]]) -> dict[str, Any]:
    """Return the global errors: lengths in µm, angles in degrees; a number where there is only one."""
    out: dict[str, Any] = {}
    for name, values in found.items():
        factor, unit = {"rotation": (1.0, "_deg"), "scale": (1.0, "")}.get(name, (TO_MICROMETRES, "_um"))
        scaled = [factor * value for value in values]
        out[name + unit] = scaled if len(scaled) > 1 else scaled[0]
    return out


def _region(found: Region) -> dict[str, Any]:
    return {
        "begin_mm": found.begin if found.centre is None else None,
        "end_mm": found.end if found.centre is None else None,
        "centre_mm": None if found.centre is None else list(found.centre),
        "mean_um": TO_MICROMETRES * found.mean,
        "rms_um": TO_MICROMETRES * found.rms,
        "excess": found.excess,
        "p": found.p_value,
    }


@dataclass(frozen=True)
class Nearest:
    """The run with the largest log-likelihood, and how near it is to one observation.

    `residual` is √(d²/(n σ_N²)), n being the number of distances that d² sums, 1 for a norm. `distance`, mm, is the
    root mean square one of the two interfaces; `noise`, mm, is σ_N if d² sums distances, else the shift for which d² =
    σ_N², None if it was not needed. `offset` is the distance of the centres, mm; `extent_ratio` that of the observed
    interface to that of the run; `axes` asks about those of the observation if others would help. The run is near if it
    is so in any of these senses.
    """

    condition: str
    run: str
    inputs: Mapping[str, float]
    residual: float
    distance: float
    noise: float | None
    offset: float
    extent: float
    extent_ratio: float
    axes: str
    near: bool

    @property
    def message(self) -> str:
        """A sentence that nothing comes near, with the distance of the best run and the likely reason."""
        of = f" of {self.condition}" if self.condition else ""
        where = inputs_text(self.inputs, 4)
        reason = "The model, the box or the noise is wrong."
        if max(self.extent_ratio, 1 / self.extent_ratio) >= TELLING:
            why = f": {mistake}" if (mistake := unit_mistake(self.extent_ratio)) else ""
            reason = f"The observed interface has {number(self.extent_ratio, 3)} times the extent of the run's{why}."
        elif self.axes:
            reason = self.axes
        elif self.offset > self.extent:
            reason = f"Their centres lie {_length(self.offset)} apart: do both have the same origin and axes?"
        return (
            f"NOTHING IN THE BOX COMES NEAR the observation{of}: the best run ({where}) is "
            f"{number(self.residual, 3)} noise units and {_length(self.distance)} away. {reason}"
        )


def _length(mm: float) -> str:
    return f"{number(mm, 3)} mm" if mm >= 1 else f"{number(1e3 * mm, 3)} µm"


def nothing_near(found: list[Nearest]) -> str | None:
    """Return the message on the first observation that no run comes near; None if there is no such observation."""
    return next((nearest.message for nearest in found if not nearest.near), None)


def nearest_runs(
    problem: Problem, records: Sequence[RunRecord], log_likelihood: Float[np.ndarray, " ok"] | None = None
) -> list[Nearest]:
    """Return how near the best run comes to each observation; only the first measure of the problem counts.

    A run is far if all of these hold: its residual is above 5 noise units, or d² no longer grows with the distance; the
    interfaces are further apart than 5 times the noise; and they are further apart than the runs are from each other,
    so that no input between two runs is likely to fit. Log-likelihoods of the successful runs are computed if not
    given.
    """
    measure = problem.measure
    runs = [record for record in records if record.ok]
    if log_likelihood is None or len(log_likelihood) != len(runs):
        log_likelihood = _log_likelihood(problem, measure, runs)
    best = runs[int(np.argmax(log_likelihood))]
    return [_nearest(seen, measure, best, runs) for seen in problem.observations]


def _nearest(seen: Observation, measure: Discrepancy, best: RunRecord, runs: list[RunRecord]) -> Nearest:
    simulated = best.interfaces[seen.condition]
    square = float(InterfaceLikelihood((seen,), measure).discrepancies(best.interfaces)[0])
    one = compared(seen, measure, len(simulated.points))
    residual = noise_units(square, one.noise.scale, count_of_distances(measure, simulated, seen.interface))
    distance, _ = apart(simulated, seen.interface)
    noise = None
    far = residual > FAR or distance > extent(seen.interface)
    if far:
        sd = sd_of_distances(seen, measure, simulated)
        noise = noise_length(seen, measure) if sd is None else sd
        far = distance > FAR * noise and _outside(seen, runs, FAR * noise)
    centres = [interface.points.mean(axis=0) for interface in (simulated, seen.interface)]
    return Nearest(
        condition=seen.condition,
        run=best.key,
        inputs=dict(best.inputs),
        residual=residual,
        distance=distance,
        noise=noise,
        offset=float(np.linalg.norm(centres[0] - centres[1])),
        extent=extent(seen.interface),
        extent_ratio=extent_ratio(seen.interface, simulated),
        axes=axes_mistake(seen.interface, simulated) if far else "",
        near=not far,
    )


def _log_likelihood(problem: Problem, measure: Discrepancy, runs: list[RunRecord]) -> Float[np.ndarray, " ok"]:
    """Return the log-likelihood of each run; -inf if the measure refuses its interface."""
    likelihood = InterfaceLikelihood(problem.observations, measure)

    def value(record: RunRecord) -> float:
        try:
            return likelihood(record.interfaces)
        except (InvalidInput, NumericsError):
            return -np.inf

    return np.array([value(record) for record in runs])


def _outside(seen: Observation, runs: list[RunRecord], least: float) -> bool:
    """Return whether the observation is further from all runs than `least`, mm, and than the runs are from each other.

    The latter is the distance from the run nearest to the observation to its (d + 1)-th neighbour, d being the number
    of inputs that vary: it takes d + 1 neighbours to enclose a point.
    """
    interfaces = [record.interfaces[seen.condition] for record in runs]
    distances = np.array([apart(interface, seen.interface)[0] for interface in interfaces])
    nearest = interfaces[int(np.argmin(distances))]
    neighbours = np.sort([apart(interface, nearest)[0] for interface in interfaces])[1:]
    inputs: Float[np.ndarray, "run input"] = np.array([list(record.inputs.values()) for record in runs], float)
    varying = int((np.ptp(inputs, axis=0) > 0).sum())
    spacing = float(neighbours[min(varying, len(neighbours) - 1)]) if len(neighbours) else 0.0
    return float(distances.min()) > max(least, SPACINGS * spacing)


def as_json(found: list[Nearest]) -> dict[str, Any]:
    """Return the entry of summary.json."""
    keys = ("condition", "run", "inputs", "residual", "distance", "noise", "offset", "extent_ratio", "near")
    each = [{key: getattr(nearest, key) for key in keys} for nearest in found]
    return {"near": all(nearest.near for nearest in found), "message": nothing_near(found), "observations": each}
