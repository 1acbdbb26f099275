"""coverage.json: what the replicates of an experiment show together."""

from typing import Any

import numpy as np

from strandline.calibration.coverage import CoverageFound
from strandline.calibration.experiment import CoordinateErrors, Experiment
from strandline.calibration.field_quality import FieldQuality
from strandline.interface import Noise, PointErrors, UnknownErrors
from strandline.posterior.uniformity import Band, Coverage
from strandline.studies.provenance import versions
from strandline.studies.study import Study
from strandline.version import __version__

__all__ = ["describe_coverage"]

TO_MICROMETRES = 1e3


def describe_coverage(
    study: Study,
    found: CoverageFound,
    experiment: Experiment,
    quality: FieldQuality,
    *,
    source: str,
    seed: int,
    measure: str,
) -> dict[str, Any]:
    """Return the content of coverage.json."""
    return {
        "study": study.name,
        "study_sha256": study.text_digest,
        "version": __version__,
        "versions": versions(),
        "model": study.runs.identity,
        "source": source,
        "seed": seed,
        "replicates": len(found.replicates),
        "measure": measure,
        "noise": _noise(study, experiment),
        "surrogate": {
            "runs": experiment.surrogate.runs,
            "hidden_um": TO_MICROMETRES * quality.hidden,
            "error_um": {"median": TO_MICROMETRES * quality.median, "q95": TO_MICROMETRES * quality.q95},
            "left_out_error_um": TO_MICROMETRES * quality.left_out,
            "beyond": quality.beyond,
        },
        "calibrated": found.calibrated,
        "remarks": list(found.remarks),
        "inputs": _inputs(study, found),
        "log_likelihood": {
            "inside": found.fit_band.inside,
            "p_value": found.fit_band.p_value,
            "regions": [_share(one, 0) for one in found.regions],
            "ranks": found.fit_ranks.tolist(),
            "band": _band(found.fit_band),
        },
        "sampling": {
            "importance": sum(one.by == "importance" for one in found.replicates),
            "smc": sum(one.by == "smc" for one in found.replicates),
            "effective": float(np.median([one.effective for one in found.replicates])),
        },
    }


def _inputs(study: Study, found: CoverageFound) -> dict[str, Any]:
    ratios, means, spreads = found.of_limit, found.z.mean(axis=0), found.z.std(axis=0, ddof=1)
    return {
        parameter.name: {
            "label": parameter.shown,
            "unit": parameter.unit,
            "inside": band.inside,
            "p_value": band.p_value,
            "intervals": [_share(one, i) for one in found.intervals],
            "z_mean": float(means[i]),
            "z_sd": float(spreads[i]),
            "sd": float(found.sd[i]),
            "of_limit": float(ratios[i]),
            "ranks": found.ranks[:, i].tolist(),
            "band": _band(band),
        }
        for i, (parameter, band) in enumerate(zip(study.space, found.bands, strict=True))
    }


def _share(one: Coverage, i: int) -> dict[str, float]:
    return {"level": one.level, **{part: float(getattr(one, part)[i]) for part in ("found", "low", "high")}}


def _band(band: Band) -> dict[str, list[float]]:
    return {part: getattr(band, part).tolist() for part in ("places", "found", "low", "high")}


def _noise(study: Study, experiment: Experiment) -> list[dict[str, Any]]:
    return [
        {
            "condition": name,
            "stated": isinstance(study.noise_of(name), PointErrors),
            "drawn": errors.facts,
            "analysed": dict(experiment.noises[name].facts),
            "in_words": _in_words(errors, study.noise_of(name)),
        }
        for name, errors in experiment.errors.items()
    ]


def _in_words(errors: PointErrors | CoordinateErrors, noise: Noise | PointErrors | UnknownErrors) -> str:
    sd = f"{TO_MICROMETRES * errors.sd:.3g} µm"
    if isinstance(errors, CoordinateErrors):
        return f"independent errors of all coordinates, sd {sd}"
    if isinstance(noise, PointErrors):
        return f"errors of the points as study.yaml states them, sd {sd}"
    if isinstance(noise, UnknownErrors):
        return f"errors of the points as inferred from the real observation, sd {sd}"
    return f"independent errors of the points along the normals, sd {sd}, for which the stated σ_N² is right"
