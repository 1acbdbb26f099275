"""`next` of study.yaml → candidates for the next experiment, with one clear line for any mistake in it."""

from collections.abc import Mapping
from itertools import product
from typing import Any

from strandline.errors import InvalidStudy
from strandline.models.protocol import ForwardModel, declared_conditions
from strandline.parameters import ParameterSpace
from strandline.planning.candidate import Candidate, Look, candidates
from strandline.planning.view import FEWEST_POINTS, WHOLE
from strandline.readers.options import TO_MM
from strandline.registry import suggestion
from strandline.studies.inputs import check_values
from strandline.text import decimal

__all__ = ["read_candidates"]

LOOKS = ("condition", "part", "points", "sd")
"""Keys that say what is observed; all others but `unit` and `together` are quantities to set."""
MOST_TOGETHER = 3
MOST = 500
"""Largest number of candidates."""


def read_candidates(
    given: Mapping[str, Any], model: ForwardModel, space: ParameterSpace, fixed: Mapping[str, float]
) -> tuple[Candidate, ...]:
    """Return the candidates that study.yaml lists; none if it lists none.

    Args:
        given: Content of `next`.
        model: The simulator.
        space: The unknown inputs.
        fixed: The known inputs by name.

    Raises:
        InvalidStudy: A key or a value that does not make sense, or too many candidates.
    """
    if not given:
        return ()
    rest = {name: value for name, value in given.items() if name not in (*LOOKS, "unit", "together")}
    values = {name: _values(name, value, model, space, fixed) for name, value in rest.items()}
    found = candidates(values, _looks(given, model), together=_together(given), present=fixed)
    if len(found) > MOST:
        raise InvalidStudy(
            "next: too many candidates",
            value=len(found),
            expected=f"at most {MOST}",
            remedy="List fewer values, or lower `together`.",
        )
    return found


def _values(
    name: str, given: Any, model: ForwardModel, space: ParameterSpace, fixed: Mapping[str, float]
) -> list[float]:
    """Return the values of a quantity, which must be known or a nuisance."""
    settable = [*fixed, *(space.names[k] for k in space.nuisance)]
    if name not in settable:
        calibrated = name in space.names
        raise InvalidStudy(
            f"next.{name}",
            value="an input to calibrate" if calibrated else "no such quantity",
            expected=f"a fixed quantity or a nuisance input ({', '.join(settable) or 'there is none'}), or "
            f"{', '.join((*LOOKS, 'unit', 'together'))}",
            remedy="Remove it: an experiment cannot set what is to be inferred."
            if calibrated
            else suggestion(name, (*settable, *LOOKS, "together"), "Correct the name."),
        )
    values = [_number(f"next.{name}", one) for one in _list(f"next.{name}", given, "[25, 50]")]
    for value in values:
        check_values({name: value}, model, "next")
        if name in space.names and not space[name].interval[0] <= value <= space[name].interval[1]:
            raise InvalidStudy(
                f"next.{name}",
                value=value,
                expected=f"a value in the box of this input, {list(space[name].interval)}: no run was made outside it",
                remedy="Correct the value, or make the box wider and run the study again.",
            )
    return values


def _looks(given: Mapping[str, Any], model: ForwardModel) -> list[Look]:
    conditions = [_condition(one, model) for one in _list("next.condition", given.get("condition", [""]), "[slow]")]
    parts = [_part(one) for one in _list("next.part", given.get("part", [list(WHOLE)]), "[[0, 0.5], [0.5, 1]]")]
    points = [_points(one) for one in _list("next.points", given.get("points", [None]), "[20, 100]")]
    sds = [_sd(one, given.get("unit")) for one in _list("next.sd", given.get("sd", [None]), "[1, 3]")]
    return [Look(*row) for row in product(conditions, parts, points, sds)]


def _condition(given: Any, model: ForwardModel) -> tuple[str, ...]:
    known = declared_conditions(model)
    names = [given] if isinstance(given, str) else given
    if given == "" or (isinstance(names, list) and names and all(one in known and one for one in names)):
        return () if given == "" else tuple(names)
    raise InvalidStudy(
        "next.condition",
        value=given,
        expected=f"names among {', '.join(known)}"
        if any(known)
        else "no such key, since the model has a single condition",
        remedy="Correct the name." if any(known) else "Remove it.",
    )


def _part(given: Any) -> tuple[float, float]:
    ends = [_number("next.part", one) for one in given] if isinstance(given, list) else []
    if len(ends) == 2 and 0 <= ends[0] < ends[1] <= 1:
        return ends[0], ends[1]
    raise InvalidStudy(
        "next.part",
        value=given,
        expected="pairs of shares of the interface's length, e.g. [[0, 0.5], [0.5, 1]]",
        remedy="Correct it.",
    )


def _points(given: Any) -> int | None:
    if given is None or (type(given) is int and FEWEST_POINTS <= given <= 100_000):
        return given
    raise InvalidStudy(
        "next.points", value=given, expected=f"whole numbers from {FEWEST_POINTS} to 100000", remedy="Correct it."
    )


def _sd(given: Any, unit: Any) -> float | None:
    if given is None:
        return None
    if unit not in TO_MM:
        raise InvalidStudy("next.unit", value=unit, expected=f"one of {', '.join(TO_MM)}", remedy="Add `unit: um`.")
    value = _number("next.sd", given)
    if value > 0:
        return value * TO_MM[unit]
    raise InvalidStudy("next.sd", value=given, expected="numbers above 0", remedy="Correct it.")


def _together(given: Mapping[str, Any]) -> int:
    number = given.get("together", 1)
    if type(number) is int and 1 <= number <= MOST_TOGETHER:
        return number
    raise InvalidStudy(
        "next.together",
        value=number,
        expected=f"a whole number from 1 to {MOST_TOGETHER}: how many experiments may be made together",
        remedy="Correct it.",
    )


def _list(place: str, given: Any, example: str) -> list[Any]:
    if isinstance(given, list) and given:
        return given
    raise InvalidStudy(place, value=given, expected=f"a list, e.g. {example}", remedy="Correct it.")


def _number(place: str, given: Any) -> float:
    number = decimal(given) if isinstance(given, str) else given
    if isinstance(number, int | float) and not isinstance(number, bool) and abs(number) < float("inf"):
        return float(number)
    raise InvalidStudy(place, value=given, expected="finite numbers", remedy="Correct it.")
