"""Turek and Hron's benchmarks CFD1, CSM1, CSM2 and FSI1 with the system and solver of the biofilm model.

Reference: Turek and Hron, Proposal for numerical benchmarking of fluid–structure interaction between an elastic object
and laminar incompressible flow, in: Fluid–Structure Interaction, LNCSE 53 (2006), tables for the four. SI units.

Elements are smallest at the four corners where the solution is singular: the beam's root and tip.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import ngsolve as ng
import numpy as np
from netgen.geom2d import SplineGeometry
from verification.validation.fluid_forms import CubicSystem
from verification.validation.tables import Table, observed_orders, table

from strandline.models.biofilm import newton
from strandline.models.biofilm.equations.system import BoundaryNames, CoupledSystem

LENGTH, HEIGHT = 2.5, 0.41
CENTRE, RADIUS, HALF = 0.2, 0.05, 0.01
TIP = (0.6, 0.2)
BOUNDARIES = BoundaryNames(no_slip="wall|cylinder", inlet="inlet", fixed="inlet|outlet|wall|cylinder|clamped")
RIGID = BoundaryNames(no_slip="wall|cylinder", inlet="inlet", fixed="inlet|outlet|wall|cylinder|interface")
POISSON, DENSITY = 0.4, 1e3
NORM_WEIGHTS = (1.0, 1e-2, 1e3, 1e-4)
SETTINGS = newton.NewtonSettings(tolerance=1e-8, maximum_jacobians=30, smallest_damping=1e-3)


@dataclass(frozen=True)
class Size:
    """Element sizes, m: far away, at cylinder and beam, at the beam's corners."""

    far: float
    near: float
    corner: float


def mesh_turek_hron(size: Size, refinements: int, *, order: int, fluid: bool = True, solid: bool = True) -> Any:
    """Return the NGSolve mesh with all elements quartered `refinements` times; a region left out is a hole."""
    geometry = SplineGeometry()
    inside, outside = (2 if solid else 0), (1 if fluid else 0)
    lower, upper = _beam(geometry, size, inside, outside)
    angle = float(np.arcsin(HALF / RADIUS))
    if solid:
        _arc(geometry, (lower, upper), (-angle, angle), 4, rightdomain=inside, bc="clamped", maxh=size.near)
    if fluid:
        corners = [geometry.AppendPoint(*c) for c in ((0, 0), (LENGTH, 0), (LENGTH, HEIGHT), (0, HEIGHT))]
        for k, name in enumerate(("wall", "outlet", "wall", "inlet")):
            geometry.Append(["line", corners[k], corners[(k + 1) % 4]], leftdomain=1, rightdomain=0, bc=name)
        around = (angle, 2 * np.pi - angle)
        _arc(geometry, (upper, lower), around, 24, rightdomain=outside, bc="cylinder", maxh=size.near)
        geometry.SetMaterial(1, "fluid")
    if solid:
        geometry.SetMaterial(2, "solid")
    mesh = ng.Mesh(geometry.GenerateMesh(maxh=size.far, grading=0.25))
    for _ in range(refinements):
        mesh.Refine()
    mesh.Curve(order)
    return mesh


def _beam(geometry: Any, size: Size, inside: int, outside: int) -> tuple[int, int]:
    """Append the beam's free sides; return the numbers of its two points on the cylinder."""
    root = CENTRE + np.sqrt(RADIUS**2 - HALF**2)
    (x, y), sharp = TIP, {"maxh": size.corner}
    lower = geometry.AppendPoint(root, CENTRE - HALF, **sharp)
    tip_low, tip_high = (geometry.AppendPoint(x, y + s * HALF, **sharp) for s in (-1, 1))
    middle = geometry.AppendPoint(x, y)
    upper = geometry.AppendPoint(root, CENTRE + HALF, **sharp)
    ring = (lower, tip_low, middle, tip_high, upper)
    for a, b in pairwise(ring):
        geometry.Append(["line", a, b], leftdomain=inside, rightdomain=outside, bc="interface", maxh=size.near)
    return lower, upper


