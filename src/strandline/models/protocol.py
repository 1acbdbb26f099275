"""What a forward model is, and what distinguishes its runs."""

import dataclasses
import hashlib
import inspect
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.models.sources import sources_of

__all__ = [
    "ForwardModel",
    "ModelInput",
    "Sensitivities",
    "Simulation",
    "asks_sensitivities",
    "declared_conditions",
    "declared_failure_kinds",
    "declared_inputs",
    "earlier_fingerprint",
    "fingerprint",
    "require_conditions",
    "the_only_interface",
    "with_sensitivities",
    "without_failure_budget",
]

Sensitivities = Mapping[str, Mapping[str, Float[np.ndarray, "point xyz"]]]
"""Condition → name of an input → d(points of its interface)/d(input), in mm per unit of the input."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """The outcome of one successful forward run; use `Simulation.of` for a model of one unnamed condition.

    Args:
        interfaces: Interfaces by condition, all of the same specimen; "" names a single unnamed condition.
        diagnostics: Numbers that describe the run, by name.
        sensitivities: Derivatives of the interface's points, by condition and input, mm per unit of the input.
    """

    interfaces: Mapping[str, Interface]
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    sensitivities: Sensitivities = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        interface: Interface,
        diagnostics: Mapping[str, float] | None = None,
        sensitivities: Mapping[str, Float[np.ndarray, "point xyz"]] | None = None,
    ) -> "Simulation":
        """Return the outcome of a run with one unnamed condition; `sensitivities` are keyed by input."""
        return cls({"": interface}, diagnostics or {}, {"": sensitivities} if sensitivities else {})

    @property
    def interface(self) -> Interface:
        """The only interface.

        Raises:
            InvalidInput: there are several.
        """
        return the_only_interface(self.interfaces)


@dataclass(frozen=True)
class ModelInput:
    """One input that a model declares: its unit (``1`` for a pure number) and the values that make sense."""

    name: str
    unit: str
    low: float
    high: float
    low_included: bool = True
    high_included: bool = True
    meaning: str = ""

    def admits(self, value: float) -> bool:
        """Return whether `value` lies in the declared range."""
        above = self.low <= value if self.low_included else self.low < value
        below = value <= self.high if self.high_included else value < self.high
        return above and below

    def range_text(self) -> str:
        """Return the range in interval notation."""
        left, right = "[" if self.low_included else "(", "]" if self.high_included else ")"
        return f"{left}{self.low:g}, {self.high:g}{right}"


@runtime_checkable
class ForwardModel(Protocol):
    """A simulator: inputs by name → the interface it predicts.

    A plain function of the same signature works too. It may return a bare `Interface`, which is one unnamed condition.
    A model may declare `inputs` (a tuple of `ModelInput`) and `fingerprint` (a string that changes whenever its results
    do). If a run yields several interfaces, or one with a name, the model declares their `conditions` (a tuple of
    names). It may declare `failure_kinds` (a tuple of words); a study then accepts no other kinds of failure. It may
    declare `at_once`, the largest number of runs under way; executors then start no more workers. A model that can
    compute sensitivities is a dataclass with a boolean field `sensitivities` that switches them on; they change no
    interface, so they are not part of its fingerprint. A model with a method ``on_finer_mesh(inputs)``, which returns
    the interfaces by condition, lets `strandline check` report the error of its mesh. A model whose runs a server makes
    may have a method ``require_server()``, which raises an error if the server does not answer; a run that does not
    reach it ends ``killed``, with the kind ``connection``. The model is pickled once per worker process.

    Raises:
        ForwardModelError: the run failed, with its kind.
    """

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation | Interface:
        """Run the simulator; `workdir` is an empty folder for this run."""
        ...


def declared_inputs(model: ForwardModel) -> tuple[ModelInput, ...]:
    """Return the inputs that `model` declares; empty if it declares none."""
    return tuple(getattr(model, "inputs", ()))


def declared_conditions(model: ForwardModel) -> tuple[str, ...]:
    """Return the conditions for which each run of `model` yields an interface; a single unnamed one by default."""
    return tuple(getattr(model, "conditions", ("",)))


def declared_failure_kinds(model: ForwardModel) -> tuple[str, ...] | None:
    """Return the kinds of `ForwardModelError` that `model` declares; None if it declares none."""
    declared = getattr(model, "failure_kinds", None)
    return None if declared is None else tuple(declared)


def require_conditions(observed: Iterable[str], model: ForwardModel) -> None:
    """Refuse an observed condition that `model` does not have.

    Raises:
        InvalidInput: There is one; the message lists the conditions of the model.
    """
    known = declared_conditions(model)
    for name in observed:
        if name not in known:
            raise InvalidInput(
                "condition of an observation",
                value=name or "no name",
                expected=f"one of {', '.join(known)}" if any(known) else "no name: the model has one condition",
                remedy="Name the conditions of the observations as the model does.",
            )


def asks_sensitivities(model: ForwardModel) -> bool:
    """Return whether runs of `model` yield sensitivities too."""
    return getattr(model, "sensitivities", False) is True


def with_sensitivities(model: Any) -> Any:
    """Return `model` with its field `sensitivities` set.

    Raises:
        InvalidInput: it has no such field, or does not allow it to be set.
    """
    if _has_field(model, "sensitivities"):
        return dataclasses.replace(model, sensitivities=True)
    raise InvalidInput(
        "sensitivities of the model",
        value="this model offers none",
        expected="a dataclass with a field `sensitivities: bool`",
        remedy="Leave sensitivities out, or give the model that field.",
    )


def without_failure_budget(model: Any) -> Any:
    """Return `model` with its field `failure_budget`, if any, at 0: no limit on the search for a failure's cause."""
    return dataclasses.replace(model, failure_budget=0) if _has_field(model, "failure_budget") else model


