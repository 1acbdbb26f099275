"""The part of a report on whether the model fits: its numbers for summary.json, and its figure."""

from collections.abc import Iterator, Mapping
from typing import Any

from strandline.calibration import Calibration, Misfit
from strandline.calibration.misfit import ConditionMisfit, Region
from strandline.report import plots
from strandline.report.captioned import Captioned, whole

__all__ = ["fit_as_json", "fit_figures"]

TO_MICROMETRES = 1e3
CONSPICUOUS = 0.05
"""Parts of an arc with a smaller p-value are marked in the figure."""


def fit_as_json(found: Misfit | None, far: str | None) -> dict[str, Any] | None:
    """Return the entry of summary.json; None if the fit was not judged.

    Args:
        found: The misfit of a calibration.
        far: Message that no run comes near the observation, if none does; then the model does not explain it either.
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
    own, expected = found.found, found.expected
    return {
        "condition": found.condition,
        "sd_um": TO_MICROMETRES * found.rms,
        "length_um": TO_MICROMETRES * own.length,
        "stated_sd_um": TO_MICROMETRES * expected.sd,
        "stated_length_um": TO_MICROMETRES * expected.length,
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


def fit_figures(calibration: Calibration) -> Iterator[Captioned]:
    """Yield the residuals along the observed polylines; nothing for surfaces."""
    found = calibration.misfit
    lines = [one for one in (found.conditions if found is not None else ()) if not one.surface]
    if not lines:
        return
    drawn = {one.condition: _along(one) for one in lines}
    caption = (
        "Signed distance of each observed point from the prediction that fits best, and twice the standard deviation "
        "of the noise. A correct model leaves residuals that scatter about zero within the band."
    )
    yield Captioned("residuals", "fit", caption, whole(plots.plot_residuals(drawn)))


def _along(found: ConditionMisfit) -> plots.ResidualsAlong:
    marked = tuple((one.begin, one.end) for one in found.regions if one.p_value < CONSPICUOUS)
    return plots.ResidualsAlong(found.arc_length, found.residual, found.expected.sd, marked)
