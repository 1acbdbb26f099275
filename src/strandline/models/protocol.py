"""What a forward model is, and what it may offer in addition to its runs: one protocol each, satisfied by the method.

All of these are optional. `undeformed` adds a check and a figure, `on_finer_mesh` adds the mesh error to `strandline
check`, `prepare_runs` is called once before the first run.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeGuard, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.foundations import require, suggestion, unfit
from strandline.interface import Interface

__all__ = [
    "DrawsFields", "Factors", "ForwardModel", "Gradient", "KeepsFolders", "KnowsUndeformed", "ModelInput",
    "PreparesRuns", "Sensitivities", "Simulation", "SolvesOnFinerMesh", "TakesFields", "UsesNames",
    "asks_sensitivities", "declared_conditions", "declared_failure_kinds", "declared_inputs", "differentiated",
    "draws_fields", "prepare_runs", "require_conditions", "require_inputs", "same_unit", "the_only_interface",
    "undeformed_interface", "vjp", "with_option", "with_sensitivities", "without_failure_budget",
    "without_sensitivities",
]  # fmt: skip

Sensitivities = Mapping[str, Mapping[str, Float[np.ndarray, "point xyz *of"]]]
"""Condition → name of an input → d(points of its interface)/d(input), in mm per unit of the input; by an input that is
a field, with a further axis for the points of the field."""
Factors = Mapping[str, Float[np.ndarray, "point xyz"]]
"""Condition → a factor for each coordinate of its interface."""
Gradient = Mapping[str, float | Float[np.ndarray, " of"]]
"""Name of an input → a derivative by it; by an input that is a field, an array for its points."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """The outcome of one successful forward run; use `Simulation.of` for a model of one unnamed condition.

    Args:
        interfaces: Interfaces by condition, all of the same specimen; "" names a single unnamed condition.
        diagnostics: Numbers that describe the run, by name.
        sensitivities: Derivatives of the interface's points, by condition and input, mm per unit of the input.
        vjp: Instead of these, a function that gets factors for the coordinates of all conditions and returns the
            derivative by each input of the sum of factors times coordinates, as an adjoint solver finds it (a
            vector–Jacobian product). A run of a study that needs sensitivities calls it once for each coordinate of
            each interface. It stays in the process of the run.
    """

    interfaces: Mapping[str, Interface]
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    sensitivities: Sensitivities = field(default_factory=dict)
    vjp: Callable[[Factors], Gradient] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "vjp": None}

    @classmethod
    def of(
        cls,
        interface: Interface,
        diagnostics: Mapping[str, float] | None = None,
        sensitivities: Mapping[str, Float[np.ndarray, "point xyz *of"]] | None = None,
    ) -> "Simulation":
        """Return the outcome of a run with one unnamed condition; `sensitivities` are keyed by input."""
        return cls({"": interface}, diagnostics or {}, {"": sensitivities} if sensitivities else {})

    @property
    def interface(self) -> Interface:
        """The only interface; an `InvalidInput` if there are several."""
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
    compute sensitivities is a dataclass with a boolean field `sensitivities` that switches them on, or a function with
    the attribute ``sensitivities = True``; they change no interface, so they are not part of its fingerprint. It may
    return a `vjp` in their place, and declares `offers_vjp` false if it cannot. A model with a method
    ``on_finer_mesh(inputs)``, which returns the interfaces by condition, lets `strandline check` report the error of
    its mesh. A model whose runs a server makes may have a method ``require_server()``, which raises an error if the
    server does not answer; a run that does not reach it ends ``killed``, with the kind ``connection``. The model is
    pickled once per worker process.

    Raises:
        ForwardModelError: the run failed, with its kind.
    """

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation | Interface:
        """Run the simulator; `workdir` is an empty folder for this run."""


@runtime_checkable
class KnowsUndeformed(Protocol):
    """A model that knows its interface before any load.

    strandline then checks the unit and the direction of an observation before the first run, and draws the interface.
    """

    def undeformed(self) -> Interface:
        """Return the undeformed interface, mm."""


@runtime_checkable
class SolvesOnFinerMesh(Protocol):
    """A model that can run on the next finer mesh: `strandline check` then reports the error of its own mesh."""

    def on_finer_mesh(self, inputs: Mapping[str, float]) -> Mapping[str, Interface]:
        """Return the interfaces by condition, mm; may raise `ForwardModelError`."""


@runtime_checkable
class DrawsFields(Protocol):
    """A model that knows velocity, pressure and displacement in its domain: the report then draws them."""

    def fields(self, inputs: Mapping[str, float]) -> Any:
        """Return the `strandline.models.biofilm.cells.fields.FlowFields` of a run; may raise `ForwardModelError`."""


def draws_fields(model: object) -> TypeGuard[DrawsFields]:
    """Return whether `model` can draw them."""
    return callable(getattr(model, "fields", None))


