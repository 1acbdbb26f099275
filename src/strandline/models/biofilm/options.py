"""Options of the biofilm model as plain mappings, lists and numbers of a study file, checked and converted."""

import dataclasses
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from strandline.errors import InvalidInput
from strandline.interface import is_condition
from strandline.models.biofilm.course import QUASI_STATIC, TRANSIENT, Course
from strandline.models.biofilm.fluid import Fluid
from strandline.models.biofilm.inflow import DROP, PRESSURE, PROFILES, RATE, as_pairs
from strandline.models.biofilm.memory import MOST_BRANCHES
from strandline.models.biofilm.subdivision import Partition, check_partition

__all__ = ["as_inflow", "as_loads", "check_budget", "check_course", "check_loads", "converted", "one_of"]

_SMALLEST_BUDGET = 3
_FROM_FILE = {"outline": "; in a study file also file with its unit in place of points, which are in mm"}


def one_of(what: str, value: object, choices: Mapping[str, Any]) -> None:
    """Refuse a value that is none of the choices."""
    if value not in choices:
        raise InvalidInput(
            f"{what} of the biofilm model",
            value=value,
            expected=f"one of {', '.join(choices)}",
            remedy="Choose one of them.",
        )


def converted(name: str, value: object, kind: Any) -> Any:
    """Return `value` as the record `kind`, made from a plain mapping or a named preset."""
    if isinstance(value, kind):
        return value
    if isinstance(value, str) and value in getattr(kind, "PRESETS", {}):
        return kind.PRESETS[value]
    known = {field.name for field in dataclasses.fields(kind)}
    if not isinstance(value, Mapping) or not set(value) <= known:
        unknown = sorted(set(value) - known) if isinstance(value, Mapping) else []
        close = get_close_matches(str(unknown[0]), known, n=1) if unknown else []
        raise InvalidInput(
            f"{name} of the biofilm model",
            value=", ".join(map(str, unknown)) or value,
            expected=f"a mapping with keys among {', '.join(sorted(known))}{_FROM_FILE.get(name, '')}",
            remedy=f"Did you mean {close[0]}?" if close else "Correct it.",
        )
    if kind is Fluid:
        return Fluid(**{key: float(v) if _is_number(v) else v for key, v in value.items()})
    if kind is Partition:
        check_partition(**value)
    lengths = {field.name for field in dataclasses.fields(kind) if field.type is float}
    for key in lengths & set(value):
        if not _is_number(value[key]):
            raise InvalidInput(
                f"{key} of the {name}",
                value=value[key],
                expected="a number in mm, without a unit",
                remedy="Correct it.",
            )
    return kind(**{key: float(v) if key in lengths else _as_tuples(v) for key, v in value.items()})


def as_inflow(value: Any) -> Any:
    """Return the name of a profile, or the pairs of ``{table: …}`` as tuples."""
    if isinstance(value, Mapping) and set(value) == {"table"}:
        return as_pairs(value["table"])
    if isinstance(value, str | tuple):
        return value
    raise InvalidInput(
        "inflow of the biofilm model",
        value=value,
        expected=f"one of {', '.join([*PROFILES, PRESSURE])}, module:name, or {{table: [[y, v], …]}} with y in mm",
        remedy="Correct it.",
    )


