"""A model that takes fields, with their coefficients as inputs in place of their values."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError, require
from strandline.interface import Interface
from strandline.models import protocol
from strandline.models.identity import fingerprint
from strandline.parameters import RandomField

__all__ = ["WithFields"]


@dataclass(frozen=True, eq=False)
class WithFields:
    """A model and the fields that it takes; in all else it is the model.

    A run gets, by the name of each field, an array with its values at its points. Sensitivities by a field have a
    further axis, its points.

    Args:
        model: The simulator.
        random_fields: Its fields; the inputs of a run are the `parameters` of these, in their place, and the other
            inputs.

    Raises:
        InvalidInput: The model has no such input, or does not take a field, or not at these points.
    """

    model: protocol.ForwardModel
    random_fields: tuple[RandomField, ...]

    def __post_init__(self) -> None:
        declared = [item.name for item in protocol.declared_inputs(self.model)]
        for one in self.random_fields:
            words = f"one of {', '.join(declared)}", "Correct the name."
            require(not declared or one.name in declared, "field that the model lacks", one.name, *words)
            if isinstance(self.model, protocol.TakesFields):
                object.__setattr__(self, "model", self.model.with_field(one.name, one.support.points))

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> protocol.Simulation | Interface:
        found = self.model(self._given(inputs), workdir)
        if not (isinstance(found, protocol.Simulation) and (found.sensitivities or found.vjp)):
            return found
        slopes = cache(lambda: {one.name: one.slopes(_of(inputs, one)) for one in self.random_fields})
        by_coefficient = {name: self._by_coefficient(of, slopes(), 3) for name, of in found.sensitivities.items()}
        own = found.vjp
        vjp = None if own is None else lambda factors: self._by_coefficient(own(factors), slopes(), 1)
        return replace(found, sensitivities=by_coefficient, vjp=vjp)

    def _given(self, inputs: Mapping[str, float]) -> dict[str, Any]:
        """Return what the model takes: the values of each field in place of its inputs."""
        left_out = {name for one in self.random_fields for name in one.names}
        scalars = {name: value for name, value in inputs.items() if name not in left_out}
        return scalars | {one.name: one.values(_of(inputs, one)) for one in self.random_fields}

    def _drawn(self, inputs: Mapping[str, float], *condition: str) -> Any:
        return self.model.fields(self._given(inputs), *condition)  # type: ignore[attr-defined]

    def _by_coefficient(self, found: Mapping[str, Any], slopes: Mapping[str, np.ndarray], axes: int) -> dict[str, Any]:
        """Return derivatives by the coefficients in place of those by the fields, whose points are the last axis."""
        out = {name: values for name, values in found.items() if name not in slopes}
        for one in self.random_fields:
            shape, points = np.shape(found.get(one.name, 0.0)), len(one.support.points)
            if len(shape) != axes or shape[-1] != points:
                expected = f"(point, xyz, {points})" if axes == 3 else f"({points},)"
                message = f"those by the field {one.name} have the shape {shape}; expected {expected}"
                raise ForwardModelError("sensitivities", message)
            out |= zip(one.names, np.moveaxis(found[one.name] @ slopes[one.name], -1, 0), strict=True)
        return out

    @property
    def inputs(self) -> tuple[protocol.ModelInput, ...]:
        """The inputs of the model, with those of each field in its place; empty if the model declares none."""
        of = {
            one.name: [protocol.ModelInput(p.name, p.unit, -np.inf, np.inf) for p in one.parameters]
            for one in self.random_fields
        }
        return tuple(new for item in protocol.declared_inputs(self.model) for new in of.get(item.name, [item]))

    def require_names(self, unknown: Iterable[str], fixed: Iterable[str]) -> None:
        """Let a model that knows its names check them, with the fields in place of their coefficients."""
        if isinstance(self.model, protocol.UsesNames):
            coefficients = {name for one in self.random_fields for name in one.names}
            others = [name for name in unknown if name not in coefficients]
            self.model.require_names([*others, *(one.name for one in self.random_fields)], fixed)

    def with_option(self, name: str, value: object) -> "WithFields":
        """Return it with another option of the model."""
        return WithFields(protocol.with_option(self.model, name, value), self.random_fields)

    @property
    def fingerprint(self) -> str:
        """Text that changes with the model, the priors of its fields, or their points by more than a millionth."""
        digest = hashlib.sha256(fingerprint(self.model).encode())
        for one in self.random_fields:
            digest.update(f"{one.name}{one.prior!r}".encode())
            for array in (one.support.points, one.support.weights):
                largest = np.abs(array).max()
                digest.update(f"{largest:.6e}".encode() + np.round(array / largest, 6).tobytes())
        return f"fields:{digest.hexdigest()[:16]}"

    def __getattr__(self, name: str) -> Any:
        """Return what the model itself offers or declares."""
        if name.startswith("__") or name == "on_finer_mesh" or "model" not in self.__dict__:  # a field of other points
            raise AttributeError(name)
        found = getattr(self.model, name)
        return self._drawn if name == "fields" else found  # those of `DrawsFields`, at the values of its own


def fields_of(model: protocol.ForwardModel) -> tuple[RandomField, ...]:
    """Return the fields among the inputs of a model; empty if there are none. Of known inputs, see their space."""
    return tuple(getattr(model, "random_fields", ()))


def _of(inputs: Mapping[str, float], one: RandomField) -> Float[np.ndarray, " input"]:
    return np.array([inputs[name] for name in one.names])
