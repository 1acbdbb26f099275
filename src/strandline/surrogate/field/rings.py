"""Closed polylines brought to one first point and one direction.

Tracers and contour finders begin a closed outline anywhere, in either direction. All outlines are turned to the same
side and shifted along themselves until they lie closest to their common mean: by whole nodes, or by any share of their
length. The best shift is the largest cross-correlation with the mean, found by FFT.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int

from strandline.interface import Interface

__all__ = ["mean_by_nodes", "mean_by_share", "resampled_like", "turned_nodes"]

SWEEPS = 10
"""Most sweeps over the outlines until their mean stays; two or three suffice if it is well defined."""
FINER = 8
"""Trial shifts for each point of the mean; a parabola through the best three finds the shift between them."""

Ring = Float[np.ndarray, "point 2"]


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


def mean_by_nodes(interfaces: Sequence[Interface]) -> Interface:
    """Return the mean of closed polylines of the same number of nodes, each turned and shifted by whole nodes."""
    return _mean(interfaces, lambda one, mean: one.points[turned_nodes(one, mean)])


def mean_by_share(interfaces: Sequence[Interface], number: int) -> Interface:
    """Return the mean of closed polylines, each taken at `number` equally spaced points and shifted by any share."""
    first = [one.resampled(number) for one in interfaces]
    return _mean(first, lambda one, mean: resampled_like(one, mean).points)


def _mean(interfaces: Sequence[Interface], brought: Callable[[Interface, Interface], Ring]) -> Interface:
    """Return the mean of the outlines brought to it, beginning with the first one."""
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
    found = _correlation(points, mean, FINER)
    best = int(np.argmax(found))
    before, at, after = found[best - 1], found[best], found[(best + 1) % len(found)]
    bend = before - 2 * at + after
    return float((best + (0.5 * (before - after) / bend if bend < 0 else 0.0)) / len(found) % 1.0)
