"""What a forward model is, and how runs of it are told apart."""

import dataclasses
import hashlib
import inspect
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from strandline.interface import Interface

__all__ = ["ForwardModel", "ModelInput", "Simulation", "declared_inputs", "fingerprint"]


@dataclass(frozen=True)
class Simulation:
    """The outcome of one successful forward run: the interface and figures about the run."""

    interface: Interface
    diagnostics: Mapping[str, float] = field(default_factory=dict)


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
        """Tell whether `value` lies in the declared range."""
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

    A plain function of the same signature serves, and may return a bare `Interface`. A model may declare `inputs`
    (a tuple of `ModelInput`) and `fingerprint` (a string that changes whenever its results do). It is pickled once
    per worker process.

    Raises:
        ForwardModelError: the run failed, with its kind.
    """

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation | Interface:
        """Run the simulator; `workdir` is an empty folder of this run's own."""
        ...


def declared_inputs(model: ForwardModel) -> tuple[ModelInput, ...]:
    """Return the inputs that `model` declares; empty where it declares none."""
    return tuple(getattr(model, "inputs", ()))


def fingerprint(model: ForwardModel) -> str:
    """Return what identifies `model` in a ledger.

    Its own `fingerprint` where it has one; otherwise a hash of its class or function source and of its fields.
    """
    own = getattr(model, "fingerprint", None)
    if isinstance(own, str):
        return own
    instance: Any = model
    subject = instance if inspect.isfunction(instance) else type(instance)
    is_record = dataclasses.is_dataclass(instance) and not isinstance(instance, type)
    fields = dataclasses.asdict(instance) if is_record else {}
    text = json.dumps([subject.__module__, subject.__qualname__, inspect.getsource(subject), fields], default=repr)
    return "python:" + hashlib.sha256(text.encode()).hexdigest()[:16]
