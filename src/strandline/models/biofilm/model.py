"""The forward model of the study: a biofilm on the floor of a flow cell, bent by the flow over it."""

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from strandline.errors import InvalidInput
from strandline.interface import Interface, is_condition
from strandline.models.biofilm.cell import FlowCell, FlowFields
from strandline.models.biofilm.channel import Channel, check_inside, check_outline
from strandline.models.biofilm.flow import inlet_bottom
from strandline.models.biofilm.fluid import WATER, Fluid
from strandline.models.biofilm.foot import as_stretches, check_clamped
from strandline.models.biofilm.geometry import subdivide
from strandline.models.biofilm.inflow import DROP, PARABOLA, PRESSURE, PROFILES, RATE, Pairs, as_pairs, check_inflow
from strandline.models.biofilm.linear import linear_solver
from strandline.models.biofilm.materials import LAWS, further_parameters, law_named
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.sizes import FINER, MESHES, MeshSize, is_adapted
from strandline.models.biofilm.subdivision import Partition, check_partition
from strandline.models.protocol import ModelInput, Simulation
from strandline.models.protocol import fingerprint as fingerprint_of
from strandline.registry import imported

__all__ = ["Biofilm", "FlowFields"]

REVISION = 2
"""Raised whenever the results of the model change by more than 1e-4 µm."""
SIZES = 1
"""Raised whenever the rule changes that shrinks elements in narrow gaps and at sharp bends of the outline."""