@runtime_checkable
class TakesFields(Protocol):
    """A model that prepares for an input that is a field, or refuses it.

    Any other model gets the values as an array by the name of the input. A model that takes a field at points of its
    own, such as those of its mesh, has a method ``field_support(name)``, which returns them as a `Support`.
    """

    def with_field(self, name: str, points: Float[np.ndarray, "point xyz"]) -> "ForwardModel":
        """Return the model whose input `name` is an array of values at these points, mm; may raise `InvalidInput`."""


@runtime_checkable
class KeepsFolders(Protocol):
    """A model that keeps the folders of its runs, which are removed otherwise.

    `keep` selects which: ``all``, ``failed`` or ``none``.
    """

    @property
    def keep(self) -> str:
        """Which folders are kept."""

    def retain(self, workdir: Path, key: str, *, ok: bool) -> Path | None:
        """Move the folder of a finished run to where it is kept and return its new path; None if it is not kept."""


@runtime_checkable
class PreparesRuns(Protocol):
    """A model with work that all runs share: it is done once, before the first run of a campaign is started.

    What it leaves on disk serves the processes that make the runs; a process that finds nothing there helps itself.
    """

    @property
    def preparation(self) -> str:
        """What is prepared, in the plural; empty if nothing is."""

    def prepare_runs(self) -> None:
        """Do that work, unless it has been done."""

    def is_prepared(self, inputs: Mapping[str, float]) -> bool:
        """Return whether a run makes use of it."""


@runtime_checkable
class UsesNames(Protocol):
    """A model that does not declare its inputs but knows which names it uses, from its templates for example."""

    def require_names(self, unknown: Iterable[str], fixed: Iterable[str]) -> None:
        """Refuse unknown inputs and fixed quantities that the model does not use, and names that are missing."""


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
            expected = f"one of {', '.join(known)}" if any(known) else "no name: the model has one condition"
            remedy = "Name the conditions of the observations as the model does."
            raise unfit("condition of an observation", name or "no name", expected, remedy)


def require_inputs(units: Mapping[str, str], fixed: Iterable[str], model: ForwardModel) -> None:
    """Refuse inputs of runs that `model` does not take: unknown ones with their units, and known ones.

    Nothing is checked if the model declares nothing about its inputs.

    Raises:
        InvalidInput: It has no such input, takes another unit, or has an input without a value.
    """
    if isinstance(model, UsesNames):
        model.require_names(units, fixed)
    declared = {item.name: item for item in declared_inputs(model)}
    for name in (*units, *fixed) if declared else ():
        remedy = suggestion(name, declared, "Remove it.")
        require(name in declared, "input that the model lacks", name, f"one of {', '.join(declared)}", remedy)
        unit = declared[name].unit
        if name in units and not same_unit(units[name], unit):
            remedy = f"Give it `unit={unit!r}`, and its prior in that unit."
            raise unfit(f"unit of {name}", units[name], f"{unit}, the unit the model takes", remedy)
    missing = [name for name in declared if name not in units and name not in fixed]
    remedy = "Give each a prior, or a number in `fixed` of the Problem."
    require(not missing, "inputs of the model", f"nothing for {', '.join(missing)}", "a value for each input", remedy)


def same_unit(one: str, other: str) -> bool:
    """Return whether two units are the same in any spelling: ``mm²/s`` is ``mm^2/s``."""
    plain = (u.replace("²", "^2").replace("³", "^3").replace("**", "^").replace(" ", "") for u in (one, other))
    return next(plain) == next(plain)


def asks_sensitivities(model: ForwardModel) -> bool:
    """Return whether runs of `model` yield sensitivities too."""
    return getattr(model, "sensitivities", False) is True


def with_sensitivities(model: Any) -> Any:
    """Return `model` with its field `sensitivities` set, or a function with the attribute ``sensitivities = True``.

    Raises:
        InvalidInput: it has neither, or does not allow the field to be set.
    """
    if _has_field(model, "sensitivities"):
        return with_option(model, "sensitivities", True)
    if asks_sensitivities(model):
        return model
    expected = "a dataclass with a field `sensitivities: bool`, or a function with the attribute `sensitivities = True`"
    remedy = "Leave sensitivities out, or give the model one of these."
    raise unfit("sensitivities of the model", "this model offers none", expected, remedy)


def without_sensitivities(model: Any) -> Any:
    """Return `model` without sensitivities, the same object each time; unchanged if it has no field for them."""
    global _last_without
    if not _has_field(model, "sensitivities"):
        return model
    if _last_without is None or _last_without[0] is not model:
        _last_without = model, with_option(model, "sensitivities", False)
    return _last_without[1]


_last_without: tuple[Any, Any] | None = None
"""A model and the one without sensitivities, which keeps what it has prepared from run to run."""


