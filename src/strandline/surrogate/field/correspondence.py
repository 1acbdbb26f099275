"""Interfaces as fields over common points: node by node if the nodes correspond, else by a common parametrisation.

Polylines are compared at equal shares of their arclength, triangulated surfaces at the projected nodes of one of them.
Equal numbers of nodes do not yet mean that the nodes correspond: a tracer may begin each outline elsewhere. Where the
inputs of the runs are given, nodes are paired by number only if this makes the field as smooth in the inputs as
another pairing does.

Tracers and contour finders begin a closed outline anywhere, in either direction. All outlines are turned to the same
side and shifted along themselves until they lie closest to their common mean: by whole nodes, or by any share of their
length. The best shift is the largest cross-correlation with the mean, found by FFT.

Interfaces that differ in kind from most others cannot form one field with them, and are found here too.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from strandline.discrepancy import node_weights, squared_distances
from strandline.foundations import NoCommonPoints
from strandline.interface import Interface
from strandline.surrogate.field.projection import Reference, common_reference

SWEEPS = 10  # most sweeps over the outlines until their mean stays; two or three suffice if it is well defined
TRIALS = 8  # trial shifts for each point of the mean; a parabola through the best three finds the shift between them

Ring = Float[np.ndarray, "point 2"]
Inputs = Float[np.ndarray, "run dim"]
Fields = Float[np.ndarray, "run value"]
FEWEST_POINTS = 33  # smallest number of points of an interface taken at equal shares of its arclength
FINER = 6
"""Points of a closed outline for each of its nodes. Chords cut corners off: with 60 nodes and errors of 1 % of
the radius, 3 points move the posterior by .1 standard deviations, 6 by .04."""
ROUGHER = 2.0  # nodes are paired otherwise if this reduces the error at left-out runs by more than this factor …
SPACINGS = 0.1  # … and if this error is larger than this share of the distance between nodes
RIDGE = 1e-6  # variance of the noise of the process that predicts left-out runs, in variances of the field


def turned_nodes(interface: Interface, mean: Interface) -> Int[np.ndarray, " point"]:
    """Return the numbers of a closed polyline's nodes in the order that lies closest to the nodes of `mean`."""
    order = interface.cells[:, 0]
    if interface.runs_against(mean):
        order = order[::-1]
    return np.roll(order, -int(np.argmax(_correlation(interface.points[order], mean.points))))


def resampled_like(interface: Interface, mean: Interface) -> Interface:
    """Return a closed polyline through as many of its points as `mean` has, equally spaced and closest to them."""
    turned = interface.reversed() if interface.runs_against(mean) else interface
    number = len(mean.points)
    return turned.resampled(number, start=_share(turned.resampled(number).points, mean.points))


def _mean(interfaces: Sequence[Interface], brought: Callable[[Interface, Interface], Ring]) -> Interface:
    """Return the mean of closed polylines brought to it, beginning with the first one."""
    mean = Interface.polyline(interfaces[0].points[interfaces[0].cells[:, 0]], closed=True)
    for _ in range(SWEEPS):
        points = np.mean([brought(one, mean) for one in interfaces], axis=0)
        still = np.allclose(points, mean.points, rtol=0, atol=1e-9 * np.ptp(points))
        mean = Interface.polyline(points, closed=True)
        if still:
            break
    return mean


def _correlation(points: Ring, mean: Ring, finer: int = 1) -> Float[np.ndarray, " shift"]:
    """Return the sum of products of `points`, shifted by 0, 1/finer, … places, with `mean`; both about their centres.
    Shifts between the nodes are those of the trigonometric polynomials through them.
    """
    number = len(mean)
    one, two = (np.fft.rfft(ring - ring.mean(axis=0), axis=0) for ring in (points, mean))
    return np.asarray(np.fft.irfft((one * two.conj()).sum(axis=1), n=finer * number))


def _share(points: Ring, mean: Ring) -> float:
    """Return the share of the length after which equally spaced points begin closest to where `mean` begins."""
    found = _correlation(points, mean, TRIALS)
    best = int(np.argmax(found))
    before, at, after = found[best - 1], found[best], found[(best + 1) % len(found)]
    bend = before - 2 * at + after
    return float((best + (0.5 * (before - after) / bend if bend < 0 else 0.0)) / len(found) % 1.0)


