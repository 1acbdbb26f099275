"""A simulator behind UM-Bridge as a forward model."""

import functools
import hashlib
import importlib.util
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.protocol import ModelInput, Simulation
from strandline.models.umbridge.client import PROTOCOL_VERSION, Client, Description
from strandline.models.umbridge.layout import UNITS, Layout

__all__ = ["UMBridge", "UMBridgeModel"]


@dataclass(frozen=True)
class UMBridge:
    """The options of ``model: {umbridge: …}`` in a study file; `from_options` makes the model from them.

    Args:
        url: URL of the server.
        name: Name of the model on the server.
        inputs: Names of the inputs in the model's order: a list is a single block of inputs, a list of lists several
            blocks. A name may carry its unit, ``{E: Pa}``; if all do, the study's units and names are checked against
            them.
        interface: Layout of the output, see `Layout`.
        unit: Unit of the coordinates: mm, um, µm or m.
        config: Configuration sent with every call.
        timeout: Largest duration of a call, seconds.
        version: Any text that distinguishes this server's model from its earlier versions, see `UMBridgeModel`.
        sensitivities: Whether the server computes derivatives too.
        at_once: Number of evaluations that the server makes at a time.
    """

    url: str
    name: str
    inputs: Any
    interface: Any = None
    unit: str = "mm"
    config: Any = None
    timeout: float = 600.0
    version: str | float | int | None = None
    sensitivities: bool = False
    at_once: int = 1

    @classmethod
    def from_options(cls, **options: Any) -> "UMBridgeModel":
        """Return the model; nothing is sent to the server yet.

        Raises:
            InvalidInput: an option that cannot be used.
        """
        given = cls(**options)
        _require_httpx()
        names, units = _named_blocks(given.inputs)
        return UMBridgeModel(
            Client(given.url, given.name, _config(given.config), given.timeout),
            names,
            units,
            Layout.from_options(given.interface),
            given.unit,
            "" if given.version is None else str(given.version),
            given.sensitivities,
            given.at_once,
        )


@dataclass(frozen=True)
class UMBridgeModel:
    """A model on a UM-Bridge server, called for each run; its description is requested once and kept.

    Runs are identified by the model's name, its config, the order of the inputs, the layout and unit of its output, the
    version of the protocol and `version`, but not by the address of the server. If a model changes under the same name,
    this goes unnoticed: change `version`.

    Args:
        client: Client that calls the model.
        blocks: Names of the inputs by block.
        units: Units of the inputs by name; empty if they are unknown.
        layout: Layout of the output.
        unit: Unit of the coordinates, a key of `UNITS`.
        version: Part of the fingerprint.
        sensitivities: Whether runs yield d(points)/d(input) too: by ApplyJacobian, one call for each input, or, if the
            server lacks it, by Gradient, one call for each coordinate.
        at_once: Number of evaluations that the server makes at a time, and so of runs under way.

    Raises:
        InvalidInput: an unknown unit, or a number below 1.
    """

    client: Client
    blocks: tuple[tuple[str, ...], ...]
    units: Mapping[str, str] = field(default_factory=dict)
    layout: Layout = field(default_factory=Layout)
    unit: str = "mm"
    version: str = ""
    sensitivities: bool = False
    at_once: int = 1
    failure_kinds: ClassVar[tuple[str, ...]] = ("connection", "protocol", "model_error", "inputs", "no_sensitivities")

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise InvalidInput("unit", value=self.unit, expected=f"one of {', '.join(UNITS)}", remedy="Correct it.")
        if self.at_once < 1:
            raise InvalidInput("at_once", value=self.at_once, expected="at least 1", remedy="Correct the number.")

    @property
    def inputs(self) -> tuple[ModelInput, ...]:
        """The inputs with their units, without limits on their values; empty if the units are unknown."""
        return tuple(ModelInput(name, unit, -np.inf, np.inf) for name, unit in self.units.items())

    @property
    def fingerprint(self) -> str:
        """Text that changes with everything the class lists, but not with the address of the server."""
        told = [
            PROTOCOL_VERSION,
            self.client.name,
            self.client.config,
            self.blocks,
            asdict(self.layout),
            UNITS[self.unit],
            self.version,
        ]
        return "umbridge:" + hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:16]

    @functools.cached_property
    def description(self) -> Description:
        """The server's description of the model, requested once.

        Raises:
            ForwardModelError: As for `Client.describe`; or the sizes of the input blocks differ from the study's.
        """
        described = self.client.describe()
        sizes = tuple(len(block) for block in self.blocks)
        if described.input_sizes != sizes:
            raise ForwardModelError(
                "protocol",
                f"the model {self.client.name!r} takes blocks of {list(described.input_sizes)} inputs; `inputs` names "
                f"blocks of {list(sizes)}",
            )
        return described

    def require_server(self) -> None:
        """Return if the server answers.

        Raises:
            ForwardModelError: As for `Client.describe`.
        """
        self.client.describe()

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        """Return the interface that the server computes.

        Raises:
            ForwardModelError: ``connection``, ``timeout``, ``protocol``, ``model_error`` or ``non_finite``, see the
                client; ``inputs`` if the study's are not the model's; ``no_sensitivities``.
            InvalidInterface: an output that forms no interface.
        """
        self._require_inputs(inputs)
        values = [[float(inputs[name]) for name in block] for block in self.blocks]
        output = self.client.evaluate(values, self.description.output_sizes)
        interface = self.layout.interface(output, UNITS[self.unit])
        return Simulation.of(interface, {}, self._slopes(values) if self.sensitivities else None)

    def _require_inputs(self, inputs: Mapping[str, float]) -> None:
        known = {name for block in self.blocks for name in block}
        if set(inputs) != known:
            odd = ", ".join(sorted(set(inputs) ^ known))
            raise ForwardModelError(
                "inputs", f"{odd}: expected the same names in the study (inputs, fixed) and in model.umbridge.inputs"
            )

    def _slopes(self, values: list[list[float]]) -> dict[str, Float[np.ndarray, "point xyz"]]:
        """Return d(points)/d(input) by input, mm per unit of the input."""
        support = self.description.support
        if not (support.get("ApplyJacobian") or support.get("Gradient")):
            raise ForwardModelError(
                "no_sensitivities", "the server supports neither ApplyJacobian nor Gradient; leave sensitivities out"
            )
        columns = self._by_jacobian if support.get("ApplyJacobian") else self._by_gradient
        slopes = {}
        for into, block in enumerate(self.blocks):
            by_output = [columns(out, into, values) for out in range(self.layout.coordinate_blocks)]
            for number, name in enumerate(block):
                points = self.layout.points([jacobian[:, number] for jacobian in by_output])
                slopes[name] = UNITS[self.unit] * points
        return slopes

    def _by_jacobian(self, out: int, into: int, values: list[list[float]]) -> Float[np.ndarray, "number input"]:
        size, units = self.description.output_sizes[out], np.eye(len(self.blocks[into])).tolist()
        return np.stack([self.client.apply_jacobian(out, into, values, unit, size) for unit in units], axis=1)

    def _by_gradient(self, out: int, into: int, values: list[list[float]]) -> Float[np.ndarray, "number input"]:
        size, units = len(self.blocks[into]), np.eye(self.description.output_sizes[out]).tolist()
        return np.stack([self.client.gradient(out, into, values, unit, size) for unit in units])