@dataclass(frozen=True)
class Biofilm:
    """Quasi-steady fluid–structure interaction of a soft solid on the floor of a channel, plane strain.

    Water enters with a parabolic profile of volume rate V_in and leaves on the other side. The output is the deformed
    interface, mm, at the nodes of the outline from left to right. The result is reproducible to the bit. `from_options`
    takes plain mappings and lists, as in a study file.

    Args:
        mesh: ``coarse`` (488 elements with the study's outline), ``default`` (1194) or ``fine`` (3454).
        material: A law of `LAWS`: ``saint_venant_kirchhoff``, ``neo_hookean``, ``mooney_rivlin``, ``yeoh`` or ``fung``;
            or ``module:name`` of your own.
        channel: A `Channel`; by default 2 mm × 1 mm, inlet left, horizontal outflow.
        outline: An `Outline`; the study's by default.
        partition: A `Partition` of the solid into parts, each with its own E and ν.
        fluid: A `Fluid`, water by default; its ``unknown`` quantities are inputs.
        inflow: Profile of the inflow over the inlet, scaled to V_in: ``parabola``, ``plug``, ``module:name`` or pairs
            (y, v), y in mm; or ``pressure``: the pressure drop `p_drop` is an input in place of V_in.
        clamped: Stretches (from, to) of the floor, mm, where the base is held; elsewhere it slides along the floor
            without friction and does not lift. None: all of the base is held.
        inflow_rates: Inflow rate of each of several experiments with the same specimen, mm²/s, by the name of the
            condition. Each experiment gives one interface, and V_in is no longer an input.
        sensitivities: Whether runs return d(interface)/d(input) as well.
        failure_budget: Number of Jacobians after which a run gives up its search for a steady state, so that a failure
            costs about three median runs; 0: no limit, every failed run is followed around its limit point (about
            five).

    Raises:
        InvalidInput: an option that cannot be used; a degenerate outline, with the place; a linear solver that the
            environment requests but that is not installed.

    A run raises ForwardModelError with kind ``limit_point``, ``continuation_stalled``, ``inverted_elements``,
    ``unbalanced``, ``nonfinite_residual`` or ``linear_solve``, and with the load reached as evidence.
    """

    mesh: str = "default"
    material: str = "saint_venant_kirchhoff"
    channel: Channel = Channel()
    outline: Outline = Outline()
    partition: Partition = Partition()
    fluid: Fluid = WATER
    inflow: str | Pairs = PARABOLA
    clamped: Pairs = ()
    inflow_rates: tuple[tuple[str, float], ...] = ()
    sensitivities: bool = False
    failure_budget: int = 5
    failure_kinds: ClassVar[tuple[str, ...]] = (
        "limit_point",
        "continuation_stalled",
        "newton_stalled",
        "newton_maxit",
        "inverted_elements",
        "unbalanced",
        "nonfinite_residual",
        "linear_solve",
        "mesh",
    )

    def __post_init__(self) -> None:
        _one_of("mesh", self.mesh, MESHES)
        law_named(self.material)
        _check_budget(self.failure_budget)
        for name, rate in self.inflow_rates:
            _check_rate(name, rate, self.inflow)
        reference = self.outline.interface()
        check_inside(self.outline.points, self.channel)
        check_outline(reference, self.channel)
        subdivide(reference, self.channel, self.partition)
        check_clamped(self.clamped, reference)
        check_inflow(self.inflow, inlet_bottom(reference, self.channel), self.channel.height)
        linear_solver()

    @classmethod
    def from_options(cls, **options: Any) -> "Biofilm":
        """Return the model made from plain options: mappings for channel, outline, partition; inflow rates by name.

        `partition` may also be ``three_parts``, the heterogeneous specimen of the study.
        """
        for name, kind in (("channel", Channel), ("outline", Outline), ("partition", Partition), ("fluid", Fluid)):
            if name in options:
                options[name] = _converted(name, options[name], kind)
        if "inflow" in options:
            options["inflow"] = _inflow(options["inflow"])
        if "clamped" in options:
            options["clamped"] = as_stretches(options["clamped"])
        if "inflow_rates" in options:
            options["inflow_rates"] = _pairs(options["inflow_rates"])
        return cls(**options)

    @property
    def inputs(self) -> tuple[ModelInput, ...]:
        """E, nu and the law's further parameters, or E1, nu1, …, E2, … of the parts; V_in or p_drop; the fluid's."""
        solids = [_of_part(item, number) for number in self._numbers for item in self._material]
        return (*solids, *self._drive, *self.fluid.inputs)

    @property
    def _drive(self) -> tuple[ModelInput, ...]:
        """What drives the flow, if it is an input."""
        return () if self.inflow_rates else (DROP if self.inflow == PRESSURE else RATE,)

    @property
    def _material(self) -> tuple[ModelInput, ...]:
        """Parameters of the law."""
        return (*_SMALL_STRAIN, *further_parameters(law_named(self.material)))

    @property
    def _numbers(self) -> list[str]:
        """Numbers of the parts as the inputs' names end with them; nothing for a single part."""
        count = max(1, len(self.partition.markers))
        return [""] if count == 1 else [str(k) for k in range(1, count + 1)]

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the experiments, one interface each; a single unnamed one if no inflow rates are given."""
        return tuple(name for name, _ in self.inflow_rates) or ("",)

    @property
    def fingerprint(self) -> str:
        """Text that identifies the model in a ledger.

        Sensitivities do not change the interface and do not count. The rule for element sizes counts only if it takes
        effect for the outline, so the ledgers of other outlines, including the study's, stay valid.
        """
        chosen = [
            f"{field.name}={getattr(self, field.name)!r}"
            for field in dataclasses.fields(self)
            if field.name not in ("mesh", "sensitivities") and getattr(self, field.name) != field.default
        ]
        if _is_adapted(self.outline, self.mesh, self.channel):
            chosen.append(f"sizes={SIZES}")
        if self.material not in LAWS:
            chosen.append(f"law={fingerprint_of(cast(Any, law_named(self.material)))}")
        if isinstance(self.inflow, str) and ":" in self.inflow:
            chosen.append(f"profile={fingerprint_of(imported(self.inflow, 'inflow'))}")
        digest = ":" + hashlib.sha256("|".join(chosen).encode()).hexdigest()[:16] if chosen else ""
        return f"biofilm:r{REVISION}:mesh={self.mesh}{digest}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path | None = None) -> Simulation:
        """Return the deformed interface at E [Pa], nu and V_in [mm²/s]; with several inflow rates, one for each."""
        cell = _flow_cell(self._geometry)
        young, poisson, *further = self._material_values(inputs)
        fluid = self.fluid.at(inputs)
        interfaces, sensitivities = {}, {}
        figures: dict[str, float] = {}
        for name, rate in self._rates(inputs):
            solution = cell.solve(young, poisson, rate, *further, fluid=fluid, budget=self.failure_budget)
            interfaces[name] = Interface.polyline(cell.outline.points + solution.displacement)
            figures |= {_figure(key, name): value for key, value in solution.diagnostics().items()}
            if self.sensitivities:
                sensitivities[name] = self._by_input(cell.sensitivities(solution, [q.name for q in self.fluid.inputs]))
        return Simulation(interfaces, figures, sensitivities)

    def undeformed(self) -> Interface:
        """Return the interface without flow, mm."""
        return self.outline.interface()

    def fields(self, inputs: Mapping[str, float], condition: str = "") -> FlowFields:
        """Return velocity, pressure and displacement of the solved state.

        Args:
            inputs: Inputs of the run by name.
            condition: Name of one of the inflow rates; the last one by default.
        """
        cell = _flow_cell(self._geometry)
        rates = dict(self._rates(inputs))
        rate = rates[condition or next(reversed(rates))]
        young, poisson, *further = self._material_values(inputs)
        cell.solve(young, poisson, rate, *further, fluid=self.fluid.at(inputs))
        return cell.fields()

    def on_finer_mesh(self, inputs: Mapping[str, float]) -> dict[str, Interface]:
        """Return the deformed interfaces by condition on the next finer mesh, at the same nodes, to check the accuracy.

        Raises:
            ForwardModelError: The run fails.
        """
        cell = _new_cell(self._geometry, FINER[self.mesh])
        found = {}
        young, poisson, *further = self._material_values(inputs)
        for name, rate in self._rates(inputs):
            fluid = self.fluid.at(inputs)
            solution = cell.solve(young, poisson, rate, *further, fluid=fluid, budget=self.failure_budget)
            found[name] = Interface.polyline(cell.outline.points + solution.displacement)
        return found

    @property
    def _geometry(self) -> "Biofilm":
        """The model reduced to what affects mesh and forms."""
        return dataclasses.replace(self, inflow_rates=(), sensitivities=False, failure_budget=0)

    def _rates(self, inputs: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
        """Return the conditions with their inflow rates."""
        return self.inflow_rates or (("", float(inputs[self._drive[0].name])),)

    def _material_values(self, inputs: Mapping[str, float]) -> list[list[float]]:
        """Return Young's moduli, Poisson's ratios and further parameters, each for every part."""
        return [[float(inputs[item.name + number]) for number in self._numbers] for item in self._material]

    def _by_input(self, found: list[np.ndarray]) -> dict[str, np.ndarray]:
        """Return the sensitivities of a `FlowCell` by the name of the input; without V_in if it is none."""
        names = [item.name + number for item in self._material for number in self._numbers]
        by_name = dict(zip([*names, "", *(item.name for item in self.fluid.inputs)], found, strict=True))
        by_drive = by_name.pop("")
        return by_name | {item.name: by_drive for item in self._drive}


_SMALLEST_BUDGET = 3
_FROM_FILE = {"outline": "; in a study file also file with its unit in place of points, which are in mm"}

_SMALL_STRAIN = (
    ModelInput("E", "Pa", 0.0, np.inf, low_included=False, high_included=False, meaning="Young's modulus"),
    ModelInput("nu", "1", -1.0, 0.5, low_included=False, meaning="Poisson's ratio"),
)


def _of_part(item: ModelInput, number: str) -> ModelInput:
    """Return a parameter of the law as an input of part `number`; empty if there is one part."""
    if not number:
        return item
    return dataclasses.replace(item, name=item.name + number, meaning=f"{item.meaning} of part {number}")


def _figure(key: str, condition: str) -> str:
    return f"{key}_{condition}" if condition else key


def _one_of(what: str, value: object, choices: Mapping[str, Any]) -> None:
    if value not in choices:
        raise InvalidInput(
            f"{what} of the biofilm model",
            value=value,
            expected=f"one of {', '.join(choices)}",
            remedy="Choose one of them.",
        )


def _converted(name: str, value: object, kind: Any) -> Any:
    """Return `value` as the record `kind`, made from a plain mapping or a named preset."""
    if isinstance(value, kind):
        return value
    if isinstance(value, str) and value in getattr(kind, "PRESETS", {}):
        return kind.PRESETS[value]
    known = {field.name for field in dataclasses.fields(kind)}
    if not isinstance(value, Mapping) or not set(value) <= known:
        unknown = sorted(set(value) - known) if isinstance(value, Mapping) else []
        close = get_close_matches(str(unknown[0]), known, n=1) if unknown else []
        raise InvalidInput(
            f"{name} of the biofilm model",
            value=", ".join(map(str, unknown)) or value,
            expected=f"a mapping with keys among {', '.join(sorted(known))}{_FROM_FILE.get(name, '')}",
            remedy=f"Did you mean {close[0]}?" if close else "Correct it.",
        )
    if kind is Fluid:
        return Fluid(**{key: float(v) if _is_number(v) else v for key, v in value.items()})
    if kind is Partition:
        check_partition(**value)
    lengths = {field.name for field in dataclasses.fields(kind) if field.type is float}
    for key in lengths & set(value):
        if not _is_number(value[key]):
            raise InvalidInput(
                f"{key} of the {name}",
                value=value[key],
                expected="a number in mm, without a unit",
                remedy="Correct it.",
            )
    return kind(**{key: float(v) if key in lengths else _as_tuples(v) for key, v in value.items()})


def _inflow(value: Any) -> Any:
    """Return the name of a profile, or the pairs of ``{table: …}`` as tuples."""
    if isinstance(value, Mapping) and set(value) == {"table"}:
        return as_pairs(value["table"])
    if isinstance(value, str | tuple):
        return value
    raise InvalidInput(
        "inflow of the biofilm model",
        value=value,
        expected=f"one of {', '.join([*PROFILES, PRESSURE])}, module:name, or {{table: [[y, v], …]}} with y in mm",
        remedy="Correct it.",
    )


def _as_tuples(value: Any) -> Any:
    """Return nested lists as nested tuples of numbers, which can be compared and hashed."""
    if not isinstance(value, list | tuple):
        return value
    return tuple(float(item) if _is_number(item) else _as_tuples(item) for item in value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _pairs(rates: Any) -> tuple[tuple[str, float], ...]:
    """Return a mapping name → rate as pairs."""
    if not isinstance(rates, Mapping):
        raise InvalidInput(
            "inflow_rates of the biofilm model",
            value=rates,
            expected="rates in mm^2/s by the name of the condition, e.g. {slow: 50, fast: 100}",
            remedy="Correct them.",
        )
    for name, rate in rates.items():
        _check_rate(name, rate)
    return tuple((name, float(rate)) for name, rate in rates.items())


def _check_budget(budget: object) -> None:
    if isinstance(budget, bool) or not isinstance(budget, int) or (budget != 0 and budget < _SMALLEST_BUDGET):
        raise InvalidInput(
            "failure_budget of the biofilm model",
            value=budget,
            expected=f"a whole number of Jacobians, at least {_SMALLEST_BUDGET}, or 0 for no limit",
            remedy="Correct it.",
        )


def _check_rate(name: object, rate: object, inflow: object = PARABOLA) -> None:
    if inflow == PRESSURE:
        raise InvalidInput(
            "inflow_rates of the biofilm model",
            value=f"{name}: {rate} with inflow: {PRESSURE}",
            expected="a profile of the inflow, or no inflow rates",
            remedy="Remove one of the two; p_drop is an input of the model.",
        )
    admitted = isinstance(rate, int | float) and _is_number(rate) and RATE.admits(float(rate))
    if not admitted or not is_condition(name) or not name:
        raise InvalidInput(
            f"inflow rate {name!r} of the biofilm model",
            value=rate,
            expected="the name of a condition with its rate in mm^2/s, 0 or more, e.g. slow: 50",
            remedy="Correct the inflow rate.",
        )


@lru_cache(maxsize=2)
def _flow_cell(model: Biofilm) -> FlowCell:
    return _new_cell(model, MESHES[model.mesh])


def _new_cell(model: Biofilm, size: MeshSize) -> FlowCell:
    return FlowCell(
        model.outline.interface(),
        size,
        channel=model.channel,
        partition=model.partition,
        law=law_named(model.material),
        fluid=model.fluid,
        inflow=model.inflow,
        clamped=model.clamped,
    )


@lru_cache(maxsize=16)
def _is_adapted(outline: Outline, mesh: str, channel: Channel) -> bool:
    return is_adapted(outline.interface(), MESHES[mesh], channel)
