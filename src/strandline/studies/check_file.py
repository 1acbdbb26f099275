"""check.json: the check of a study's posterior with the true model, as plain numbers, and whether it still applies."""

import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

from strandline.interface import Interface, Observation
from strandline.models.offers import undeformed_interface
from strandline.posterior import (
    Posterior,
    Reweighting,
    Verdict,
    interface_band,
    normal_offsets,
    observed_offsets,
    reliability_threshold,
    verdict_on,
)
from strandline.runs import RunRecord
from strandline.studies.folder import CHECK, read_json
from strandline.studies.provenance import versions
from strandline.studies.study import Study
from strandline.version import __version__

SHIFT_SHOWN, RATIO_SHOWN = 0.25, 0.2
"""A remark reports a mean off by more than this, in standard deviations, or an sd off by more than this share."""
VERDICTS: dict[Verdict, str] = {
    "good": "The weights can be trusted, and so can the reweighted figures.",
    "usable": "The surrogate is off where the posterior lies, but the reweighted figures can be used.",
    "bad": "DO NOT TRUST THE SURROGATE where the posterior lies, nor the reweighted figures.",
}


@dataclass(frozen=True, eq=False)
class Compared:
    """Draws of a posterior with the results of the true model, one of each per draw.

    Args:
        posterior: The posterior that was checked.
        chosen: Particle numbers of the draws, shape (draw,).
        records: Records of the runs at the draws.
        true: Log-likelihoods by the true model, shape (draw,); -inf if the run failed.
        surrogate: Log-likelihoods by the surrogate, shape (draw,).
        result: The reweighted moments.
    """

    posterior: Posterior
    chosen: Int[np.ndarray, " draw"]
    records: tuple[RunRecord, ...]
    true: Float[np.ndarray, " draw"]
    surrogate: Float[np.ndarray, " draw"]
    result: Reweighting

    @property
    def failed(self) -> list[RunRecord]:
        """The runs that returned no interface."""
        return [record for record in self.records if not record.ok]


def describe(study: Study, found: Compared, observations: Sequence[Observation], *, new_runs: int) -> dict[str, Any]:
    """Return the content of check.json except the seconds."""
    smoothed, number = found.result.smoothed, len(found.records)
    distinct = len({record.key for record in found.records})
    difference = (found.true - found.surrogate)[np.isfinite(found.true)]
    return {
        "study": study.name,
        "study_sha256": study.text_digest,
        "posterior_sha256": posterior_digest(found.posterior),
        "version": __version__,
        "versions": versions(),
        "seed": study.settings.seed,
        "model": study.runs.identity,
        "draws": number,
        "runs": {
            "ok": number - len(found.failed),
            "failed": len(found.failed),
            "by_kind": dict(Counter(record.failure_kind or record.state for record in found.failed)),
            "new": new_runs,
            "reused": distinct - new_runs,
        },
        "k_hat": smoothed.k_hat,
        "threshold": reliability_threshold(number),
        "verdict": verdict_on(smoothed),
        "remarks": list(_remarks(study, found)),
        "ess": smoothed.ess,
        "log_likelihood": {
            "mean_difference": float(difference.mean()),
            "rms_difference": float(difference.std()),
        },
        "inputs": _inputs(found),
        "particles": {
            "number": found.chosen.tolist(),
            "true": found.true.tolist(),
            "surrogate": found.surrogate.tolist(),
            "log_weight": smoothed.log_weights.tolist(),
        },
        "interfaces": [_interfaces(study, o, found.records) for o in observations],
    }


def read_check(folder: Path, posterior: Posterior) -> dict[str, Any] | None:
    """Return the check of `posterior` in `folder`; None if there is none, or only that of another posterior."""
    content = read_json(folder / CHECK)
    return content if content.get("posterior_sha256") == posterior_digest(posterior) else None


def posterior_digest(posterior: Posterior) -> str:
    """Return a digest of the particles; posteriors that differ in one bit have different digests."""
    parts = (posterior.draws, posterior.log_weights, posterior.log_likelihood)
    return hashlib.sha256(b"".join(np.ascontiguousarray(part, float).tobytes() for part in parts)).hexdigest()