@dataclass(frozen=True, eq=False)
class PointLayout:
    """The meaning of the points of one condition's interface in all runs; `template` is an interface that has these
    points.

    They are the nodes if these correspond; the nodes of a closed polyline from another first one, perhaps in the other
    direction; points at equal shares of the arclength of a polyline; or the template's nodes projected onto a surface,
    by `reference`.
    """

    template: Interface
    way: Literal["nodes", "shifted nodes", "arclength", "projection"]
    reference: Reference | None = None

    @property
    def by_nodes(self) -> bool:
        """Whether the points are nodes of each run, so that derivatives at the nodes can be used."""
        return self.way in ("nodes", "shifted nodes")

    def order(self, interface: Interface) -> Int[np.ndarray, " point"]:
        """Return the numbers of the nodes that are the points, if these are nodes."""
        if self.way == "shifted nodes":
            return turned_nodes(interface, self.template)
        return np.arange(len(interface.points))

    @property
    def weights(self) -> Float[np.ndarray, " point"]:
        """Share of the interface's length (area) that each point stands for; they sum to 1."""
        size = node_weights(self.template)
        return np.asarray(size / size.sum())

    def with_points(self, points: Float[np.ndarray, "point xyz"]) -> Interface:
        return Interface(points, self.template.cells)


def common_layout(interfaces: Sequence[Interface], x: Inputs | None = None) -> PointLayout:
    """Return the layout that all of these interfaces can be brought to.

    `x` are the inputs of the runs in [0, 1], to see whether equal numbers of nodes correspond; None: they do.

    Raises:
        NoCommonPoints: they have no common parametrisation: polylines and surfaces, or open and closed ones,
            together; surfaces that are too different to be projected onto each other.
    """
    first = interfaces[0]
    if not all(one.points.shape == first.points.shape and np.array_equal(one.cells, first.cells) for one in interfaces):
        return _of_any_nodes(interfaces)
    nodes = PointLayout(first, "nodes")
    return nodes if x is None else _smoothest(nodes, interfaces, x)


def _of_any_nodes(interfaces: Sequence[Interface]) -> PointLayout:
    """Return the layout of interfaces whose nodes do not correspond."""
    first = interfaces[0]
    if len({one.dim for one in interfaces}) > 1:
        raise _different("polylines in some runs, surfaces in others")
    if first.dim == 3:
        reference = common_reference(interfaces)
        if isinstance(reference, str):
            raise _different(reference)
        return PointLayout(reference.surface, "projection", reference)
    if len({one.closed for one in interfaces}) > 1:
        raise _different("open polylines in some runs, closed ones in others")
    number = max(FEWEST_POINTS, max(len(one.points) for one in interfaces))
    if first.closed:
        finer = [one.resampled(FINER * number) for one in interfaces]
        return PointLayout(_mean(finer, lambda one, mean: resampled_like(one, mean).points), "arclength")
    return PointLayout(first.resampled(number), "arclength")


def _smoothest(nodes: PointLayout, interfaces: Sequence[Interface], x: Inputs) -> PointLayout:
    """Return `nodes`, or a layout in which the points of the runs are a smoother function of the inputs."""
    errors = _left_out(nodes, interfaces, x)
    if nodes.template.dim == 2 and nodes.template.closed:
        mean = _mean(interfaces, lambda one, mean: one.points[turned_nodes(one, mean)])
        shifted = PointLayout(mean, "shifted nodes")
        orders = np.array([shifted.order(one) for one in interfaces])
        rows, counts = np.unique(orders, axis=0, return_counts=True)
        moved = (orders != rows[np.argmax(counts)]).any(axis=1)
        turned = _left_out(shifted, interfaces, x)
        if moved.any() and ROUGHER * _rms(turned[moved]) < _rms(errors[moved]):
            nodes, errors = shifted, turned
    spacing = float(np.sqrt(nodes.template.sizes.mean())) if nodes.template.dim == 3 else nodes.template.lengths.mean()
    if _rms(errors) <= SPACINGS * spacing:
        return nodes
    try:
        other = _of_any_nodes(interfaces)
        found = _left_out(other, interfaces, x)
    except NoCommonPoints:
        return nodes
    return other if ROUGHER * _rms(found) < _rms(errors) else nodes


