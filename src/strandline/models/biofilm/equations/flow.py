"""What moves the fluid of a flow cell: inflow or pressure drop, and forces; and the fluid's viscosity and density.

A profile of the inflow is a function of the height y (point,), mm, and of the heights between which the fluid enters;
it returns velocities in any unit, since they are scaled to the volume rate. A new one is a function in `PROFILES`.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float

from strandline.foundations import InvalidInput, is_finite, lookup, unfit
from strandline.interface import Interface, is_condition
from strandline.models.biofilm.equations.forms import FluidLoad
from strandline.models.biofilm.equations.system import CoupledSystem
from strandline.models.biofilm.mesh.outline import Channel, Pairs, pairs_in
from strandline.models.protocol import ModelInput

UNKNOWN = "unknown"

QUANTITIES = (
    ModelInput("viscosity", "Pa s", 0.0, np.inf, False, False, "dynamic viscosity of the fluid"),
    ModelInput("density", "kg/m^3", 0.0, np.inf, True, False, "density of the fluid"),
    ModelInput("force_x", "N/m^3", -np.inf, np.inf, False, False, "force per volume of the fluid along x"),
    ModelInput("force_y", "N/m^3", -np.inf, np.inf, False, False, "force per volume of the fluid along y"),
)
"""What describes the fluid, as inputs of the model."""
VELOCITY_SCALE = 100.0
"""U in mm/s; with lengths in mm and ρ = 1e3 kg/m³ the stress scale ρU² is 10 Pa."""
STRESS_SCALE = 10.0
DENSITY_SCALE = 1e3
VISCOSITY_SCALE = 0.1
"""Stress scale times 1 mm over velocity scale, Pa s."""
FORCE_SCALE = 1e4
"""Stress scale over 1 mm, N/m³."""
PARABOLA, PRESSURE = "parabola", "pressure"
RATE = ModelInput("V_in", "mm^2/s", 0.0, np.inf, high_included=False, meaning="inflow volume rate per depth")
DROP = ModelInput("p_drop", "Pa", 0.0, np.inf, high_included=False, meaning="pressure drop from inlet to outlet")
LOADS = {"inflow_rates": ("inflow rate", RATE, "mm^2/s", 50), "pressure_drops": ("pressure drop", DROP, "Pa", 5)}
"""Option → what it gives for each condition, the input in whose place it is, its unit as text, an example."""
SAMPLES = 1001
"""Heights at which a profile is evaluated; between them it is linear."""
PLACE = "inflow of the biofilm model"
COVERED = 1e-9
Heights = Float[np.ndarray, " point"]
Profile = Callable[[Any, float, float], Any]


@dataclass(frozen=True)
class Fluid:
    """A Newtonian fluid; water by default. A quantity that is ``unknown`` is an input of the model.

    Args:
        viscosity: Dynamic viscosity, Pa s, above 0.
        density: Density, kg/m³, at least 0; 0 is creeping flow.
        force_x: Force per volume along x, N/m³.
        force_y: Force per volume along y, N/m³. The pressure at the outlet, and at an inlet with a given pressure, is
            the hydrostatic one of this force, 0 at the top.

    Raises:
        InvalidInput: A quantity is neither a number in its range nor ``unknown``.
    """

    viscosity: float | str = 1e-3
    density: float | str = 1e3
    force_x: float | str = 0.0
    force_y: float | str = 0.0

    def __post_init__(self) -> None:
        for item in QUANTITIES:
            value = getattr(self, item.name)
            if value != UNKNOWN and not (is_finite(value) and item.admits(value)):
                expected = f"a number in {item.range_text()}, in {item.unit}, or {UNKNOWN}"
                remedy = f"Correct it. Write `{UNKNOWN}` to make it an input of the model."
                raise unfit(f"{item.name} of the fluid", value, expected, remedy)

    @property
    def inputs(self) -> tuple[ModelInput, ...]:
        return tuple(item for item in QUANTITIES if getattr(self, item.name) == UNKNOWN)

    def at(self, inputs: Mapping[str, float]) -> "Fluid":
        """Return the fluid with the values of its inputs, by name; a missing one is that of water."""
        water = {item.name: getattr(WATER, item.name) for item in self.inputs}
        return dataclasses.replace(self, **{name: float(inputs.get(name, value)) for name, value in water.items()})

    def values(self) -> Iterator[float]:
        """Yield viscosity, density and force of a fluid without unknown quantities."""
        for item in QUANTITIES:
            yield float(getattr(self, item.name))


WATER = Fluid()


def parabola(y: Heights, bottom: float, top: float) -> Heights:
    """Return the developed profile between two walls."""
    return (y - bottom) * (top - y)


def plug(y: Heights, bottom: float, top: float) -> Heights:
    """Return the same velocity everywhere."""
    return np.ones_like(y)


PROFILES: dict[str, Profile] = {PARABOLA: parabola, "plug": plug}
"""Names in study files → profiles."""


def entering(inflow: str | Pairs, bottom: float, top: float) -> tuple[Heights, Heights]:
    """Return heights, mm, and velocities of a profile, linear between them, whose volume rate is above 0."""
    y, v = _of_profile(inflow, bottom, top) if isinstance(inflow, str) else _of_table(inflow, bottom, top)
    if not np.isfinite(v).all():
        raise _refused("a velocity that is not finite", "finite velocities")
    if (v < 0).any():
        where = int(np.argmin(v))
        raise _refused(f"{v[where]:g} at y = {y[where]:g} mm", "velocities that enter the channel, 0 or above")
    if not np.trapezoid(v, y) > 0:
        raise _refused(f"no net inflow for y from {bottom:g} to {top:g} mm", "a volume rate above 0")
    return y, v


def _of_profile(name: str, bottom: float, top: float) -> tuple[Heights, Heights]:
    profile = lookup({**PROFILES, PRESSURE: None}, name, PLACE)
    y = np.linspace(bottom, top, SAMPLES)
    try:
        v = np.asarray(profile(y, bottom, top), float)
    except Exception as error:
        raise _refused(f"{name}, {type(error).__name__}: {error}", "a function of y, bottom and top, in mm") from None
    if v.shape != y.shape:
        raise _refused(f"{name}, an array of shape {v.shape}", f"one velocity for each height, shape {y.shape}")
    return y, v


def _of_table(table: Pairs, bottom: float, top: float) -> tuple[Heights, Heights]:
    y, v = np.array(as_pairs(table)).T
    if not (np.diff(y) > 0).all():
        where = int(np.argmax(np.diff(y) <= 0))
        raise _refused(f"y = {y[where + 1]:g} mm after {y[where]:g} mm", "heights that increase along the table")
    if y[0] > bottom + COVERED or y[-1] < top - COVERED:
        covering = f"one that covers the inlet, from {bottom:g} to {top:g} mm"
        raise _refused(f"a table for y from {y[0]:g} to {y[-1]:g} mm", covering)
    inside = y[(y > bottom + COVERED) & (y < top - COVERED)]
    heights = np.concatenate([[bottom], inside, [top]])
    return heights, np.interp(heights, y, v)


def as_pairs(table: Any) -> Pairs:
    """Return a table from a study file as pairs (y, v)."""
    pairs = pairs_in(table, 2)
    if pairs is None:
        raise _refused(table, "a table of at least two pairs [y, v], y in mm")
    return pairs


def as_inflow(value: Any) -> Any:
    """Return the name of a profile, or the pairs of ``{table: …}`` as tuples."""
    if isinstance(value, Mapping) and set(value) == {"table"}:
        return as_pairs(value["table"])
    if isinstance(value, str | tuple):
        return value
    names = ", ".join([*PROFILES, PRESSURE])
    raise refused("inflow", value, f"one of {names}, module:name, or {{table: [[y, v], …]}} with y in mm")


def as_loads(option: str, loads: Any) -> tuple[tuple[str, float], ...]:
    """Return a mapping name → inflow rate or pressure drop as pairs."""
    what, _, unit, example = LOADS[option]
    if not isinstance(loads, Mapping):
        shown = f"{{slow: {example}, fast: {2 * example}}}"
        raise refused(option, loads, f"{what}s in {unit} by the name of the condition, e.g. {shown}")
    return tuple((name, _load(option, name, load)) for name, load in loads.items())


as_inflow_rates, as_pressure_drops = partial(as_loads, "inflow_rates"), partial(as_loads, "pressure_drops")


def check_loads(rates: Sequence[tuple[str, float]], drops: Sequence[tuple[str, float]], inflow: object) -> None:
    """Refuse inflow rates [mm²/s] with a given pressure, pressure drops [Pa] without one, and loads below 0."""
    for option, loads, other, fits in (
        ("inflow_rates", rates, "pressure_drops", inflow != PRESSURE),
        ("pressure_drops", drops, "inflow_rates", inflow == PRESSURE),
    ):
        if loads and not fits:
            fitting = "a profile of the inflow" if other == "pressure_drops" else f"inflow: {PRESSURE}"
            remedy = f"Change `inflow`, or give `{other}` by condition."
            raise refused(option, f"inflow: {inflow}", f"{fitting}, or no {option}", remedy)
        for name, load in loads:
            _load(option, name, load)


def _load(option: str, name: object, load: object) -> float:
    """Return a load; refuse what is no number, 0 or more, with the name of a condition."""
    what, model_input, unit, example = LOADS[option]
    if is_finite(load) and model_input.admits(float(load)) and is_condition(name) and name:
        return float(load)
    expected = f"the name of a condition with its {what} in {unit}, 0 or more, e.g. slow: {example}"
    raise refused(f"{what} {name!r}", load, expected)


def refused(option: str, value: object, expected: str, remedy: str = "Correct it.") -> InvalidInput:
    """Return the error for an option that cannot be used."""
    return unfit(f"{option} of the biofilm model", value, expected, remedy)


def _refused(value: object, expected: str) -> InvalidInput:
    return refused("inflow", value, expected, "Correct the inflow.")


class Flow:
    """The loads on the fluid: by the force along x and y, if there is one, and by a given pressure at the inlet."""

    def __init__(self, channel: Channel, inflow: str | Pairs, fluid: Fluid) -> None:
        """Return the loads for an inflow and a fluid."""
        x, y = (ng.Parameter(0.0) for _ in range(2))
        hydrostatic = ng.y - channel.height
        ends = "inlet|outlet" if inflow == PRESSURE else "outlet"
        forces = (FluidLoad(x, (1.0, 0.0)), FluidLoad(y, (0.0, 1.0), hydrostatic, ends))
        drop = FluidLoad(ng.Parameter(0.0), pressure=ng.CF(1.0), boundary="inlet")
        is_forced = (fluid.force_x, fluid.force_y) != (0.0, 0.0)
        self.channel, self.forces = channel, forces if is_forced else ()
        self.pressure = drop if inflow == PRESSURE else None

    @property
    def loads(self) -> tuple[FluidLoad, ...]:
        """All of them, forces first."""
        return self.forces if self.pressure is None else (*self.forces, self.pressure)

    @property
    def drive(self) -> ModelInput:
        return RATE if self.pressure is None else DROP

    @property
    def scale(self) -> float:
        """Scale of the inflow rate, mm²/s, or of the pressure drop, Pa."""
        return VELOCITY_SCALE if self.pressure is None else STRESS_SCALE

    def developed_drop(self, fluid: Fluid) -> float:
        """Return the scaled pressure drop of the empty channel at V_in = 100 mm²/s."""
        viscosity = next(fluid.values()) / VISCOSITY_SCALE
        factor = 3.0 if self.channel.is_frictionless else 12.0
        return factor * viscosity * self.channel.length / self.channel.height**3


def inlet_bottom(outline: Interface, channel: Channel) -> float:
    """Return the height at which the inlet begins, mm: 0 if the outline ends on the floor there."""
    return float(outline.points[0 if channel.inlet == "left" else -1][1])


def prescribe(system: CoupledSystem, inflow: str | Pairs, channel: Channel, *, bottom: float) -> None:
    """Write a profile with the scaled volume rate 1 over the free height of the inlet into the velocity."""
    sign = 1.0 if channel.inlet == "left" else -1.0
    inlet, velocity = system.mesh.Boundaries("inlet"), system.state.components[0]
    if inflow == PARABOLA:
        free = channel.height - bottom
        s = (ng.y - bottom) / free
        profile = sign * 3 * s * (1 - 0.5 * s) / free if channel.is_frictionless else sign * 6 * s * (1 - s) / free
        velocity.Set(ng.CF((profile, 0)), definedon=inlet)
        return
    y, v = entering(inflow, bottom, channel.height)
    linear = ng.BSpline(2, [y[0], *y.tolist(), y[-1]], (sign * v / np.trapezoid(v, y)).tolist())
    velocity.Set(ng.CF((linear(ng.y), 0)), definedon=inlet)
    rate = sign * ng.Integrate(velocity[0], system.mesh, definedon=inlet)
    system.values[:] /= rate
