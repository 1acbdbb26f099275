"""Checks of what a model returned: only what the model promises is kept."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from strandline.interface import Interface, is_condition
from strandline.models.protocol import Simulation

__all__ = ["InvalidResult", "checked"]


class InvalidResult(Exception):
    """What a model returned cannot be kept; `kind` and message become the failure kind and message of the run."""

    def __init__(self, kind: str, message: str) -> None:
        self.kind = kind
        super().__init__(message)


def checked(result: object, *, conditions: Collection[str], inputs: Collection[str], sensitivities: bool) -> Simulation:
    """Check `result` and return a copy that shares no memory with the model.

    Args:
        result: what the model returned.
        conditions: conditions that the model declares.
        inputs: names of the run's inputs.
        sensitivities: whether sensitivities were requested.

    Raises:
        InvalidResult: there is no interface, the conditions differ from those declared, a number is not finite, or
            sensitivities are missing or do not belong to the interfaces.
    """
    simulation = Simulation.of(result) if isinstance(result, Interface) else result
    if not isinstance(simulation, Simulation) or not _holds_interfaces(simulation.interfaces):
        raise InvalidResult(
            "not_an_interface",
            f"the model returned {_told(result)}; expected a Simulation or an Interface. "
            "Correct the model's return value.",
        )
    _require_conditions(simulation.interfaces, conditions)
    interfaces = {name: _copied(name, interface) for name, interface in simulation.interfaces.items()}
    given = simulation.sensitivities
    if sensitivities and not (isinstance(given, Mapping) and all(given.get(name) for name in interfaces)):
        raise InvalidResult(
            "sensitivities",
            "the model was asked for sensitivities and returned none for at least one condition. Return them by "
            "condition and input, or take the field `sensitivities` from the model.",
        )
    return Simulation(interfaces, simulation.diagnostics, _sensitivities(given, interfaces, inputs))


def _holds_interfaces(given: object) -> bool:
    return isinstance(given, Mapping) and bool(given) and all(isinstance(v, Interface) for v in given.values())


def _require_conditions(given: Mapping[str, Interface], declared: Collection[str]) -> None:
    bad = [name for name in given if not is_condition(name)]
    if bad:
        raise InvalidResult(
            "conditions",
            f"the model returned an interface of the condition {bad[0]!r}; expected a short name without slashes. "
            "Correct the name.",
        )
    if set(given) != set(declared):
        raise InvalidResult(
            "conditions",
            f"the model returned interfaces of {_listed(given)}; expected {_listed(declared)}. Its attribute "
            "`conditions`, a tuple, must name those that it returns.",
        )


def _copied(condition: str, interface: Interface) -> Interface:
    points = np.array(interface.points, dtype=np.float64, order="C")
    if not np.isfinite(points).all():
        bad, where = np.count_nonzero(~np.isfinite(points)), f" of {condition}" if condition else ""
        raise InvalidResult("non_finite", f"{bad} of {points.size} coordinates of the interface{where} are not finite")
    return Interface(points, np.array(interface.cells, dtype=np.int64, order="C"))


def _sensitivities(given: Any, interfaces: Mapping[str, Interface], inputs: Collection[str]) -> dict[str, Any]:
    """Return copies of the sensitivities by condition and input."""
    if not (isinstance(given, Mapping) and all(isinstance(by_input, Mapping) for by_input in given.values())):
        raise _unfit("a mapping by condition and by input is expected")
    unknown = [name for name in given if name not in interfaces]
    unknown += [name for by_input in given.values() for name in by_input if name not in inputs]
    if unknown:
        raise _unfit(f"there is no condition or input called {unknown[0]!r}")
    return {
        condition: {name: _derivative(condition, name, value, interfaces) for name, value in by_input.items()}
        for condition, by_input in given.items()
        if by_input
    }


def _derivative(condition: str, name: str, value: Any, interfaces: Mapping[str, Interface]) -> Any:
    expected = interfaces[condition].points.shape
    try:
        array = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        raise _unfit(f"d/d{name}{_of(condition)} is not an array of numbers") from None
    if array.shape != expected:
        raise _unfit(f"d/d{name}{_of(condition)} has the shape {array.shape}; expected {expected}, that of the points")
    if not np.isfinite(array).all():
        raise _unfit(f"{np.count_nonzero(~np.isfinite(array))} numbers of d/d{name}{_of(condition)} are not finite")
    return array


def _unfit(problem: str) -> InvalidResult:
    return InvalidResult("sensitivities", f"sensitivities: {problem}. Correct what the model returns.")


def _of(condition: str) -> str:
    return f" of {condition}" if condition else ""


def _listed(names: Collection[str]) -> str:
    return ", ".join(name or "one unnamed condition" for name in names) or "no condition"


def _told(result: object) -> str:
    if isinstance(result, np.ndarray):
        return f"an array of the shape {result.shape}"
    return type(result).__name__ + (" without interfaces" if isinstance(result, Simulation) else "")
