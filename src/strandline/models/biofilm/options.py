"""Options and inputs of the biofilm model: plain mappings, lists and numbers of a study file, checked and converted."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from strandline.foundations import InvalidInput, is_finite, unfit
from strandline.interface import is_condition
from strandline.models.biofilm.equations.flow import DROP, PRESSURE, PROFILES, RATE, as_pairs
from strandline.models.biofilm.equations.memory import MOST_BRANCHES
from strandline.models.biofilm.materials import Law, further_parameters
from strandline.models.biofilm.mesh.course import QUASI_STATIC, TRANSIENT, Course
from strandline.models.protocol import ModelInput

SMALL_STRAIN = (
    ModelInput("E", "Pa", 0.0, np.inf, low_included=False, high_included=False, meaning="Young's modulus"),
    ModelInput("nu", "1", -1.0, 0.5, low_included=False, meaning="Poisson's ratio"),
)
_SMALLEST_BUDGET = 3
LEAVE_OUT = "Leave one of the two out."
_LOADS = {"inflow_rates": ("inflow rate", RATE, "mm^2/s", 50), "pressure_drops": ("pressure drop", DROP, "Pa", 5)}
"""Option → what it gives for each condition, the input in whose place it is, its unit as text, an example."""


@dataclass(frozen=True)
class SolidInputs:
    """Inputs of a law: E, nu and its further parameters, or E1, nu1, …, E2, … of several parts."""

    law: Law
    parts: int

    @property
    def all(self) -> tuple[ModelInput, ...]:
        """Inputs, part by part."""
        return tuple(_of_part(item, number) for number in self._numbers for item in self._parameters)

    @property
    def names(self) -> list[str]:
        """Names, parameter by parameter: E1, E2, …, nu1, …, as `FlowCell.sensitivities` orders them."""
        return [item.name + number for item in self._parameters for number in self._numbers]

    def values(self, inputs: Mapping[str, float]) -> list[list[float]]:
        """Return Young's moduli, Poisson's ratios and further parameters, each for every part."""
        return [[float(inputs[item.name + number]) for number in self._numbers] for item in self._parameters]

    @property
    def _parameters(self) -> tuple[ModelInput, ...]:
        return (*SMALL_STRAIN, *further_parameters(self.law))

    @property
    def _numbers(self) -> list[str]:
        """What names of inputs end with: the number of the part; nothing if there is one."""
        return [""] if self.parts == 1 else [str(k) for k in range(1, self.parts + 1)]


def _of_part(item: ModelInput, number: str) -> ModelInput:
    """Return a parameter of the law as an input of part `number`; empty if there is one part."""
    if not number:
        return item
    return dataclasses.replace(item, name=item.name + number, meaning=f"{item.meaning} of part {number}")


def as_inflow(value: Any) -> Any:
    """Return the name of a profile, or the pairs of ``{table: …}`` as tuples."""
    if isinstance(value, Mapping) and set(value) == {"table"}:
        return as_pairs(value["table"])
    if isinstance(value, str | tuple):
        return value
    names = ", ".join([*PROFILES, PRESSURE])
    raise _refused("inflow", value, f"one of {names}, module:name, or {{table: [[y, v], …]}} with y in mm")


def as_loads(option: str, loads: Any) -> tuple[tuple[str, float], ...]:
    """Return a mapping name → inflow rate or pressure drop as pairs."""
    what, _, unit, example = _LOADS[option]
    if not isinstance(loads, Mapping):
        shown = f"{{slow: {example}, fast: {2 * example}}}"
        raise _refused(option, loads, f"{what}s in {unit} by the name of the condition, e.g. {shown}")
    return tuple((name, _load(option, name, load)) for name, load in loads.items())


as_inflow_rates = partial(as_loads, "inflow_rates")
as_pressure_drops = partial(as_loads, "pressure_drops")


def check_budget(budget: object) -> None:
    """Refuse a number of Jacobians that is neither 0 nor large enough."""
    if isinstance(budget, bool) or not isinstance(budget, int) or (budget != 0 and budget < _SMALLEST_BUDGET):
        expected = f"a whole number of Jacobians, at least {_SMALLEST_BUDGET}, or 0 for no limit"
        raise _refused("failure_budget", budget, expected)


def check_loads(rates: Sequence[tuple[str, float]], drops: Sequence[tuple[str, float]], inflow: object) -> None:
    """Refuse inflow rates [mm²/s] with a given pressure, pressure drops [Pa] without one, and loads below 0."""
    for option, loads, other, fits in (
        ("inflow_rates", rates, "pressure_drops", inflow != PRESSURE),
        ("pressure_drops", drops, "inflow_rates", inflow == PRESSURE),
    ):
        if loads and not fits:
            fitting = "a profile of the inflow" if other == "pressure_drops" else f"inflow: {PRESSURE}"
            remedy = f"Change `inflow`, or give `{other}` by condition."
            raise _refused(option, f"inflow: {inflow}", f"{fitting}, or no {option}", remedy)
        for name, load in loads:
            _load(option, name, load)


def _load(option: str, name: object, load: object) -> float:
    """Return a load; refuse what is no number, 0 or more, with the name of a condition."""
    what, model_input, unit, example = _LOADS[option]
    if is_finite(load) and model_input.admits(float(load)) and is_condition(name) and name:
        return float(load)
    expected = f"the name of a condition with its {what} in {unit}, 0 or more, e.g. slow: {example}"
    raise _refused(f"{what} {name!r}", load, expected)


def check_course(course: Course | None, *, several: bool, branches: object, sensitivities: bool) -> None:
    """Refuse a course, or Maxwell branches, with what does not go with them, such as loads of `several` experiments."""
    if isinstance(branches, bool) or branches not in range(MOST_BRANCHES + 1):
        raise _refused("branches", branches, f"a whole number from 0 to {MOST_BRANCHES}")
    if branches and (course is None or course.is_transient):
        found = f"branches: {branches} with {'no course' if course is None else f'motion: {TRANSIENT}'}"
        expected = f"a course with motion: {QUASI_STATIC}, in which the solid creeps"
        raise _refused("branches", found, expected, "Add such a course, or remove the branches.")
    if branches and sensitivities:
        expected = "no branches, or no sensitivities: a solid that creeps offers none"
        raise _refused("sensitivities", f"sensitivities with branches: {branches}", expected, LEAVE_OUT)
    if course is not None and several:
        found = "a course with inflow_rates or pressure_drops"
        remedy = "Remove one of the two; V_in or p_drop is an input of a model with a course."
        raise _refused("course", found, "one of the two", remedy)
    if course is not None and sensitivities and course.is_transient:
        expected = f"motion: {QUASI_STATIC}, or no sensitivities: a transient run offers none"
        raise _refused("sensitivities", f"sensitivities with motion: {TRANSIENT}", expected, LEAVE_OUT)


def _refused(option: str, value: object, expected: str, remedy: str = "Correct it.") -> InvalidInput:
    return unfit(f"{option} of the biofilm model", value, expected, remedy)
