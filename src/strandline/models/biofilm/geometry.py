"""The mesh of a flow cell: a channel with a solid on its floor; the interface polygon consists of mesh edges."""

from typing import Any

from netgen.geom2d import SplineGeometry
from netgen.meshing import MeshingParameters
from ngsolve import Mesh

from strandline.interface import Interface
from strandline.models.biofilm.channel import ON_WALL, Channel
from strandline.models.biofilm.sizes import MESHES, MeshSize, gap_sizes, segment_sizes
from strandline.models.biofilm.subdivision import Edge, Partition, Point, Subdivision

__all__ = ["MESHES", "MeshSize", "mesh_flow_cell", "subdivide"]

FLUID = "fluid"


def subdivide(interface: Interface, channel: Channel, partition: Partition) -> tuple[Subdivision, list[str]]:
    """Return fluid and solid as polygons, and the names of the solid's parts: ``solid``, or ``solid1``, ``solid2`` etc.

    The first vertices are those of `interface`, in its order.
    """
    outline: list[Point] = [(float(x), float(y)) for x, y in interface.points]
    outline[0], outline[-1] = _on_wall(outline[0], 0.0), _on_wall(outline[-1], channel.length)
    corners = [(0.0, 0.0), (channel.length, 0.0), (channel.length, channel.height), (0.0, channel.height)]
    count = len(outline)
    origin, right, top_right, top_left = range(count, count + 4)
    along = list(range(count))
    # A lower corner belongs to the solid if the outline ends on the channel's end, above it; else to the fluid.
    of_solid = [corner for corner, end in ((origin, outline[0]), (right, outline[-1])) if end[1] > 0]
    before, after = ([c] if c not in of_solid else [] for c in (origin, right))
    fluid, solid = [*before, *along, *after, top_right, top_left], [*of_solid, *reversed(along)]
    figure = Subdivision([*outline, *corners], {FLUID: fluid, "solid": solid})
    parts = ["solid"]
    for line in partition.lines:
        parts = figure.cut(parts, line)
    return figure, figure.rename(parts, partition.markers, "solid") if partition.lines else parts


def _on_wall(end: Point, wall: float) -> Point:
    """Return an end of the outline, moved exactly onto the floor or the channel's end if it is within 1e-9 of it."""
    x, y = end
    return (x, 0.0) if abs(y) < ON_WALL else (wall, y)


def mesh_flow_cell(
    interface: Interface,
    size: MeshSize,
    channel: Channel = Channel(),
    partition: Partition = Partition(),
) -> Any:
    """Return the NGSolve mesh of a channel with a solid below `interface`.

    Regions: ``fluid`` and the parts of the solid; boundaries: ``inlet``, ``outlet``, ``top``, ``floor``, ``base``,
    ``side`` (a layer's ends), ``interface``, ``inner`` (between parts). Deterministic: the same arguments give the same
    mesh, bit for bit.
    """
    figure, parts = subdivide(interface, channel, partition)
    number = {FLUID: 1} | {name: k for k, name in enumerate(parts, 2)}
    geometry = SplineGeometry()
    along = segment_sizes(interface, size)
    ids = [geometry.AppendPoint(x, y) for x, y in figure.vertices]
    for edge in sorted(figure.edges(), key=lambda e: _place(e, figure, channel)):
        name = _name(edge, figure, channel)
        geometry.Append(
            ["line", ids[edge.start], ids[edge.end]],
            leftdomain=number[edge.left],
            rightdomain=number[edge.right] if edge.right else 0,
            bc=name,
            maxh=along[min(edge.start, edge.end)] if name == "interface" else _size(name, size),
        )
    for name, k in number.items():
        geometry.SetMaterial(k, name)
    parameters = MeshingParameters(maxh=size.far, grading=size.grading)
    for x, y, largest in gap_sizes(interface, size, channel).tolist():
        parameters.RestrictH(x=x, y=y, z=0.0, h=largest)
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


def _name(edge: Edge, figure: Subdivision, channel: Channel) -> str:
    if edge.right is not None:
        return "interface" if FLUID in (edge.left, edge.right) else "inner"
    (x0, y0), (x1, y1) = figure.vertices[edge.start], figure.vertices[edge.end]
    if y0 == y1 == 0:
        return "floor" if edge.left == FLUID else "base"
    if y0 == y1 == channel.height:
        return "top"
    if edge.left != FLUID:
        return "side"
    at_left = x0 == x1 == 0
    return "inlet" if at_left == (channel.inlet == "left") else "outlet"


def _size(name: str, size: MeshSize) -> float:
    """Return the largest element edge off the interface."""
    return 2 * size.interface if name in ("base", "inner") else size.far
