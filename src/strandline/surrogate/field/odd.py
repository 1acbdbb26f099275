"""Find the interfaces that differ in kind from most others and cannot form one field with them."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from strandline.foundations import NoCommonPoints
from strandline.interface import Interface
from strandline.surrogate.field.correspondence import PointLayout, common_layout, registered
from strandline.surrogate.field.projection import Reference

CANDIDATES = 3
"""Number of surfaces tried as the reference of the projections."""
SHARES = 33
NEARER = 0.1
"""An open polyline counts as flipped if reversing it reduces the sum of squared distances to less than this share."""

COMMON = 0.25
"""Share of the runs that must have the most points for this to be the number of a whole run; where the mesh follows the
length of the interface, each number is rarer."""
SHORTER = 0.9
"""Share of a whole run's points, and of its length, below which a run counts as cut off."""
SPACING = 1.5
"""Ratio of spacings up to which a short run has the mesh of a whole one."""
HELD = 3
"""Equal last values that are no chance after a step of usual size."""


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
        misfits = [_left_out(some, layout, hidden) for layout in _layouts(list(some.values()))]
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


def _left_out(interfaces: Mapping[int, Interface], layout: PointLayout, hidden: float) -> dict[int, str]:
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

    A simulator that stops early leaves fewer points at the same spacing, or repeats its last value.

    Only open polylines are looked at.
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
    """Return the runs that end abruptly with a repeated value; not if others share it, a floor, or if most end so.

    Rounded values repeat also elsewhere.
    """
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