def vjp(
    model: ForwardModel, inputs: Mapping[str, Any], factors: Factors | Callable[[Simulation], Factors], workdir: Path
) -> tuple[Simulation, Gradient]:
    """Run `model`; return its simulation, and d(Σ factors · coordinates)/d(input) by each input.

    With the derivatives of a function by the interface's points as factors, mm, this is the gradient of that function.
    With the built-in cell this costs 0.4 of a run, however many inputs there are. A condition without factors does
    not count. Sensitivities serve a model without `vjp` in its simulation.

    Args:
        model: The simulator.
        inputs: Its inputs by name.
        factors: Factors by condition, or a function that returns them for the simulation.
        workdir: An empty folder for the run.

    Raises:
        InvalidInput: The model offers neither; factors of an unknown condition or of the wrong shape.
        ForwardModelError: The run fails.
    """
    remedy = "Let the model return a `vjp` or sensitivities, or use another."
    offers = getattr(model, "offers_vjp", True)
    require(offers, "derivatives of the model", "this model offers none", "a vjp or sensitivities", remedy)
    returned = model(inputs, workdir)
    found = Simulation.of(returned) if isinstance(returned, Interface) else returned
    given = factors(found) if callable(factors) else factors
    weights = {name: np.zeros(interface.points.shape) for name, interface in found.interfaces.items()}
    for name, values in given.items():
        shape, fits = np.shape(values), weights[name].shape if name in weights else None
        words = f"{fits}, that of the points" if fits else f"factors of {', '.join(weights)}"
        require(shape == fits, f"factors of {name or 'the interface'}", shape if fits else "no such condition", words)
        weights[name] = np.asarray(values, float)
    if found.vjp is not None:
        return found, found.vjp(weights)
    slopes = found.sensitivities
    has = all(slopes.get(name) for name in weights)
    require(has, "derivatives of the model", "a run returned none", "a vjp or sensitivities", remedy)
    names = next(iter(slopes.values()))
    return found, {of: sum(np.tensordot(weights[one], slopes[one][of], 2) for one in weights) for of in names}


def differentiated(simulation: Simulation) -> Sensitivities:
    """Return the sensitivities of a simulation, from its `vjp` if it has that alone: a call for each coordinate."""
    if simulation.sensitivities or simulation.vjp is None:
        return simulation.sensitivities
    zeros = {name: np.zeros(interface.points.shape) for name, interface in simulation.interfaces.items()}
    found: dict[str, dict[str, np.ndarray]] = {}
    for name, zero in zeros.items():
        units: Any = np.eye(zero.size).reshape(-1, *zero.shape)
        rows = [simulation.vjp({**zeros, name: unit}) for unit in units]
        columns = {of: np.array([row[of] for row in rows], float) for of in rows[0]}
        found[name] = {of: column.reshape(*zero.shape, *column.shape[1:]) for of, column in columns.items()}
    return found


def without_failure_budget(model: Any) -> Any:
    """Return `model` with its field `failure_budget`, if any, at 0: no limit on the search for a failure's cause."""
    return with_option(model, "failure_budget", 0) if _has_field(model, "failure_budget") else model


def with_option(model: Any, name: str, value: object) -> Any:
    """Return `model` with another value of one of its fields, or of those of the model in it."""
    own = getattr(type(model), "with_option", None)
    return dataclasses.replace(model, **{name: value}) if own is None else own(model, name, value)


def the_only_interface(interfaces: Mapping[str, Interface]) -> Interface:
    """Return the single interface in a mapping by condition.

    Raises:
        InvalidInput: there are several, or none.
    """
    if len(interfaces) != 1:
        found = f"the conditions {', '.join(interfaces)}" if interfaces else "no condition"
        raise unfit("the interface of a run", found, "one condition", "Choose one of `interfaces` by its name.")
    return next(iter(interfaces.values()))


def _has_field(model: Any, name: str) -> bool:
    if hasattr(type(model), "with_option"):
        return _has_field(model.model, name)
    is_record = dataclasses.is_dataclass(model) and not isinstance(model, type)
    return is_record and any(f.name == name and f.init for f in dataclasses.fields(model))


def prepare_runs(model: ForwardModel, announce: Callable[[str], object] | None = None) -> None:
    """Let a model prepare its runs, if there is anything to prepare; `announce` is called with what it is before."""
    if isinstance(model, PreparesRuns) and model.preparation:
        if announce is not None:
            announce(model.preparation)
        model.prepare_runs()


def undeformed_interface(model: ForwardModel) -> Interface | None:
    """Return the interface before any load, mm; None if `model` does not know it.

    Raises:
        InvalidInput: `undeformed` is not a method, or does not return an interface.
    """
    if not isinstance(model, KnowsUndeformed):
        return None
    found: Any = model.undeformed() if callable(model.undeformed) else None
    if not isinstance(found, Interface):
        what, shown = f"undeformed interface of {type(model).__name__}", f"a {type(found).__name__}"
        expected = "a method undeformed() that returns an Interface"
        remedy = "Correct the model; strandline.testing.simulators checks it."
        raise unfit(what, shown if callable(model.undeformed) else "an attribute", expected, remedy)
    return found
