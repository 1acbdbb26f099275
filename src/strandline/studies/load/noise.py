"""The noise that a study states: of the measure, or of the observed points."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import Discrepancy, NormalOffset
from strandline.foundations import InvalidInput, InvalidStudy
from strandline.interface import GaussianNoise, Interface, Noise, PointErrors, UnknownErrors
from strandline.likelihood import require_inferable_noise
from strandline.readers import TO_MM
from strandline.studies.keys.observation import COLUMN, IMAGE, ConditionNoise, Unknown
from strandline.studies.keys.parse import entry, refused_at
from strandline.studies.load.observed import Found

Stated = float | str | tuple[float, float] | None


def build_noise(
    given: ConditionNoise, names: Sequence[str], found: Found | None = None
) -> Noise | PointErrors | UnknownErrors:
    """Return the noise that a section states, lengths in mm."""
    if given.unit is None:
        return GaussianNoise(given.squared)
    mm, unknown = TO_MM[given.unit], given.unknown or Unknown()
    common: dict[str, Any] = {"shift": mm * unknown.shift, "rotation": unknown.rotation, "scale": unknown.scale}
    common["offset"] = mm * unknown.offset
    if found is not None and found.picture is not None:
        place = found.picture.errors
        if unknown.shared and (place.shift or place.rotation):
            expected = "pictures without a registration, each of which has an error of its own"
            raise InvalidStudy("noise.unknown.shared", value=True, expected=expected, remedy="Leave shared out.")
        common |= {name: math.hypot(common[name], getattr(place, name)) for name in ("shift", "rotation")}
    sd, length = _in_mm(given.sd, mm), _in_mm(given.length or 0.0, mm)
    sds = None if found is None else found.sds
    if given.sd == COLUMN and sds is None:
        expected = "a table with the standard deviation of each point"
        remedy = "Name its column, `observation: {file: …, sd: COLUMN}`, or state one sd for all points."
        raise InvalidStudy("noise.sd", value=COLUMN, expected=expected, remedy=remedy)
    for name in given.spread:
        entry(dict.fromkeys(names), name, "noise.spread")
    spread = tuple(names.index(name) for name in given.spread)
    if given.sd == IMAGE:
        seen = _shown(given, found)
        sd, length, common["offset"] = seen.sd, seen.length, common["offset"] or seen.offset
    with refused_at():
        if given.sd == COLUMN:
            return _of_each(sds, length, given, **common, shared=unknown.shared)
        if isinstance(sd, float) and isinstance(length, float) and not (given.model_error or spread):
            return PointErrors(sd, length, **common, shared=unknown.shared)
        if unknown.shared:
            expected = "a known sd and length, no model_error and no spread"
            raise InvalidInput("noise.unknown.shared", value=True, expected=expected, remedy="Leave shared out.")
        return UnknownErrors(sd, length, **common, model_error=given.model_error, spread=spread)


def _shown(given: ConditionNoise, found: Found | None) -> PointErrors:
    seen = None if found is None else found.errors
    if seen is None:
        expected = "an observation that comes from a picture or a stack of them"
        remedy = "State the sd of the points, or write `observation: {image: …}` or `{stack: …}`."
        raise InvalidStudy("noise.sd", value=IMAGE, expected=expected, remedy=remedy)
    if given.length is not None:
        expected = "the length that the picture shows"
        remedy = "Leave it out, or state sd and length as numbers, as `strandline image` prints them."
        raise InvalidStudy("noise.sd", value=f"{IMAGE}, with a length", expected=expected, remedy=remedy)
    return seen


def require_offset(given: ConditionNoise) -> None:
    """Refuse an edge in a picture whose offset along the normals is known exactly: no threshold is."""
    stated = given.unknown is not None and "offset" in given.unknown.model_fields_set
    if given.of_points and not (given.unknown and given.unknown.offset) and (stated or given.sd != IMAGE):
        expected = "above 0 for an edge in a picture, which is always found a little too far in or out"
        remedy = f"Write `sd: {IMAGE}`, which estimates it, or about 0.1 pixels for a camera, 0.4 for OCT."
        raise InvalidStudy("noise.unknown.offset", value=0, expected=expected, remedy=remedy)


def require_unit(given: ConditionNoise, measures: Iterable[Discrepancy]) -> None:
    """Refuse an sd of observed points without a unit: the measure normal_offset has no other noise."""
    if given.sd is not None and not given.of_points and any(isinstance(one, NormalOffset) for one in measures):
        what = "noise.sd, of an observed point"
        expected = "`unit: um` or `unit: mm` beside it, for the measure normal_offset"
        remedy = f"Write `{{sd: {given.sd:g}, unit: um}}` if that is what you mean."
        raise InvalidStudy(what, value=f"{given.sd:g} without a unit", expected=expected, remedy=remedy)


def _of_each(
    sds: Float[np.ndarray, " point"] | None, length: object, given: ConditionNoise, **others: Any
) -> PointErrors:
    known = isinstance(length, float)
    if not known or given.model_error or given.spread:
        value = f"{COLUMN}, with {'a model error or a spread' if known else 'an unknown length'}"
        remedy = "Remove model_error and spread." if known else "State the length, or write `sd: unknown`."
        raise InvalidInput("noise.sd", value=value, expected="a known length and no model error", remedy=remedy)
    assert sds is not None
    return PointErrors.of_each(sds, length=length, **others)


def _in_mm(given: Stated, mm: float) -> tuple[float, float] | float | None:
    if isinstance(given, tuple):
        return mm * given[0], mm * given[1]
    return mm * given if isinstance(given, float) else None


def require_fits(noise: Noise | PointErrors | UnknownErrors, seen: Interface) -> None:
    """Refuse errors whose correlation is longer than half the observed interface."""
    if isinstance(noise, PointErrors | UnknownErrors):
        with refused_at("noise"):
            noise.require_fits(seen)


def require_inferable(noises: Sequence[object], measure: Discrepancy, *, by_field: bool) -> None:
    """Refuse unknown noise where nothing can infer it."""
    if len(noises) < 2 and any(isinstance(noise, UnknownErrors) and noise.spread for noise in noises):
        raise InvalidStudy(
            "noise.spread", value="one condition", expected="several, whose inputs may differ", remedy="Remove spread."
        )
    with refused_at():
        require_inferable_noise(noises, measure, by_field=by_field)


def require_shared(noises: Mapping[str, object]) -> None:
    """Refuse errors shared by the conditions if not all conditions share them, or state different ones."""
    stated = {
        name: (one.shift, one.rotation, one.scale) if isinstance(one, PointErrors) and one.shared else None
        for name, one in noises.items()
    }
    first = next((name for name, one in stated.items() if one is not None), None)
    other = next((name for name, one in stated.items() if first is not None and one != stated[first]), None)
    if other is not None:
        own = stated[other] is None
        raise InvalidStudy(
            f"noise.unknown.shared of condition {first}",
            value=f"condition {other} with {'its own errors' if own else 'another shift, rotation or scale'}",
            expected="the same shift, rotation and scale, shared by all conditions",
            remedy=f"State the same shift, rotation and scale for {other}, with `shared: true`, or leave shared out.",
        )


def require_stated(noises: Iterable[object], command: str) -> None:
    """Refuse unknown noise where the true model's log-likelihood is needed, which then depends on all runs."""
    found = next((noise for noise in noises if isinstance(noise, UnknownErrors)), None)
    if found is not None:
        expected = "a known sd and length, and no model error"
        remedy = "State what the study found, in summary.json under likelihood.inferred_noise."
        raise InvalidStudy(f"`{command}` needs a known noise", value=found.inferred, expected=expected, remedy=remedy)
