"""A forward model of your own: a Python function, named in the study file."""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.models.protocol import (
    ModelInput,
    Simulation,
    declared_conditions,
    declared_failure_kinds,
    declared_inputs,
    earlier_fingerprint,
    fingerprint,
    with_sensitivities,
)

__all__ = ["PythonModel"]


@dataclass(frozen=True)
class PythonModel:
    """The simulator ``function(inputs, workdir)``, found by the name of its module.

    It is called with the inputs by name and an empty folder of the run's own, and returns a `Simulation`, an
    `Interface`, or the points (point, 2) of an open polyline in mm, in order along the interface. A run that fails
    raises `ForwardModelError`. Any callable object at the top level of a module works.

    The function may carry four attributes: ``inputs``, a tuple of `ModelInput`, ``fingerprint``, a text,
    ``conditions``, the names under which a `Simulation` of several interfaces holds them, and ``failure_kinds``, the
    kinds with which it raises `ForwardModelError`. Without ``inputs`` nothing is known of units and of the values that
    make sense: the study's unit (optional then) is taken as it stands and no range is checked. Without ``fingerprint``
    runs belong to the source of the function's file and of the files of the same package, or beside it, that this
    imports; code that it calls elsewhere can change unnoticed.

    Args:
        function: ``module:name``; the module must be importable (installed, or on PYTHONPATH).
        sensitivities: Whether the callable, a dataclass with a field of that name, computes them too.
        function_alone: Have the fingerprint cover the function's own source alone, as in ledgers of version 0.1.

    Raises:
        InvalidInput: there is no such module, or no such callable in it, or it offers no sensitivities.
    """

    function: str
    sensitivities: bool = False
    function_alone: bool = False

    def __post_init__(self) -> None:
        self._target()

    @property
    def inputs(self) -> tuple[ModelInput, ...]:
        """What the function declares of its inputs; empty where it declares nothing."""
        return declared_inputs(_found(self.function))

    @property
    def conditions(self) -> tuple[str, ...]:
        """The conditions that the function declares; a single unnamed one where it declares none."""
        return declared_conditions(_found(self.function))

    @property
    def failure_kinds(self) -> tuple[str, ...] | None:
        """The kinds of failure that the function declares; None where it does not say."""
        return declared_failure_kinds(_found(self.function))

    @property
    def fingerprint(self) -> str:
        """Changes with the source of the function's file and package, or as its own ``fingerprint`` says."""
        try:
            return (earlier_fingerprint if self.function_alone else fingerprint)(_found(self.function))
        except (OSError, TypeError):
            raise InvalidInput(
                f"the source of {self.function} cannot be read",
                value=self.function,
                expected="a function written in Python, or one with an attribute `fingerprint`",
                remedy="Give it an attribute `fingerprint`, a text that changes whenever its results do.",
            ) from None

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Any:
        """Return what the function returns, points as an `Interface`; anything else makes the run invalid."""
        result = self._target()(inputs, workdir)
        return result if isinstance(result, Simulation | Interface) else _polyline(result)

    def _target(self) -> Any:
        found = _found(self.function)
        return with_sensitivities(found) if self.sensitivities else found


def _polyline(points: Any) -> Any:
    """Return the polyline through (point, 2) numbers, and anything else as it is."""
    try:
        array = np.asarray(points, float)
    except (TypeError, ValueError):
        array = np.empty(0)
    return Interface.polyline(array) if array.ndim == 2 and array.shape[1] == 2 else points


def _found(target: object) -> Any:
    """Return the callable ``module:name``."""
    module, separator, name = target.partition(":") if isinstance(target, str) else ("", "", "")
    if not (module and separator and name):
        raise _refused(target, "module:name, e.g. my_model:simulate")
    try:
        found: Any = importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise _refused(target, f"a module that can be imported ({error})") from None
        raise _refused(target, f"a module that can be imported; there is none called {error.name}") from None
    except Exception as error:
        raise _refused(target, f"a module that can be imported ({type(error).__name__}: {error})") from None
    for part in name.split("."):
        found = getattr(found, part, None)
    if not callable(found):
        raise _refused(target, f"a callable {name} in {module}")
    return found


def _refused(target: object, expected: str) -> InvalidInput:
    return InvalidInput(
        "function of the Python model",
        value=target,
        expected=expected,
        remedy="Correct the name, install the module, or put its folder on PYTHONPATH.",
    )
