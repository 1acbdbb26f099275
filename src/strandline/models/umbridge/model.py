"""A simulator behind UM-Bridge as a forward model, and the conversion of its blocks of numbers to an interface."""

import functools
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError, of_extra, require, unfit
from strandline.interface import Interface
from strandline.models.protocol import Factors, Gradient, ModelInput, Simulation
from strandline.models.umbridge.client import PROTOCOL_VERSION, Client, Description
from strandline.readers import TO_MM


@dataclass(frozen=True)
class BlockLayout:
    """Where a model's output holds the coordinates of an interface.

    Args:
        shape: ``points``: block 0 holds x0, y0, x1, y1, …; ``columns``: block 0 holds the x's, block 1 the y's.
        dim: Number of coordinates: 2 for a polyline through the points in their order, 3 for a surface; its triangles,
            three node numbers from 0 each, are the block after the coordinates.
        closed: Whether a polyline returns to its first point.
    """

    shape: Literal["points", "columns"] = "points"
    dim: Literal[2, 3] = 2
    closed: bool = False

    def __post_init__(self) -> None:
        if self.closed and self.dim == 3:
            raise unfit("closed", self.closed, "false for a surface; polylines only return to their first point")

    @property
    def coordinate_blocks(self) -> int:
        """Number of output blocks that hold coordinates; a surface's triangles are in the next one."""
        return 1 if self.shape == "points" else self.dim

    def points(self, blocks: Sequence[Float[np.ndarray, " number"]]) -> Float[np.ndarray, "point xyz"]:
        """Return the coordinates, or their derivatives, that `coordinate_blocks` blocks hold; fails as ``protocol``."""
        if len(blocks) < self.coordinate_blocks:
            raise _unfit(blocks, f"at least {self.coordinate_blocks} blocks")
        if self.shape == "points":
            if blocks[0].size % self.dim:
                raise _unfit(blocks, f"{self.dim} numbers for each point in block 0")
            return np.ascontiguousarray(blocks[0].reshape(-1, self.dim))
        columns = blocks[: self.dim]
        if len({column.size for column in columns}) > 1:
            raise _unfit(blocks, f"as many numbers in each of the first {self.dim} blocks")
        return np.stack(list(columns), axis=1)

    def blocks(self, points: Float[np.ndarray, "point xyz"]) -> list[Float[np.ndarray, " number"]]:
        """Return the blocks that hold these coordinates, or factors for them."""
        return [points.ravel()] if self.shape == "points" else [*points.T]

    def interface(self, blocks: Sequence[Float[np.ndarray, " number"]], factor: float) -> Interface:
        """Return the interface, `factor` mm per unit; fails as `points`, without triangles, or as InvalidInterface."""
        points = factor * self.points(blocks)
        if self.dim == 2:
            return Interface.polyline(points, closed=self.closed)
        if len(blocks) <= self.coordinate_blocks:
            raise _unfit(blocks, "a block with the triangles after the coordinates")
        corners = blocks[self.coordinate_blocks]
        if corners.size % 3 or (corners != np.round(corners)).any():
            raise _unfit(blocks, "three whole numbers for each triangle")
        return Interface(points, corners.reshape(-1, 3).astype(np.int64))


def flattened(interface: Interface) -> list[list[float]]:
    """Return the blocks of `interface` in the layout ``points``, mm: coordinates, then a surface's triangles."""
    blocks = [interface.points.ravel().tolist()]
    return blocks if interface.dim == 2 else [*blocks, interface.cells.astype(float).ravel().tolist()]


def _unfit(blocks: Sequence[Any], expected: str) -> ForwardModelError:
    sizes = [len(block) for block in blocks]
    return ForwardModelError("protocol", f"the model's output has blocks of {sizes} numbers; expected {expected}")