def _named_blocks(given: object) -> tuple[tuple[tuple[str, ...], ...], dict[str, str]]:
    """Return the names by block, and the units if every name has one."""
    nested = isinstance(given, list) and bool(given) and all(isinstance(block, list) for block in given)
    blocks: Any = given if nested else [given]
    if not all(isinstance(block, list) and block for block in blocks):
        raise _wrong_inputs(given)
    entries = [[_entry(item, given) for item in block] for block in blocks]
    flat = [entry for block in entries for entry in block]
    if len({name for name, _ in flat}) < len(flat):
        raise _wrong_inputs(given)
    units = {name: unit for name, unit in flat if unit is not None}
    return tuple(tuple(name for name, _ in block) for block in entries), units if len(units) == len(flat) else {}


def _entry(item: object, given: object) -> tuple[str, str | None]:
    if isinstance(item, str) and item:
        return item, None
    if isinstance(item, Mapping) and len(item) == 1:
        ((name, unit),) = item.items()
        if isinstance(name, str) and isinstance(unit, str | int) and not isinstance(unit, bool):
            return name, str(unit)
    raise _wrong_inputs(given)


def _wrong_inputs(given: object) -> InvalidInput:
    return InvalidInput(
        "inputs",
        value=given,
        expected="names in the order of the model, [E, nu], or of its blocks, [[E, nu], [V_in]]; with units [E: Pa]",
        remedy="Name each input once.",
    )


def _config(given: object) -> dict[str, Any]:
    config = {} if given is None else given
    try:
        json.dumps(config, allow_nan=False)
    except (TypeError, ValueError) as error:
        config = f"{config!r} ({error})"
    if isinstance(config, dict) and all(isinstance(key, str) for key in config):
        return config
    raise InvalidInput(
        "config", value=config, expected="keys with values that JSON can hold", remedy="Correct the option."
    )


def _require_httpx() -> None:
    if importlib.util.find_spec("httpx") is None:
        raise InvalidInput(
            "the package httpx, which calls the server",
            value="not installed",
            expected="the extra `umbridge`",
            remedy='Install it: pip install "strandline[umbridge]"',
        )