def _inputs(found: Compared) -> dict[str, dict[str, Any]]:
    result = found.result
    columns = {
        "mean": result.mean,
        "sd": result.sd,
        "reweighted_mean": result.reweighted_mean,
        "reweighted_sd": result.reweighted_sd,
        "shift": result.shift,
        "shift_error": result.shift_error,
        "sd_ratio": result.sd_ratio,
    }
    return {
        parameter.name: {"unit": parameter.unit, **{name: float(column[i]) for name, column in columns.items()}}
        for i, parameter in enumerate(found.posterior.space)
    }


def _remarks(study: Study, found: Compared) -> Iterator[str]:
    """Yield a sentence on k̂ and one on everything else to know."""
    verdict = verdict_on(found.result.smoothed)
    yield VERDICTS[verdict]
    if verdict != "good":
        measure = next(iter(study.discrepancies.values()))
        refined = getattr(measure, "quadrature", None) == "centre"
        yield (
            "Remedy: more runs near the posterior (a narrower box, or a larger design)"
            + (", the refined quadrature of the measure," if refined else "")
            + " or a larger noise. Then run the study and this check again."
        )
    if verdict != "bad":
        yield from _differences(found)
    if found.failed:
        yield (
            f"{len(found.failed)} of {len(found.records)} draws failed in the true model and have weight zero: "
            "the posterior reaches where the simulator fails, and the surrogate knows nothing there."
        )


def _differences(found: Compared) -> Iterator[str]:
    result = found.result
    for name, shift, ratio in zip(found.posterior.space.names, result.shift, result.sd_ratio, strict=True):
        if abs(shift) > SHIFT_SHOWN or abs(ratio - 1) > RATIO_SHOWN:
            yield (
                f"{name}: the true model moves the mean by {shift:+.2f} standard deviations and changes the standard "
                f"deviation by a factor of {ratio:.2f}: take the reweighted figures."
            )


def _interfaces(study: Study, observation: Observation, records: Sequence[RunRecord]) -> dict[str, Any]:
    """Return the quantiles of the interfaces of one condition over the successful draws."""
    interfaces = [record.interfaces[observation.condition] for record in records if record.ok]
    shapes = {interface.points.shape for interface in interfaces}
    if len(shapes) > 1:
        note = f"no band: the interfaces of the draws have from {min(shapes)[0]} to {max(shapes)[0]} points"
        return {"condition": observation.condition, "points": None, "note": note, "displacement": None, "offset": None}
    points = np.stack([interface.points for interface in interfaces])
    band = interface_band(points)
    origin, reference = _reference(study, band.median)
    return {
        "condition": observation.condition,
        "points": points.shape[1],
        "note": None,
        "displacement": {
            "from": origin,
            "reference": reference.tolist(),
            "q05": (band.low - reference).tolist(),
            "q50": (band.median - reference).tolist(),
            "q95": (band.high - reference).tolist(),
        },
        "offset": offset_band(points, Interface(band.median, interfaces[0].cells), observation.interface),
    }


def _reference(
    study: Study, median: Float[np.ndarray, "point xyz"]
) -> tuple[Literal["undeformed", "median"], Float[np.ndarray, "point xyz"]]:
    """Return the reference of displacements: the undeformed nodes if the model offers them, else the median."""
    undeformed = undeformed_interface(study.model)
    if undeformed is not None and undeformed.points.shape == median.shape:
        return "undeformed", undeformed.points
    return "median", median


def offset_band(
    points: Float[np.ndarray, "draw point xyz"], centre: Interface, observed: Interface
) -> dict[str, Any] | None:
    """Return quantiles of the offsets from a polyline, and the offsets of the observation; None for surfaces.

    Args:
        points: Nodes of the interfaces of some draws, mm.
        centre: The polyline, with the same nodes, such as the median of the interfaces.
        observed: The observed interface.
    """
    if points.shape[2] != 2:
        return None
    nodes, seen = normal_offsets(points, centre), observed_offsets(observed, centre)
    low, median, high = np.quantile(nodes.offset, (0.05, 0.5, 0.95), axis=0)
    return {
        "arc_length": nodes.arc_length.tolist(),
        "q05": low.tolist(),
        "q50": median.tolist(),
        "q95": high.tolist(),
        "observed_arc_length": seen.arc_length.tolist(),
        "observed": seen.offset.tolist(),
    }