def _left_out(layout: PointLayout, interfaces: Sequence[Interface], x: Inputs) -> Float[np.ndarray, " run"]:
    """Return the error of each run's points predicted from the other runs, root mean square along the interface, mm. A
    Gaussian process with squared-exponential kernel as long as the box predicts them.
    """
    fields = np.array([registered(one, layout)[0].ravel() for one in interfaces])
    squares = np.sum((x[:, None] - x) ** 2, axis=2)
    errors = kriged(np.exp(-0.5 * squares) + RIDGE * np.eye(len(x)), fields - fields.mean(axis=0))[2]
    weights = np.repeat(layout.weights, layout.template.dim)
    return np.asarray(np.sqrt(np.sum(errors**2 * weights, axis=1)))


def kriged(
    covariance: Float[np.ndarray, "run run"], values: Fields
) -> tuple[Float[np.ndarray, " value"], Fields, Fields]:
    """Return the constant, the factors of the covariance, and the errors of left-out runs (universal kriging).

    The errors follow from the precision matrix: Rasmussen and Williams (2006), Section 5.4.2.
    """
    inverse = np.linalg.inv(covariance)
    ones = inverse.sum(axis=1)
    constant = ones @ values / ones.sum()
    precision = inverse - np.outer(ones, ones) / ones.sum()
    return constant, inverse @ (values - constant), (precision @ values) / np.diagonal(precision)[:, None]