@dataclass(frozen=True)
class InputBlocks:
    """Names of a model's inputs by block, and their units, which are empty unless all are known."""

    names: tuple[tuple[str, ...], ...]
    units: Mapping[str, str]

    @classmethod
    def read(cls, given: object) -> "InputBlocks":
        """Return what a study file states: a block of names, or a list of blocks; a name may carry its unit."""
        nested = isinstance(given, list) and bool(given) and all(isinstance(block, list) for block in given)
        blocks: Any = given if nested else [given]
        lists = [block if isinstance(block, list) else [] for block in blocks]
        pairs = [[_name_and_unit(item) for item in block] for block in lists]
        flat = [pair for block in pairs for pair in block]
        named = all(isinstance(name, str) and name and type(unit) in (str, int, type(None)) for name, unit in flat)
        if not (all(lists) and named) or len({name for name, _ in flat}) < len(flat):
            expected = "names in the model's order, [E, nu], or by block, [[E, nu], [V_in]]; with units [E: Pa]"
            raise unfit("", given, expected, "Name each input once.")
        units = {name: str(unit) for name, unit in flat if unit is not None}
        names = tuple(tuple(name for name, _ in block) for block in pairs)
        return cls(names, units if len(units) == len(flat) else {})

    def __iter__(self) -> Iterator[ModelInput]:
        """Yield the inputs with their units, without limits on their values; none if the units are unknown."""
        return (ModelInput(name, unit, -np.inf, np.inf) for name, unit in self.units.items())