def _as_tuples(value: Any) -> Any:
    """Return nested lists as nested tuples of numbers, which can be compared and hashed."""
    if not isinstance(value, list | tuple):
        return value
    return tuple(float(item) if _is_number(item) else _as_tuples(item) for item in value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


_LOADS = {"inflow_rates": ("inflow rate", RATE, "mm^2/s", 50), "pressure_drops": ("pressure drop", DROP, "Pa", 5)}
"""Option → what it gives for each condition, the input in whose place it is, its unit as text, an example."""


def as_loads(option: str, loads: Any) -> tuple[tuple[str, float], ...]:
    """Return a mapping name → inflow rate or pressure drop as pairs."""
    what, _, unit, example = _LOADS[option]
    if not isinstance(loads, Mapping):
        raise InvalidInput(
            f"{option} of the biofilm model",
            value=loads,
            expected=f"{what}s in {unit} by the name of the condition, e.g. {{slow: {example}, fast: {2 * example}}}",
            remedy="Correct them.",
        )
    for name, load in loads.items():
        _check_load(option, name, load)
    return tuple((name, float(load)) for name, load in loads.items())


def check_budget(budget: object) -> None:
    """Refuse a number of Jacobians that is neither 0 nor large enough."""
    if isinstance(budget, bool) or not isinstance(budget, int) or (budget != 0 and budget < _SMALLEST_BUDGET):
        raise InvalidInput(
            "failure_budget of the biofilm model",
            value=budget,
            expected=f"a whole number of Jacobians, at least {_SMALLEST_BUDGET}, or 0 for no limit",
            remedy="Correct it.",
        )


def check_loads(rates: Sequence[tuple[str, float]], drops: Sequence[tuple[str, float]], inflow: object) -> None:
    """Refuse inflow rates with a given pressure, pressure drops without one, and loads that are no numbers, 0 or more.

    Args:
        rates: Inflow rates by condition, mm²/s.
        drops: Pressure drops by condition, Pa.
        inflow: Profile of the inflow, or ``pressure``.
    """
    if rates and inflow == PRESSURE:
        name, rate = rates[0]
        raise InvalidInput(
            "inflow_rates of the biofilm model",
            value=f"{name}: {rate} with inflow: {PRESSURE}",
            expected="a profile of the inflow, or no inflow rates",
            remedy="Remove one of the two, or give `pressure_drops` by condition.",
        )
    if drops and inflow != PRESSURE:
        name, drop = drops[0]
        raise InvalidInput(
            "pressure_drops of the biofilm model",
            value=f"{name}: {drop} without inflow: {PRESSURE}",
            expected=f"inflow: {PRESSURE}, or no pressure drops",
            remedy=f"Add `inflow: {PRESSURE}`, or give `inflow_rates` by condition.",
        )
    for option, loads in (("inflow_rates", rates), ("pressure_drops", drops)):
        for name, load in loads:
            _check_load(option, name, load)


def _check_load(option: str, name: object, load: object) -> None:
    """Refuse what is no number, 0 or more, with the name of a condition."""
    what, model_input, unit, example = _LOADS[option]
    admitted = isinstance(load, int | float) and _is_number(load) and model_input.admits(float(load))
    if not admitted or not is_condition(name) or not name:
        raise InvalidInput(
            f"{what} {name!r} of the biofilm model",
            value=load,
            expected=f"the name of a condition with its {what} in {unit}, 0 or more, e.g. slow: {example}",
            remedy=f"Correct the {what}.",
        )


def check_course(course: Course | None, *, several: bool, branches: object, sensitivities: bool) -> None:
    """Refuse a course with what it cannot be combined with.

    Args:
        course: Course of the inflow; None: steady.
        several: Whether inflow rates or pressure drops of several experiments are given, too.
        branches: Number of Maxwell branches of the solid.
        sensitivities: Whether runs return sensitivities.

    Raises:
        InvalidInput: Several experiments are given too; sensitivities of a transient run or of a solid that creeps are
            asked for; branches without a quasi-static course, or an impossible number of them.
    """
    _check_branches(branches, course)
    if branches and sensitivities:
        raise InvalidInput(
            "sensitivities of the biofilm model",
            value=f"sensitivities with branches: {branches}",
            expected="no branches, or no sensitivities: a solid that creeps offers none",
            remedy="Leave one of the two out.",
        )
    if course is None:
        return
    if several:
        raise InvalidInput(
            "course of the biofilm model",
            value="a course with inflow_rates or pressure_drops",
            expected="one of the two",
            remedy="Remove one of the two; V_in or p_drop is an input of a model with a course.",
        )
    if sensitivities and course.is_transient:
        raise InvalidInput(
            "sensitivities of the biofilm model",
            value=f"sensitivities with motion: {TRANSIENT}",
            expected=f"motion: {QUASI_STATIC}, or no sensitivities: a transient run offers none",
            remedy="Leave sensitivities out, or choose the other motion.",
        )


def _check_branches(branches: object, course: Course | None) -> None:
    if isinstance(branches, bool) or branches not in range(MOST_BRANCHES + 1):
        raise InvalidInput(
            "branches of the biofilm model",
            value=branches,
            expected=f"a whole number from 0 to {MOST_BRANCHES}",
            remedy="Correct it.",
        )
    if branches and (course is None or course.is_transient):
        raise InvalidInput(
            "branches of the biofilm model",
            value=f"branches: {branches} with {'no course' if course is None else f'motion: {TRANSIENT}'}",
            expected=f"a course with motion: {QUASI_STATIC}, in which the solid creeps",
            remedy="Add such a course, or remove the branches.",
        )
