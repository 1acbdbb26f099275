"""Turek–Hron FSI1 with the same system and solver as the biofilm model, against the published reference.

Reference: Turek and Hron, Proposal for numerical benchmarking of fluid–structure interaction between an elastic object
and laminar incompressible flow, in: Fluid–Structure Interaction, LNCSE 53 (2006), table for FSI1. SI units.

Run it with:  python -m validation.turek_hron
"""

from dataclasses import dataclass
from typing import Any

import ngsolve as ng
import numpy as np
from netgen.geom2d import SplineGeometry

from strandline.models.biofilm import newton
from strandline.models.biofilm.system import BoundaryNames, CoupledSystem

REFERENCE = {"ux": 2.27e-5, "uy": 8.209e-4, "drag": 14.295, "lift": 0.7638}
BOUNDARIES = BoundaryNames(no_slip="wall|cylinder", inlet="inlet", fixed="inlet|outlet|wall|cylinder|clamped")
LENGTH, HEIGHT, MEAN_VELOCITY = 2.5, 0.41, 0.2
YOUNG, POISSON = 1.4e6, 0.4


@dataclass(frozen=True)
class Outcome:
    """Displacement of the beam's tip (m), forces on cylinder and beam (N/m), and the size of the problem."""

    ux: float
    uy: float
    drag: float
    lift: float
    elements: int
    unknowns: int


def mesh_benchmark(far: float, near: float, *, order: int = 2) -> Any:
    """Return the channel with cylinder and beam; element sizes `far` and, at cylinder and beam, `near` (m)."""
    geometry = SplineGeometry()
    add = geometry.AppendPoint
    corners = [add(*c) for c in ((0, 0), (LENGTH, 0), (LENGTH, HEIGHT), (0, HEIGHT))]
    for k, name in enumerate(("wall", "outlet", "wall", "inlet")):
        geometry.Append(["line", corners[k], corners[(k + 1) % 4]], leftdomain=1, rightdomain=0, bc=name)
    root = 0.2 + np.sqrt(0.05**2 - 0.01**2)
    lower, upper = add(root, 0.19), add(root, 0.21)
    tip_low, tip_mid, tip_high = add(0.6, 0.19), add(0.6, 0.2), add(0.6, 0.21)
    for a, b in ((lower, tip_low), (tip_low, tip_mid), (tip_mid, tip_high), (tip_high, upper)):
        geometry.Append(["line", a, b], leftdomain=2, rightdomain=1, bc="interface", maxh=near)
    angle = np.arcsin(0.2)
    _arc(geometry, lower, upper, -angle, angle, 4, left=0, right=2, name="clamped", near=near)
    _arc(geometry, upper, lower, angle, 2 * np.pi - angle, 24, left=0, right=1, name="cylinder", near=near)
    geometry.SetMaterial(1, "fluid")
    geometry.SetMaterial(2, "solid")
    mesh = ng.Mesh(geometry.GenerateMesh(maxh=far, grading=0.2))
    mesh.Curve(order)
    return mesh


def fsi1(far: float, near: float, *, order: int = 2) -> Outcome:
    """Return the steady state of FSI1 on a mesh of the given element sizes."""
    mesh = mesh_benchmark(far, near, order=order)
    system = CoupledSystem(mesh, BOUNDARIES, viscosity=1.0, density=1e3, order=order)
    profile = 1.5 * MEAN_VELOCITY * 4 * ng.y * (HEIGHT - ng.y) / HEIGHT**2
    system.state.components[0].Set(ng.CF((profile, 0)), definedon=mesh.Boundaries("inlet"))
    weights = np.empty(len(system.free))
    for component, weight in enumerate((1.0, 1e-2, 1e3, 1e-4)):
        weights[system.block(component)] = weight

    def norm(c: Any) -> float:
        return float(np.linalg.norm(weights * c) / np.sqrt(len(c)))

    settings = newton.NewtonSettings(tolerance=1e-10, maximum_jacobians=30)
    x = np.array(system.values[system.free])
    for young in (1e6 * YOUNG, YOUNG):
        system.young.Set(young)
        system.poisson.Set(POISSON)
        x = newton.solve(system, x, norm=norm, settings=settings).x
    system.set_unknowns(x)
    ux, uy = system.state.components[2](mesh(0.6, 0.2))
    drag, lift = _force(system)
    return Outcome(ux, uy, drag, lift, mesh.ne, len(system.free))


def _force(system: CoupledSystem) -> tuple[float, float]:
    """Force on cylinder and beam: the residual tested with a field that is 1 there, i.e. the sum over vertices."""
    part = system.space.Range(0)
    residual = system.full_residual()[part.start : part.stop]
    boundary = [e for e in system.mesh.Elements(ng.BND) if e.mat in ("cylinder", "interface")]
    touched = sorted({v.nr for e in boundary for v in e.vertices})
    half = len(residual) // 2
    return -float(residual[:half][touched].sum()), -float(residual[half:][touched].sum())


def _arc(
    geometry: Any,
    start: int,
    end: int,
    first: float,
    last: float,
    pieces: int,
    *,
    left: int,
    right: int,
    name: str,
    near: float,
) -> None:
    """Append a circular arc about (0.2, 0.2) of radius 0.05 as rational quadratic splines."""
    angles = np.linspace(first, last, pieces + 1)
    half = 0.5 * (last - first) / pieces
    previous = start
    for k in range(pieces):
        middle = 0.5 * (angles[k] + angles[k + 1])
        r = 0.05 / np.cos(half)
        control = geometry.AppendPoint(0.2 + r * np.cos(middle), 0.2 + r * np.sin(middle))
        to = 0.2 + 0.05 * np.cos(angles[k + 1]), 0.2 + 0.05 * np.sin(angles[k + 1])
        following = end if k == pieces - 1 else geometry.AppendPoint(*to)
        segment = ["spline3", previous, control, following]
        geometry.Append(segment, leftdomain=left, rightdomain=right, bc=name, maxh=near)
        previous = following


def main() -> None:
    """Print a table over a family of meshes."""
    print(f"{'elements':>9} {'unknowns':>9}" + "".join(f"{key:>13}" for key in REFERENCE))
    for far, near in ((0.1, 0.02), (0.06, 0.01), (0.04, 0.006)):
        result = fsi1(far, near)
        row = "".join(f"{getattr(result, key):13.5g}" for key in REFERENCE)
        errors = "".join(f"{getattr(result, key) / value - 1:13.2%}" for key, value in REFERENCE.items())
        print(f"{result.elements:9d} {result.unknowns:9d}{row}\n{'':19}{errors}")
    print(f"{'reference':>19}" + "".join(f"{value:13.5g}" for value in REFERENCE.values()))


if __name__ == "__main__":
    main()