@dataclass(frozen=True)
class UMBridgeModel:
    """A model on a UM-Bridge server, called for each run; its description is requested once and kept.

    Runs are identified by the model's name, its config, the order of the inputs, the layout and unit of its output, the
    version of the protocol and `version`, but not by the address of the server. If a model changes under the same name,
    this goes unnoticed: change `version`. Sensitivities are found by ApplyJacobian, one call for each input, or, if the
    server lacks it, by Gradient, one call for each coordinate.

    An input that is a field has a block of its own, with its values in the order of its points.

    Args:
        url: URL of the server.
        name: Name of the model on the server.
        inputs: Names of the inputs in the model's order: a list is a single block of inputs, a list of lists several
            blocks. A name may carry its unit, ``{E: Pa}``; if all do, the study's units and names are checked against
            them.
        interface: Layout of the output, see `BlockLayout`.
        unit: Unit of the coordinates: mm, um, µm or m.
        config: Configuration sent with every call.
        timeout: Largest duration of a call, seconds.
        version: Any text that distinguishes this server's model from its earlier versions; another one needs new runs.
        sensitivities: Whether the server computes derivatives too.
        at_once: Number of evaluations that the server makes at a time.

    Raises:
        InvalidInput: An option that cannot be used, or httpx is missing. Nothing is sent to the server yet.
    """

    url: str
    name: str
    inputs: InputBlocks = field(metadata={"read": InputBlocks.read})
    interface: BlockLayout | None = None
    unit: Literal["mm", "um", "µm", "m"] = "mm"
    config: Mapping[str, Any] | None = None
    timeout: float = 600.0
    version: str | float | int | None = None
    sensitivities: bool = False
    at_once: int = 1
    failure_kinds: ClassVar[tuple[str, ...]] = ("connection", "protocol", "model_error", "inputs", "no_sensitivities")

    def __post_init__(self) -> None:
        of_extra("httpx", "umbridge", "the package httpx, which calls the server")
        if self.at_once < 1:
            raise unfit("at_once", self.at_once, "at least 1")
        config = self.client.config
        try:
            json.dumps(config, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise unfit("config", f"{config!r} ({error})", "keys with values that JSON can hold") from None

    @functools.cached_property
    def client(self) -> Client:
        return Client(self.url, self.name, dict(self.config or {}), self.timeout)

    @property
    def layout(self) -> BlockLayout:
        """Where the output holds the interface."""
        return self.interface or BlockLayout()

    @property
    def fingerprint(self) -> str:
        """Text that changes with everything the class lists, but not with the address of the server."""
        version = "" if self.version is None else str(self.version)
        own = [self.name, self.client.config, self.inputs.names, asdict(self.layout), TO_MM[self.unit], version]
        text = json.dumps([PROTOCOL_VERSION, *own], sort_keys=True)
        return "umbridge:" + hashlib.sha256(text.encode()).hexdigest()[:16]

    @functools.cached_property
    def description(self) -> Description:
        """The server's description of the model, requested once; fails as `Client.describe`."""
        return self.client.describe()

    def require_server(self) -> None:
        """Return if the server answers; fails as `Client.describe`."""
        self.client.describe()

    def __call__(self, inputs: Mapping[str, Any], workdir: Path) -> Simulation:
        """Return the interface that the server computes.

        Raises ForwardModelError: ``connection``, ``timeout``, ``protocol``, ``model_error`` or ``non_finite``, see the
        client; ``inputs`` if the study's are not the model's; ``no_sensitivities``; or InvalidInterface.
        """
        known = {name for block in self.inputs.names for name in block}
        if set(inputs) != known:
            odd = ", ".join(sorted(set(inputs) ^ known))
            expected = "the same names in the study (inputs, fixed) and in model.umbridge.inputs"
            raise ForwardModelError("inputs", f"{odd}: expected {expected}")
        values = [np.concatenate([np.ravel(inputs[name]) for name in block]).tolist() for block in self.inputs.names]
        described, sizes = self.description, [len(block) for block in values]
        if list(described.input_sizes) != sizes:
            taken = f"the model {self.name!r} takes blocks of {list(described.input_sizes)} inputs"
            raise ForwardModelError("protocol", f"{taken}; `inputs` names blocks of {sizes}")
        output = self.client.evaluate(values, described.output_sizes)
        interface = self.layout.interface(output, TO_MM[self.unit])
        slopes = {"": self._slopes(values)} if self.sensitivities else {}
        vjp = functools.partial(self._pulled_back, values) if described.support.get("Gradient") else None
        return Simulation({"": interface}, {}, slopes, vjp)

    def _pulled_back(self, values: list[list[float]], factors: Factors) -> Gradient:
        """Return d(Σ factors · coordinates)/d(input), by a call of Gradient for each pair of blocks."""
        gradient: dict[str, Any] = {}
        weights = self.layout.blocks(TO_MM[self.unit] * factors[""])
        for into, block in enumerate(self.inputs.names):
            parts = [self.client.gradient(out, into, values, one, self.description) for out, one in enumerate(weights)]
            gradient |= _by_name(block, np.sum(parts, axis=0))
        return gradient

    def with_field(self, name: str, points: Float[np.ndarray, "point xyz"]) -> "UMBridgeModel":
        """Return the model itself; refuse a field without a block of its own."""
        blocks = [list(block) for block in self.inputs.names]
        expected, remedy = f"a block [{name}] of its own", f"Write e.g. `inputs: [[{name}], [nu]]`."
        require((name,) in self.inputs.names, f"the field {name}", f"inputs: {blocks}", expected, remedy)
        return self

    def _slopes(self, values: list[list[float]]) -> dict[str, Float[np.ndarray, "point xyz *of"]]:
        """Return d(points)/d(input) by input, mm per unit of the input; by a field with an axis for its points."""
        described = self.description
        if not (described.support.get("ApplyJacobian") or described.support.get("Gradient")):
            message = "the server supports neither ApplyJacobian nor Gradient; leave sensitivities out"
            raise ForwardModelError("no_sensitivities", message)
        slopes: dict[str, np.ndarray] = {}
        for into, block in enumerate(self.inputs.names):
            outputs = range(self.layout.coordinate_blocks)
            by_output = [self.client.jacobian(out, into, values, described) for out in outputs]
            columns = [
                TO_MM[self.unit] * self.layout.points([jacobian[:, number] for jacobian in by_output])
                for number in range(len(values[into]))
            ]
            slopes |= _by_name(block, np.stack(columns))
        return slopes


def _by_name(names: Sequence[str], found: Float[np.ndarray, "number *_"]) -> dict[str, Any]:
    """Return the derivatives by the numbers of a block, by input; those by a field have its points as last axis."""
    several = len(names) > 1 or len(found) == 1
    return dict(zip(names, found, strict=True)) if several else {names[0]: np.moveaxis(found, 0, -1)}


def _name_and_unit(item: Any) -> tuple[Any, Any]:
    return next(iter(item.items())) if isinstance(item, Mapping) and len(item) == 1 else (item, None)
