"""One forward run: its request, its outcome, and the only place where a simulator is called."""

import contextlib
import errno
import hashlib
import json
import math
import os
import time
import traceback
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from strandline import models
from strandline.foundations import ForwardModelError, InvalidInterface, require
from strandline.interface import Interface, is_condition
from strandline.models import ForwardModel, Sensitivities, Simulation
from strandline.runs.ledger.ledger_schema import EXCLUDED, LOG_TITLE

State = Literal["ok", "failed", "timeout", "killed", "invalid", "excluded"]
ENDS: tuple[State, ...] = ("ok", "failed", "timeout", "killed", "invalid")
"""How a run ends: with an interface | failed by itself | out of time | its process vanished | with an unusable result.

In addition, a ledger reports ``excluded`` for a run excluded by hand, however it ended.
"""

MESSAGE_CHARACTERS = 4000
MESSAGE_LOG_LINES = 10
TRACEBACK_LINES = 12
CALLER = str(Path("strandline", "models", "python.py"))
FOLDER_TITLE = "its folder: "


@dataclass(frozen=True)
class RunRequest:
    """A run to be made: its content address and its inputs by name; a `plain` one without sensitivities, even if the
    model is asked for them.
    """

    key: str
    inputs: Mapping[str, float]
    plain: bool = False


NOT_NOW = RunRequest("", {})
"""Stands in for a request: there is nothing to start now, but there may be later; see `Executor`."""


@dataclass(frozen=True, eq=False)
class RunRecord:
    """The outcome of one run. Every end except `ok` is data, not an exception.

    `key` is the content address of the run, see `run_key`, `state` one of `ENDS`, or ``excluded``. The predicted
    interfaces by condition are empty unless it ended ``ok``. `diagnostics` are numbers about the run, if it failed the
    evidence of the failure; `seconds` are wall-clock time. If it did not end ``ok``, `failure_kind` is a short
    machine-readable reason, `message` the reason in words, with the last lines of the log, and `log` the end of its
    standard output and error. `origin` is the ledger that it was copied from; None for a run made here. `sensitivities`
    are derivatives d(points)/d(input) by condition and input, mm per unit of the input; empty if not requested, of a
    plain run those of each condition.
    """

    key: str
    inputs: Mapping[str, float]
    state: State
    interfaces: Mapping[str, Interface] = field(default_factory=dict)
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    failure_kind: str | None = None
    message: str | None = None
    log: str = ""
    origin: str | None = None
    sensitivities: Sensitivities = field(default_factory=dict)

    @property
    def interface(self) -> Interface | None:
        """The only interface, or that of the first condition; None if the run did not end ``ok``."""
        return next(iter(self.interfaces.values()), None)

    @property
    def ok(self) -> bool:
        """Whether the run yielded what the model promises."""
        return self.state == "ok"

    @property
    def final(self) -> bool:
        """Whether repeating the run would be pointless; only a run whose process vanished deserves another try."""
        return self.state != "killed"

    def settles(self, *, sensitivities: bool) -> bool:
        """Return whether the run need not be made again, given whether `sensitivities` are requested."""
        return self.final and (not sensitivities or not self.ok or bool(self.sensitivities))


def excluded(record: RunRecord, why: str) -> RunRecord:
    """Return the record of a run excluded by hand: the run is not used, and not made again."""
    return RunRecord(record.key, record.inputs, EXCLUDED, failure_kind=EXCLUDED, message=f"excluded by hand: {why}")


def run_key(fingerprint: str, inputs: Mapping[str, float]) -> str:
    """Return the content address of a run: sha256 of the model's fingerprint and the exact inputs, by sorted name.

    Raises:
        InvalidInput: an input is not a finite number.
    """
    values, remedy = sorted(inputs.items()), "Correct the design or the prior it comes from."
    for name, value in values:
        require(math.isfinite(value), f"input {name} of a run", value, "a finite number", remedy)
    exact = [[name, (float(value) + 0.0).hex()] for name, value in values]
    return hashlib.sha256(json.dumps([fingerprint, exact]).encode()).hexdigest()


