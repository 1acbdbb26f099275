"""What moves the fluid of a flow cell, as loads of the coupled system: inflow or pressure drop, and forces."""

from dataclasses import dataclass

import ngsolve as ng
import numpy as np

from strandline.interface import Interface
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.fluid import Fluid
from strandline.models.biofilm.inflow import DROP, PARABOLA, PRESSURE, RATE, Pairs, entering
from strandline.models.biofilm.system import CoupledSystem, FluidLoad
from strandline.models.protocol import ModelInput

__all__ = [
    "DENSITY_SCALE",
    "FORCE_SCALE",
    "STRESS_SCALE",
    "VELOCITY_SCALE",
    "VISCOSITY_SCALE",
    "Flow",
    "inlet_bottom",
    "prescribe",
]

VELOCITY_SCALE = 100.0
"""U in mm/s; with lengths in mm and ρ = 1e3 kg/m³ the stress scale ρU² is 10 Pa."""
STRESS_SCALE = 10.0
DENSITY_SCALE = 1e3
VISCOSITY_SCALE = 0.1
"""Stress scale times 1 mm over velocity scale, Pa s."""
FORCE_SCALE = 1e4
"""Stress scale over 1 mm, N/m³."""


@dataclass(frozen=True, eq=False)
class Flow:
    """The loads on the fluid.

    Args:
        channel: The channel.
        forces: Loads by the force along x and y; none without force.
        pressure: Load by the pressure at the inlet; None if the inflow is prescribed.
    """

    channel: Channel
    forces: tuple[FluidLoad, ...]
    pressure: FluidLoad | None

    @classmethod
    def of(cls, channel: Channel, inflow: str | Pairs, fluid: Fluid) -> "Flow":
        """Return the loads for an inflow and a fluid."""
        x, y = (ng.Parameter(0.0) for _ in range(2))
        hydrostatic = ng.y - channel.height
        ends = "inlet|outlet" if inflow == PRESSURE else "outlet"
        forces = (FluidLoad(x, (1.0, 0.0)), FluidLoad(y, (0.0, 1.0), hydrostatic, ends))
        drop = FluidLoad(ng.Parameter(0.0), pressure=ng.CF(1.0), boundary="inlet")
        return cls(channel, forces if fluid.is_forced else (), drop if inflow == PRESSURE else None)

    @property
    def loads(self) -> tuple[FluidLoad, ...]:
        """All of them, forces first."""
        return self.forces if self.pressure is None else (*self.forces, self.pressure)

    @property
    def drive(self) -> ModelInput:
        """The input that drives the flow."""
        return RATE if self.pressure is None else DROP

    @property
    def scale(self) -> float:
        """Scale of the inflow rate, mm²/s, or of the pressure drop, Pa."""
        return VELOCITY_SCALE if self.pressure is None else STRESS_SCALE

    def developed_drop(self, fluid: Fluid) -> float:
        """Return the scaled pressure drop of the empty channel at V_in = 100 mm²/s."""
        viscosity = next(fluid.values()) / VISCOSITY_SCALE
        return (
            (3.0 if self.channel.is_frictionless else 12.0) * viscosity * self.channel.length / self.channel.height**3
        )


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