def _arc(geometry: Any, ends: tuple[int, int], angles: tuple[float, float], pieces: int, **options: Any) -> None:
    """Append an arc of the cylinder as rational quadratic splines; nothing is meshed on its left."""
    at = np.linspace(*angles, pieces + 1)
    far = RADIUS / np.cos(0.5 * (at[1] - at[0]))
    previous, last = ends
    for k in range(pieces):
        middle = 0.5 * (at[k] + at[k + 1])
        control = geometry.AppendPoint(CENTRE + far * np.cos(middle), CENTRE + far * np.sin(middle))
        to = CENTRE + RADIUS * np.cos(at[k + 1]), CENTRE + RADIUS * np.sin(at[k + 1])
        following = last if k == pieces - 1 else geometry.AppendPoint(*to)
        geometry.Append(["spline3", previous, control, following], leftdomain=0, **options)
        previous = following


@dataclass(frozen=True)
class Benchmark:
    """A benchmark: what was published of the displacement of the beam's tip (ux, uy), and of drag and lift of cylinder
    and beam; and its parts.

    Units are SI; without a mean inflow velocity there is no fluid, without Young's modulus the beam is rigid; gravity
    points downwards.
    """

    name: str
    reference: dict[str, Any]
    velocity: float = 0.0
    young: float = 0.0
    gravity: float = 0.0

    def system(
        self, size: Size, refinements: int, kind: type[CoupledSystem] = CoupledSystem, **options: Any
    ) -> CoupledSystem:
        """Return the coupled system on a new mesh; options are those of the system."""
        has = {"fluid": self.velocity > 0, "solid": self.young > 0}
        mesh = mesh_turek_hron(size, refinements, order=kind.ORDER, **has)
        parts = {"solids": ("solid",) if self.young else (), "body_force": (0.0, -DENSITY * self.gravity)}
        return kind(mesh, BOUNDARIES if self.young else RIGID, viscosity=1.0, density=DENSITY, **parts, **options)

    def values(self, system: CoupledSystem) -> tuple[float, ...]:
        """Return displacement of the beam's tip and force on cylinder and beam, as far as there are any."""
        moved = tuple(system.state.components[2](system.mesh(*TIP))) if self.young else ()
        return moved + force(system) if self.velocity else moved


BENCHMARKS = {
    item.name: item
    for item in (
        Benchmark("CFD1", {"drag": 14.29, "lift": 1.119}, velocity=0.2),
        Benchmark("CSM1", {"ux": -7.187e-3, "uy": -66.10e-3}, young=1.4e6, gravity=2.0),
        Benchmark("CSM2", {"ux": -0.469e-3, "uy": -16.97e-3}, young=5.6e6, gravity=2.0),
        Benchmark("FSI1", {"ux": 2.27e-5, "uy": 8.209e-4, "drag": 14.295, "lift": 0.7638}, velocity=0.2, young=1.4e6),
    )
}
COARSEST = Size(far=0.2, near=0.02, corner=0.004)
RUNS = (
    ("CFD1", 2, 3), ("CFD1", 3, 2), ("CSM1", 2, 3), ("CSM1", 3, 3),
    ("CSM2", 2, 3), ("CSM2", 3, 3), ("FSI1", 2, 3), ("FSI1", 3, 2),
)  # fmt: skip
"""Benchmark, order and number of meshes, such that the finest mesh takes less than half a minute."""


@dataclass(frozen=True)
class Outcome:
    """Computed values, by the names of the reference, and their cost."""

    values: dict[str, float]
    elements: int
    unknowns: int
    seconds: float


