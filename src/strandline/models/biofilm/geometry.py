"""The mesh of a flow cell: a channel with a solid on its floor; the interface polygon consists of mesh edges."""

from typing import Any

from netgen.geom2d import SplineGeometry
from netgen.meshing import MeshingParameters
from ngsolve import Mesh

from strandline.interface import Interface
from strandline.models.biofilm.channel import ON_WALL, Channel
from strandline.models.biofilm.outline import bodies
from strandline.models.biofilm.sizes import MESHES, MeshSize, gap_sizes, segment_sizes
from strandline.models.biofilm.subdivision import Edge, Partition, Point, Subdivision

__all__ = ["MESHES", "MeshSize", "mesh_flow_cell", "subdivide"]

FLUID = "fluid"

Stretches = tuple[tuple[float, float], ...]
"""Stretches (from, to) of the floor, mm."""


def subdivide(
    interface: Interface, channel: Channel, partition: Partition, clamped: Stretches = ()
) -> tuple[Subdivision, list[str]]:
    """Return fluid and solid as polygons, and the names of the solid's parts: ``solid``, or ``solid1``, ``solid2`` etc.

    The first vertices are those of `interface`, in its order. Several bodies without a partition are one part; their
    polygons are called ``solid``, ``solid@2`` etc. The ends of the `clamped` stretches of the floor are vertices.
    """
    outline: list[Point] = [(float(x), 0.0 if abs(y) < ON_WALL else float(y)) for x, y in interface.points]
    outline[0], outline[-1] = _on_wall(outline[0], 0.0), _on_wall(outline[-1], channel.length)
    corners = [(0.0, 0.0), (channel.length, 0.0), (channel.length, channel.height), (0.0, channel.height)]
    count = len(outline)
    origin, right, top_right, top_left = range(count, count + 4)
    along = list(range(count))
    # A lower corner belongs to the solid if the outline ends on the channel's end, above it; else to the fluid.
    of_solid = [corner for corner, end in ((origin, outline[0]), (right, outline[-1])) if end[1] > 0]
    before, after = ([c] if c not in of_solid else [] for c in (origin, right))
    fluid = [*before, *along, *after, top_right, top_left]
    solids = [list(reversed(along[body])) for body in bodies(interface.points)]
    solids[0] = [*(c for c in of_solid if c == origin), *solids[0]]
    solids[-1] = (
        [*(c for c in of_solid if c == right), *solids[-1]] if len(solids) > 1 else [*of_solid, *reversed(along)]
    )
    names = ["solid", *(f"solid@{k}" for k in range(2, len(solids) + 1))]
    figure = Subdivision([*outline, *corners], {FLUID: fluid} | dict(zip(names, solids, strict=True)))
    parts = names
    for line in partition.lines:
        parts = figure.cut(parts, line)
    for x in sorted({x for stretch in clamped for x in stretch}):
        figure.split_floor(x)
    divided = partition.lines or (len(names) > 1 and partition.markers)
    return figure, figure.rename(parts, partition.markers, "solid") if divided else names[:1]


def _on_wall(end: Point, wall: float) -> Point:
    """Return an end of the outline, moved exactly onto the floor or the channel's end if it is within 1e-9 of it."""
    x, y = end
    return (x, 0.0) if abs(y) < ON_WALL else (wall, y)


def mesh_flow_cell(
    interface: Interface,
    size: MeshSize,
    channel: Channel = Channel(),
    partition: Partition = Partition(),
    clamped: Stretches = (),
) -> Any:
    """Return the NGSolve mesh of a channel with a solid below `interface`.

    Regions: ``fluid`` and the parts of the solid; boundaries: ``inlet``, ``outlet``, ``top``, ``floor``, ``base``,
    ``loose`` (the base beside the clamped stretches, if there are any), ``side`` (a layer's ends), ``interface``,
    ``inner`` (between parts). Deterministic: the same arguments give the same mesh, bit for bit.
    """
    figure, _ = subdivide(interface, channel, partition, clamped)
    number = {name: k for k, name in enumerate((FLUID, *(name for name in figure.rings if name != FLUID)), 1)}
    geometry = SplineGeometry()
    along = segment_sizes(interface, size)
    ids = [geometry.AppendPoint(x, y) for x, y in figure.vertices]
    for edge in sorted(figure.edges(), key=lambda e: _place(e, figure, channel)):
        name = _name(edge, figure, channel, clamped)
        geometry.Append(
            ["line", ids[edge.start], ids[edge.end]],
            leftdomain=number[edge.left],
            rightdomain=number[edge.right] if edge.right else 0,
            bc=name,
            maxh=along[min(edge.start, edge.end)] if name == "interface" else _size(name, size),
        )
    for name, k in number.items():
        geometry.SetMaterial(k, name.partition("@")[0])
    parameters = MeshingParameters(maxh=size.far, grading=size.grading)
    for x, y, largest in gap_sizes(interface, size, channel).tolist():
        parameters.RestrictH(x=x, y=y, z=0.0, h=largest)
    for x in (x for stretch in clamped for x in stretch):
        parameters.RestrictH(x=x, y=0.0, z=0.0, h=size.foot)
    return Mesh(geometry.GenerateMesh(parameters))


def _place(edge: Edge, figure: Subdivision, channel: Channel) -> tuple[int, float]:
    """Order: the outer boundary counter-clockwise from the origin, the interface along itself, then inner edges."""
    if edge.right is None:
        (x0, y0), (x1, y1) = figure.vertices[edge.start], figure.vertices[edge.end]
        x, y, length, height = 0.5 * (x0 + x1), 0.5 * (y0 + y1), channel.length, channel.height
        if y == 0:
            return 0, x
        if x == length:
            return 0, length + y
        return (0, 2 * length + height - x) if y == height else (0, 2 * (length + height) - y)
    return (1, 0.5 * (edge.start + edge.end)) if FLUID in (edge.left, edge.right) else (2, 0.0)


def _name(edge: Edge, figure: Subdivision, channel: Channel, clamped: Stretches) -> str:
    if edge.right is not None:
        return "interface" if FLUID in (edge.left, edge.right) else "inner"
    (x0, y0), (x1, y1) = figure.vertices[edge.start], figure.vertices[edge.end]
    if y0 == y1 == 0:
        held = not clamped or any(a < 0.5 * (x0 + x1) < b for a, b in clamped)
        return "floor" if edge.left == FLUID else ("base" if held else "loose")
    if y0 == y1 == channel.height:
        return "top"
    if edge.left != FLUID:
        return "side"
    at_left = x0 == x1 == 0
    return "inlet" if at_left == (channel.inlet == "left") else "outlet"


def _size(name: str, size: MeshSize) -> float:
    """Return the largest element edge off the interface."""
    return 2 * size.interface if name in ("base", "loose", "inner") else size.far
