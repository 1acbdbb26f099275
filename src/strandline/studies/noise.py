"""The noise that a study states: of the measure, or of the observed points."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import Discrepancy, NormalOffset
from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import GaussianNoise, Interface, Noise, PointErrors, UnknownErrors
from strandline.readers.options import TO_MM
from strandline.studies.chosen import refused_at
from strandline.studies.keys.observation import COLUMN, ConditionNoise, Unknown

__all__ = ["build_noise", "require_fits", "require_inferable", "require_stated"]

Stated = float | str | tuple[float, float] | None


def build_noise(
    given: ConditionNoise, names: Sequence[str], sds: Float[np.ndarray, " point"] | None = None
) -> Noise | PointErrors | UnknownErrors:
    """Return the noise that a section states, lengths in mm.

    Args:
        given: The section.
        names: Names of the inputs.
        sds: Standard deviations of the observed points, mm, if the observation holds them.

    Raises:
        InvalidStudy: The noise needs standard deviations that the observation does not hold, or names no input.
    """
    if given.unit is None:
        return GaussianNoise(given.squared)
    mm, unknown = TO_MM[given.unit], given.unknown or Unknown()
    common: dict[str, Any] = {"shift": mm * unknown.shift, "rotation": unknown.rotation, "scale": unknown.scale}
    common["offset"] = mm * unknown.offset
    sd, length = _in_mm(given.sd, mm), _in_mm(given.length or 0.0, mm)
    if given.sd == COLUMN and sds is None:
        raise InvalidStudy(
            "noise.sd",
            value=COLUMN,
            expected="a table with the standard deviation of each point",
            remedy="Name its column, `observation: {file: …, sd: COLUMN}`, or state one sd for all points.",
        )
    for name in given.spread:
        if name not in names:
            raise InvalidStudy(
                "noise.spread", value=name, expected=f"some of {', '.join(names)}", remedy="Correct the name."
            )
    spread = tuple(names.index(name) for name in given.spread)
    _require_ranges(given)
    with refused_at():
        if given.sd == COLUMN:
            return _of_each(sds, length, given, **common, shared=unknown.shared)
        if isinstance(sd, float) and isinstance(length, float) and not (given.model_error or spread):
            return PointErrors(sd, length, **common, shared=unknown.shared)
        if unknown.shared:
            raise InvalidInput(
                "noise.unknown.shared", value=True, expected="a known sd and length", remedy="Leave shared out."
            )
        return UnknownErrors(sd, length, **common, model_error=given.model_error, spread=spread)


def _require_ranges(given: ConditionNoise) -> None:
    """Refuse ranges without mass, in the unit in which they are written."""
    for name, found in (("sd", given.sd), ("length", given.length)):
        if isinstance(found, tuple) and not 0 < found[0] < found[1]:
            raise InvalidStudy(
                f"noise.{name}",
                value=list(found),
                expected="a range [low, high] with 0 < low < high",
                remedy="Correct the range, or write `unknown`.",
            )


def _of_each(
    sds: Float[np.ndarray, " point"] | None, length: object, given: ConditionNoise, **others: Any
) -> PointErrors:
    if not isinstance(length, float) or given.model_error or given.spread:
        raise InvalidInput(
            "noise.sd",
            value=f"{COLUMN}, with an unknown length or a model error",
            expected="a known length and no model error",
            remedy="State the length, or write `sd: unknown`.",
        )
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


def require_inferable(noises: Iterable[object], measure: Discrepancy, *, by_field: bool) -> None:
    """Refuse unknown noise where nothing can infer it.

    Args:
        noises: Noise of each condition.
        measure: The measure that defines the posterior.
        by_field: Whether a surrogate learns the interface.

    Raises:
        InvalidStudy: Only some conditions have unknown noise, or measure or surrogate do not fit it.
    """
    noises = list(noises)
    if len(noises) < 2 and any(isinstance(noise, UnknownErrors) and noise.spread for noise in noises):
        raise InvalidStudy(
            "noise.spread", value="one condition", expected="several, whose inputs may differ", remedy="Remove spread."
        )
    if len({(n.sd, n.length, n.model_error, n.spread) for n in noises if isinstance(n, UnknownErrors)}) > 1:
        raise InvalidStudy(
            "noise.conditions",
            value="different unknown noise",
            expected="the same sd, length, model_error and spread in all conditions",
            remedy="State them once, under noise.",
        )
    unknown = [isinstance(noise, UnknownErrors) for noise in noises]
    if any(unknown) and not (all(unknown) and by_field and isinstance(measure, NormalOffset)):
        what, expected = f"the measure {type(measure).__name__}", "the measure normal_offset"
        if not by_field:
            what, expected = (
                "a surrogate of the log-likelihood",
                "the measure normal_offset and a surrogate of the field",
            )
        elif not all(unknown):
            what, expected = "a condition without", "unknown noise, or a model error, in every condition"
        raise InvalidStudy(
            "noise: an unknown sd or length, or a model error",
            value=what,
            expected=expected,
            remedy="Write `discrepancy: {normal_offset: {}}` and `surrogate: {field: {}}`, or state the noise.",
        )


def require_stated(noises: Iterable[object], what: str) -> None:
    """Refuse unknown noise where the true model's log-likelihood is needed, which then depends on all runs.

    Raises:
        InvalidStudy: The noise of a condition is to be inferred.
    """
    if any(isinstance(noise, UnknownErrors) for noise in noises):
        raise InvalidStudy(
            f"noise of a study to {what}",
            value="unknown",
            expected="a known sd and length, and no model error",
            remedy="State what the study found, in summary.json under likelihood.inferred_noise.",
        )