def _rms(values: Float[np.ndarray, " some"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def registered(interface: Interface, layout: PointLayout) -> tuple[Float[np.ndarray, "point xyz"], float]:
    """Return the points of `interface` in the layout, and the root mean square error that this causes, mm.

    The error is the distance of the interface's own nodes from the polyline or the triangles through the points.

    Raises:
        NoCommonPoints: it does not fit the layout.
    """
    if layout.reference is not None:
        if interface.dim != 3:
            raise _different("a polyline where the others are surfaces")
        found = layout.reference.on(interface)
        if isinstance(found, str):
            raise _different(found)
        return found.points, found.error
    if layout.by_nodes:
        if interface.points.shape != layout.template.points.shape:
            raise _different("a different number of points than the other runs")
        return interface.points[layout.order(interface)], 0.0
    if interface.dim != 2 or interface.closed != layout.template.closed:
        raise _different("a polyline that is open or closed where the others are not")
    if interface.closed:
        taken = resampled_like(interface, layout.template)
    else:
        turned = interface.reversed() if interface.runs_against(layout.template) else interface
        taken = turned.resampled(len(layout.template.points))
    return taken.points, float(np.sqrt(np.mean(squared_distances(interface.points, taken))))


def fields_of(runs: Sequence[Mapping[str, Interface]], layouts: Mapping[str, PointLayout]) -> tuple[Fields, float]:
    """Return the coordinates of the points of all conditions, one row per run, and the worst registration error, mm."""
    found = [[registered(run[name], layout) for name, layout in layouts.items()] for run in runs]
    fields = np.array([np.concatenate([points.ravel() for points, _ in row]) for row in found])
    return fields, max([0.0, *(error for row in found for _, error in row)])


def by_condition(
    fields: Float[np.ndarray, "*some value"], layouts: Mapping[str, PointLayout]
) -> dict[str, Float[np.ndarray, "*some _ xyz"]]:
    """Return the points of each condition from rows of `fields_of`."""
    templates = [layout.template.points for layout in layouts.values()]
    parts = np.split(fields, np.cumsum([one.size for one in templates])[:-1], axis=-1)
    shaped = [part.reshape(*part.shape[:-1], *one.shape) for part, one in zip(parts, templates, strict=True)]
    return dict(zip(layouts, shaped, strict=True))


def _different(found: str) -> NoCommonPoints:
    what = "interfaces of the runs for a surrogate of the field"
    remedy = "Use the surrogate of the log-likelihood: surrogate: {log_likelihood: {}}."
    return NoCommonPoints(what, value=found, expected="interfaces with a common parametrisation", remedy=remedy)


CANDIDATES = 3  # number of surfaces tried as the reference of the projections
SHARES = 33
NEARER = 0.1
"""An open polyline counts as flipped if reversing it reduces the sum of squared distances to less than this share."""

COMMON = 0.25
"""Share of the runs that must have the most points for this to be the number of a whole run; where the mesh follows the
length of the interface, each number is rarer."""
SHORTER = 0.9  # share of a whole run's points, and of its length, below which a run counts as cut off
SPACING = 1.5  # ratio of spacings up to which a short run has the mesh of a whole one
HELD = 3  # equal last values that are no chance after a step of usual size


def flipped(interface: Interface, other: Interface) -> bool:
    """Return whether an interface is clearly `other`, or one close to it, in the opposite direction."""
    if interface.dim != other.dim or interface.closed != other.closed:
        return False
    if interface.closed:
        return interface.runs_against(other)
    if interface.dim == 3:
        return False
    mine, theirs = interface.resampled(SHARES).points, other.resampled(SHARES).points
    return bool(np.sum((mine - theirs[::-1]) ** 2) < NEARER * np.sum((mine - theirs) ** 2))


def odd_ones(runs: Sequence[Mapping[str, Interface]], hidden: float) -> dict[int, str]:
    """Return the numbers of the runs that have no common points with most others, each with the reason.

    An interface may be `hidden` mm away from its common points, root mean square.
    """
    kinds = [tuple(_kind(one) for one in run.values()) for run in runs]
    ((usual, _),) = Counter(kinds).most_common(1)
    odd = {
        i: f"its interface is {' and '.join(kind)}, most others are {' and '.join(usual)}"
        for i, kind in enumerate(kinds)
        if kind != usual
    }
    for name in runs[0]:
        some = {i: run[name] for i, run in enumerate(runs) if i not in odd}
        misfits = [_misfits(some, layout, hidden) for layout in _layouts(list(some.values()))]
        fewest: dict[int, str] = min(misfits, key=len)
        odd |= fewest
    return odd


def _kind(interface: Interface) -> str:
    if interface.dim == 3:
        return "a surface"
    return "a closed polyline" if interface.closed else "an open polyline"


def _layouts(interfaces: Sequence[Interface]) -> list[PointLayout]:
    first = interfaces[0]
    same = all(one.points.shape == first.points.shape and np.array_equal(one.cells, first.cells) for one in interfaces)
    if same or first.dim == 2:
        return [common_layout(interfaces)]
    return [PointLayout(one, "projection", Reference(one)) for one in interfaces[:CANDIDATES]]


def _misfits(interfaces: Mapping[int, Interface], layout: PointLayout, hidden: float) -> dict[int, str]:
    out = {}
    for i, interface in interfaces.items():
        try:
            _, error = registered(interface, layout)
        except NoCommonPoints as problem:
            out[i] = str(problem.value)
            continue
        if error > hidden:
            out[i] = f"common points would lie {error:.3g} mm away from its interface, more than {hidden:.3g} mm"
    return out


def stopped_early(runs: Sequence[Mapping[str, Interface]]) -> dict[int, str]:
    """Return the numbers of the runs that seem to end before their end, each with the reason.

    A simulator that stops early leaves fewer points at the same spacing, or repeats its last value. Only open polylines
    are looked at.
    """
    found: dict[int, str] = {}
    for name in runs[0] if runs else ():
        interfaces = [run[name] for run in runs]
        if all(_kind(one) == "an open polyline" for one in interfaces):
            found |= _cut_off(interfaces) | _holding(interfaces)
    return found


def _cut_off(interfaces: Sequence[Interface]) -> dict[int, str]:
    """Return the runs that are clearly shorter than whole ones and have accordingly fewer points."""
    points = np.array([len(one.points) for one in interfaces])
    lengths = np.array([one.lengths.sum() for one in interfaces])
    whole = points == points.max()
    if whole.mean() < COMMON:
        return {}
    share, length = points / points.max(), lengths / np.median(lengths[whole])
    short = (share < SHORTER) & (length < SHORTER) & (np.abs(np.log(length / share)) < np.log(SPACING))
    return {
        int(i): f"its interface has {points[i]} of {points.max()} points and {length[i]:.0%} of the length of others"
        for i in np.flatnonzero(short)
    }


def _holding(interfaces: Sequence[Interface]) -> dict[int, str]:
    """Return the runs that end abruptly with a repeated value; not if others share it, a floor, or if most end so."""
    ends: dict[int, tuple[int, float]] = {}
    for i, one in enumerate(interfaces):
        for values in (one.points[::-1, 1], one.points[:, 1]):
            steps = np.abs(np.diff(values))
            held = int(np.argmax(steps > 0)) + 1
            moving = steps[held - 1 :]
            if held >= HELD and moving.all() and moving[0] > np.median(moving) / 2:
                ends[i] = held, float(values[0])
    shared = Counter(value for _, value in ends.values())
    own = {i: end for i, end in ends.items() if shared[end[1]] == 1}
    if len(own) > (1 - COMMON) * len(interfaces):
        return {}
    return {i: f"its last {held} values are {value:.6g}" for i, (held, value) in own.items()}