def attempt(model: ForwardModel, request: RunRequest, workdir: Path) -> RunRecord:
    """Call `model` in the empty folder `workdir` and return its outcome; of its exceptions only Ctrl-C is passed on."""
    begin, log = time.perf_counter(), ""
    plain = request.plain and models.asks_sensitivities(model)
    try:
        model = models.without_sensitivities(model) if plain else model
        with _working_directory_kept():
            returned = model(dict(request.inputs), workdir)
        good = checked(returned, model, request.inputs)
        figures = _figures(good.diagnostics)
        slopes = {condition: {} for condition in good.interfaces} if plain else good.sensitivities
        ending = RunRecord(request.key, request.inputs, "ok", good.interfaces, figures, sensitivities=slopes)
    except ForwardModelError as error:
        ending, log = ended(request, error.state, error.kind, error.message, error.evidence), error.log
    except InvalidInterface as error:
        ending = ended(request, "invalid", "invalid_interface", str(error))
    except (Exception, SystemExit) as error:
        ending = ended(request, "failed", "exception", _told(error, request))
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
            ending = replace(ending, state="killed", failure_kind="out_of_memory")  # the machine may be less busy later
    return with_log(_retained(replace(ending, seconds=time.perf_counter() - begin), model, workdir), log)


def with_log(record: RunRecord, log: str) -> RunRecord:
    """Return `record` with the end of its log, whose last lines also end its message; unchanged if it is ok."""
    log = _clean(log).strip()
    if record.ok or not log:
        return record
    lines = "\n".join(log.splitlines()[-MESSAGE_LOG_LINES:])
    return replace(record, log=log, message=_short(f"{record.message or record.state}\n{LOG_TITLE}\n{lines}"))


def _retained(record: RunRecord, model: ForwardModel, workdir: Path) -> RunRecord:
    """Let a model that keeps folders keep the one of this run; if it does, the message says where."""
    if not isinstance(model, models.KeepsFolders):
        return record
    try:
        kept: Path | str | None = model.retain(workdir, record.key, ok=record.ok)
    except Exception as error:
        kept = f"not kept: {error}"
    if record.ok or kept is None:
        return record
    return replace(record, message=f"{record.message}\n{FOLDER_TITLE}{kept}")


def told_folder(record: RunRecord) -> str:
    """Return the line of the message that says where the folder of the run is kept; empty if it is not kept."""
    reason, _, _ = (record.message or "").partition(f"\n{LOG_TITLE}\n")
    return next((line for line in reason.splitlines() if line.startswith(FOLDER_TITLE)), "")


@contextlib.contextmanager
def _working_directory_kept() -> Iterator[None]:
    """Restore the present working directory afterwards: the model may change it."""
    try:
        home = Path.cwd()
    except FileNotFoundError:
        home = Path.home()
    try:
        yield
    finally:
        os.chdir(home)


def ended(
    request: RunRequest, state: State, kind: str, message: str, evidence: Mapping[str, float] | None = None
) -> RunRecord:
    """Return the record of a run without an interface; `kind` and `message` say why."""
    figures, message = _figures(evidence or {}), _short(_clean(message))
    return RunRecord(request.key, request.inputs, state, {}, figures, failure_kind=_clean(kind), message=message)


def _figures(given: Mapping[str, object]) -> dict[str, float]:
    """Return the entries that are numbers, since a text in the diagnostics must not cost the run its interface."""
    numbers = {}
    for name, value in given.items():
        with contextlib.suppress(TypeError, ValueError):
            numbers[_clean(str(name))] = float(value)  # type: ignore[arg-type]
    return numbers