def solve(benchmark: Benchmark, level: int, *, order: int) -> Outcome:
    """Return the steady state of a benchmark; its seconds include mesh generation."""
    start = time.perf_counter()
    system = benchmark.system(COARSEST, level, {kind.ORDER: kind for kind in (CoupledSystem, CubicSystem)}[order])
    system.set_unknowns(_steady_state(system, benchmark))
    values = dict(zip(benchmark.reference, benchmark.values(system), strict=True))
    return Outcome(values, system.mesh.ne, len(system.free), time.perf_counter() - start)


def _steady_state(system: CoupledSystem, benchmark: Benchmark) -> np.ndarray:
    """Return the unknowns, starting from a stiffer body: a million times stiffer in a flow, otherwise 8 times."""
    if benchmark.velocity:
        set_inflow(system, benchmark.velocity)
    weights, x = norm_weights(system), np.array(system.values[system.free])
    for factor in (1e6, 1.0) if benchmark.velocity else (8.0, 4.0, 2.0, 1.0):
        if benchmark.young:
            system.set_material([factor * benchmark.young], [POISSON])
        x = newton.solve(system, x, weights=weights, settings=SETTINGS).x
    return x


def set_inflow(system: CoupledSystem, mean: float) -> None:
    """Set the parabola of the velocity at the inlet, from its mean in m/s."""
    profile = 1.5 * mean * 4 * ng.y * (HEIGHT - ng.y) / HEIGHT**2
    system.state.components[0].Set(ng.CF((profile, 0)), definedon=system.mesh.Boundaries("inlet"))


def norm_weights(system: CoupledSystem) -> np.ndarray:
    """Return the weight of each unknown in the norm of a correction."""
    weights = np.empty(len(system.free))
    for component in range(3 + len(system.solids)):
        weights[system.block(component)] = NORM_WEIGHTS[component]
    return weights


def force(system: CoupledSystem) -> tuple[float, float]:
    """Return the force on cylinder and beam: the residual tested with a field that is 1 there, a sum over vertices."""
    part = system.space.Range(0)
    residual = system.full_residual()[part.start : part.stop]
    boundary = [e for e in system.mesh.Elements(ng.BND) if e.mat in ("cylinder", "interface")]
    touched = sorted({v.nr for e in boundary for v in e.vertices})
    half = len(residual) // 2
    return -float(residual[:half][touched].sum()), -float(residual[half:][touched].sum())


def family(benchmark: Benchmark, *, order: int, levels: int) -> list[Outcome]:
    """Return the outcomes on successive meshes, each with the elements of the one before quartered."""
    return [solve(benchmark, level, order=order) for level in range(levels)]


def tables() -> list[Table]:
    """Return a table for each steady benchmark."""
    rows = {name: [] for name in BENCHMARKS}
    for name, order, levels in RUNS:
        rows[name] += _rows(BENCHMARKS[name].reference, order, family(BENCHMARKS[name], order=order, levels=levels))
    heading = (
        "quantity | published {.5g} | P {d} | elements {d} | unknowns {d} | s {.1f} | value {.6g} | error, % {.3f} "
        "| order {.1f} | own order {.1f}"
    )
    return [
        table(name, f"{name} of Turek and Hron", heading, sorted(found, key=lambda row: row[0]))
        for name, found in rows.items()
    ]


def _rows(references: Mapping[str, float], order: int, outcomes: Sequence[Outcome]) -> list[tuple]:
    """Return values, errors against the published ones, and orders of these errors and of the values' differences.

    The latter (Richardson) need three meshes but no reference.
    """
    rows = []
    for key, reference in references.items():
        values = [o.values[key] for o in outcomes]
        errors = [100 * (value / reference - 1) for value in values]
        sizes = [0.5**k for k in range(len(values))]
        own = [None, *observed_orders(sizes[1:], np.diff(values))]
        orders = zip(observed_orders(sizes, errors), own, strict=True)
        rows += [
            (key, reference, order, o.elements, o.unknowns, o.seconds, value, error, *pair)
            for o, value, error, pair in zip(outcomes, values, errors, orders, strict=True)
        ]
    return rows
