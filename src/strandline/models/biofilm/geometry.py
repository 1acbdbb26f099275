"""The flow cell: a channel with a biofilm on its floor, meshed so that the interface polygon consists of mesh edges."""

from dataclasses import dataclass
from typing import Any

from netgen.geom2d import SplineGeometry
from ngsolve import Mesh

from strandline.interface import Interface

__all__ = ["MESHES", "MeshSize", "mesh_flow_cell"]

FLUID, SOLID = 1, 2


@dataclass(frozen=True)
class MeshSize:
    """Largest element sizes, mm: away from the interface, along it, at its two feet; `grading` as Netgen has it."""

    far: float
    interface: float
    foot: float
    grading: float


MESHES = {
    "coarse": MeshSize(far=0.25, interface=0.045, foot=0.0225, grading=0.5),
    "default": MeshSize(far=0.1, interface=0.0225, foot=0.01, grading=0.3),
    "fine": MeshSize(far=0.05, interface=0.0112, foot=0.005, grading=0.25),
}
"""Element sizes by the name used in study files."""


def mesh_flow_cell(interface: Interface, size: MeshSize, *, length: float = 2.0, height: float = 1.0) -> Any:
    """Return the NGSolve mesh of a channel [0, length] × [0, height] mm with the biofilm below `interface`.

    Regions: ``fluid``, ``solid``; boundaries: ``inlet``, ``outlet``, ``top``, ``floor``, ``base``, ``interface``.
    Deterministic: the same arguments give the same mesh to the bit.
    """
    geometry = SplineGeometry()
    add = geometry.AppendPoint
    nodes = [add(float(x), float(y)) for x, y in interface.points]
    first, last = nodes[0], nodes[-1]
    origin, right = add(0.0, 0.0), add(length, 0.0)
    top_right, top_left = add(length, height), add(0.0, height)

    def line(start: int, end: int, left: int, right: int, name: str, maxh: float) -> None:
        geometry.Append(["line", start, end], leftdomain=left, rightdomain=right, bc=name, maxh=maxh)

    line(origin, first, FLUID, 0, "floor", size.far)
    line(first, last, SOLID, 0, "base", size.interface * 2)
    line(last, right, FLUID, 0, "floor", size.far)
    line(right, top_right, FLUID, 0, "outlet", size.far)
    line(top_right, top_left, FLUID, 0, "top", size.far)
    line(top_left, origin, FLUID, 0, "inlet", size.far)
    segments = len(nodes) - 1
    for k in range(segments):
        maxh = size.foot if k in (0, segments - 1) else size.interface
        line(nodes[k], nodes[k + 1], FLUID, SOLID, "interface", maxh)
    geometry.SetMaterial(FLUID, "fluid")
    geometry.SetMaterial(SOLID, "solid")
    return Mesh(geometry.GenerateMesh(maxh=size.far, grading=size.grading))