def _told(error: BaseException, request: RunRequest) -> str:
    """Return type, message and the last lines of the traceback of `error`, without those of the caller."""
    reason = "".join(traceback.format_exception_only(error)).strip()
    if isinstance(error, KeyError) and error.args and error.args[0] not in [*request.inputs]:
        reason += f" (the model was given {', '.join(request.inputs)}; if it needs more, add it to inputs or fixed)"
    frames = [one for one in traceback.format_tb(error.__traceback__)[1:] if CALLER not in one]
    lines = "".join(frames).splitlines()[-TRACEBACK_LINES:]
    return "\n".join([reason, *lines])


def _clean(text: str) -> str:
    """Return `text` without characters that UTF-8 cannot hold."""
    return text.encode("utf-8", "replace").decode()


def _short(text: str) -> str:
    """Return `text` without its middle if it is too long: the reason and the last lines stay."""
    half = MESSAGE_CHARACTERS // 2
    return text if len(text) <= MESSAGE_CHARACTERS else f"{text[:half]}\n[…]\n{text[-half:]}"


def checked(result: object, model: ForwardModel, inputs: Collection[str]) -> Simulation:
    """Check what a model returned and return a copy that shares no memory with the model.

    Raises ForwardModelError, ``invalid``: there is no interface, the conditions differ from those declared, a number is
    not finite, or requested sensitivities are missing or do not belong to interfaces and inputs.
    """
    conditions, asked = models.declared_conditions(model), models.asks_sensitivities(model)
    simulation = Simulation.of(result) if isinstance(result, Interface) else result
    found: Any = getattr(simulation, "interfaces", None)
    sound = isinstance(found, Mapping) and found and all(isinstance(one, Interface) for one in found.values())
    if not isinstance(simulation, Simulation) or not sound:
        found = _described(result)
        expected = "expected a Simulation or an Interface. Correct the model's return value."
        raise _invalid("not_an_interface", f"the model returned {found}; {expected}")
    _require_conditions(simulation.interfaces, conditions)
    interfaces = {name: _copied(name, interface) for name, interface in simulation.interfaces.items()}
    given: Any = simulation.sensitivities
    if asked and not given and simulation.vjp is not None:
        given = models.differentiated(simulation)
    if asked and not (isinstance(given, Mapping) and all(given.get(name) for name in interfaces)):
        found = "the model was asked for sensitivities and returned none for at least one condition"
        remedy = "Return them by condition and input, or take the field `sensitivities` from the model."
        raise _invalid("sensitivities", f"{found}. {remedy}")
    return Simulation(interfaces, simulation.diagnostics, _sensitivities(given, interfaces, inputs))


def _require_conditions(given: Mapping[str, Interface], declared: Collection[str]) -> None:
    bad = [name for name in given if not is_condition(name)]
    if bad:
        expected = "expected a short name without slashes. Correct the name."
        raise _invalid("conditions", f"the model returned an interface of the condition {bad[0]!r}; {expected}")
    if set(given) != set(declared):
        found = f"the model returned interfaces of {_listed(given)}; expected {_listed(declared)}"
        remedy = "Its attribute `conditions`, a tuple, must name those that it returns."
        raise _invalid("conditions", f"{found}. {remedy}")


def _copied(condition: str, interface: Interface) -> Interface:
    points = np.array(interface.points, dtype=np.float64, order="C")
    if not np.isfinite(points).all():
        bad = f"{np.count_nonzero(~np.isfinite(points))} of {points.size} coordinates"
        raise _invalid("non_finite", f"{bad} of the interface{_of(condition)} are not finite")
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


def _unfit(problem: str) -> ForwardModelError:
    return _invalid("sensitivities", f"sensitivities: {problem}. Correct what the model returns.")


def _invalid(kind: str, message: str) -> ForwardModelError:
    return ForwardModelError(kind, message, state="invalid")


def _of(condition: str) -> str:
    return f" of {condition}" if condition else ""


def _listed(names: Collection[str]) -> str:
    return ", ".join(name or "one unnamed condition" for name in names) or "no condition"


def _described(result: object) -> str:
    if isinstance(result, np.ndarray):
        return f"an array of the shape {result.shape}"
    return type(result).__name__ + (" without interfaces" if isinstance(result, Simulation) else "")