def the_only_interface(interfaces: Mapping[str, Interface]) -> Interface:
    """Return the single interface in a mapping by condition.

    Raises:
        InvalidInput: there are several, or none.
    """
    if len(interfaces) != 1:
        raise InvalidInput(
            "the interface of a run",
            value=f"the conditions {', '.join(interfaces)}" if interfaces else "no condition",
            expected="one condition",
            remedy="Choose one of `interfaces` by its name.",
        )
    return next(iter(interfaces.values()))


def _has_field(model: Any, name: str) -> bool:
    is_record = dataclasses.is_dataclass(model) and not isinstance(model, type)
    return is_record and any(f.name == name and f.init for f in dataclasses.fields(model))


def fingerprint(model: ForwardModel) -> str:
    """Return the text that identifies `model` in a ledger.

    This is its own `fingerprint` if it has one, plus the options of the instance if the class has one fingerprint for
    all instances. Otherwise it is a hash of the class or function, the file that defines it, the files of the same
    package that this file imports, and the fields except `sensitivities`, which change no interface.
    """
    own = getattr(model, "fingerprint", None)
    if isinstance(own, str):
        return own + _options_beside(model)
    subject, fields = _described(model)
    try:
        sources = sources_of(subject.__module__)
    except OSError:  # typed into a notebook or a terminal
        return earlier_fingerprint(model)
    text = json.dumps([subject.__module__, subject.__qualname__, sources, fields], default=repr)
    return "python-files:" + hashlib.sha256(text.encode()).hexdigest()[:16]


def _options_beside(model: Any) -> str:
    """Return the options that differ from their defaults, if a dataclass has one fingerprint for all instances.

    A fingerprint declared as a ``ClassVar`` states on purpose that no option changes results.
    """
    kind = type(model)
    declared = "fingerprint" in inspect.get_annotations(kind)
    if not dataclasses.is_dataclass(model) or declared or not isinstance(vars(kind).get("fingerprint"), str):
        return ""
    given = {
        f.name: value
        for f in dataclasses.fields(model)
        if f.init and f.name != "sensitivities" and repr(value := getattr(model, f.name)) != repr(_default(f))
    }
    return f"/{json.dumps(given, default=repr, sort_keys=True)}" if given else ""


def _default(field: "dataclasses.Field[Any]") -> Any:
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def earlier_fingerprint(model: ForwardModel) -> str:
    """Return the fingerprint used before the whole file counted: it covers only the source of the class or function."""
    own = getattr(model, "fingerprint", None)
    if isinstance(own, str):
        return own
    subject, fields = _described(model)
    text = json.dumps([subject.__module__, subject.__qualname__, inspect.getsource(subject), fields], default=repr)
    return "python:" + hashlib.sha256(text.encode()).hexdigest()[:16]


def _described(model: ForwardModel) -> tuple[Any, dict[str, Any]]:
    """Return the function, or the class and the fields, that `model` is made of."""
    instance: Any = model
    subject = instance if inspect.isfunction(instance) else type(instance)
    is_record = dataclasses.is_dataclass(instance) and not isinstance(instance, type)
    fields = dataclasses.asdict(instance) if is_record else {}
    fields.pop("sensitivities", None)
    return subject, fields
