"""Meshes of Turek and Hron's channel with a cylinder and a beam behind it: both regions or just one. SI units.

Arcs are rational quadratic splines; the mesh is curved to the order of the elements. Elements are smallest at the four
corners where the solution is singular: the beam's root and tip.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import ngsolve as ng
import numpy as np
from netgen.geom2d import SplineGeometry

LENGTH, HEIGHT = 2.5, 0.41
CENTRE, RADIUS, HALF = 0.2, 0.05, 0.01
TIP = (0.6, 0.2)


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
