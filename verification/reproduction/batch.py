"""Log-likelihoods of thousands of interfaces at once: the currents measure over a whole batch of polylines.

The polylines of a batch have the same number of points. Blocks of neighbours on a grid hardly differ, so that most
pairs of segments are too far apart in all of them and are left out together.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import erf

from strandline.discrepancy import Currents
from strandline.discrepancy.products.kernel_integrals import PANEL, gauss_order
from strandline.interface import Interface
from strandline.likelihood import InterfaceLikelihood

__all__ = ["batch_currents", "batch_log_likelihood"]

NEGLIGIBLE = 1e-10
"""Kernel values below this are left out: d² errs by this share of (length of the interface)² at most."""
WORK = 1 << 19
"""Numbers that are worked on at once."""
TOLERANCE = 1e-7
"""Of a Gauss rule of the refined quadrature, relative."""


def batch_log_likelihood(
    likelihood: InterfaceLikelihood, shapes: Float[np.ndarray, "run point 2"]
) -> Float[np.ndarray, " run"]:
    """Return log L of each interface; of one condition, without the constant.

    The currents measure is evaluated in blocks, any other one interface after the other.
    """
    measure = likelihood.discrepancy
    if isinstance(measure, Currents) and len(likelihood.observations) == 1:
        (observation,) = likelihood.observations
        return observation.noise.log_density(batch_currents(measure, shapes, observation.interface))
    return np.array([likelihood(Interface.polyline(points)) for points in shapes])


def batch_currents(
    measure: Currents, shapes: Float[np.ndarray, "run point 2"], observed: Interface
) -> Float[np.ndarray, " run"]:
    """Return d² = ⟨S,S⟩ - 2⟨S,T⟩ + ⟨T,T⟩ of each polyline S, mm²; orientation is taken to agree."""
    square = measure.inner(observed, observed)
    target = observed.points[None]
    size = max(1, WORK // (16 * shapes.shape[1] * (1 if measure.quadrature == "centre" else 32)))
    values = []
    for k in range(0, len(shapes), size):
        block = shapes[k : k + size]
        values.append(_product(measure, block, block) - 2 * _product(measure, block, target))
    return np.asarray(np.maximum(np.concatenate(values) + square, 0.0))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Segments `row` of S with segments `column` of T, each to be counted `times`."""

    row: Int[np.ndarray, " pair"]
    column: Int[np.ndarray, " pair"]
    times: Float[np.ndarray, " pair"]


def _product(
    measure: Currents, a: Float[np.ndarray, "run point 2"], b: Float[np.ndarray, "other point2 2"]
) -> Float[np.ndarray, " run"]:
    """Return ⟨a,b⟩ of each polyline of `a` with its partner in `b`, or with the only one."""
    pairs = _near(a, b, reach=measure.width * math.sqrt(-2 * math.log(NEGLIGIBLE)), symmetric=a is b)
    if measure.quadrature == "centre":
        return _centre(a, b, pairs, measure.width)
    return _refined(a, b, pairs, measure.width)


def _near(
    a: Float[np.ndarray, "run point 2"], b: Float[np.ndarray, "other point2 2"], *, reach: float, symmetric: bool
) -> _Pairs:
    """Return the pairs of segments whose bounding boxes over all runs come within `reach`; each pair once if alike."""
    low_a, high_a = _boxes(a)
    low_b, high_b = _boxes(b)
    gap = np.maximum(np.maximum(low_a[:, None] - high_b, low_b - high_a[:, None]), 0.0)
    row, column = np.nonzero(np.hypot(gap[..., 0], gap[..., 1]) <= reach)
    if not symmetric:
        return _Pairs(row, column, np.ones(len(row)))
    keep = row <= column
    row, column = row[keep], column[keep]
    return _Pairs(row, column, np.where(row < column, 2.0, 1.0))


def _boxes(
    shapes: Float[np.ndarray, "run point 2"],
) -> tuple[Float[np.ndarray, "segment 2"], Float[np.ndarray, "segment 2"]]:
    """Return the corners of the boxes that hold each segment in all runs."""
    low, high = shapes.min(axis=0), shapes.max(axis=0)
    return np.minimum(low[:-1], low[1:]), np.maximum(high[:-1], high[1:])


def _centre(
    a: Float[np.ndarray, "run point 2"], b: Float[np.ndarray, "other point2 2"], pairs: _Pairs, width: float
) -> Float[np.ndarray, " run"]:
    c, d = 0.5 * (a[:, :-1] + a[:, 1:]), 0.5 * (b[:, :-1] + b[:, 1:])
    n, m = np.diff(a, axis=1), np.diff(b, axis=1)  # turning both by 90° leaves their product
    x, y = (c[:, pairs.row, k] - d[:, pairs.column, k] for k in (0, 1))
    products = n[:, pairs.row, 0] * m[:, pairs.column, 0] + n[:, pairs.row, 1] * m[:, pairs.column, 1]
    return np.asarray((np.exp((x * x + y * y) * (-0.5 / width**2)) * products) @ pairs.times)


def _refined(
    a: Float[np.ndarray, "run point 2"], b: Float[np.ndarray, "other point2 2"], pairs: _Pairs, width: float
) -> Float[np.ndarray, " run"]:
    """Integrate in closed form along the segments of `b`, by Gauss–Legendre on pieces of those of `a`."""
    steps_a, steps_b = np.diff(a, axis=1), np.diff(b, axis=1)
    longest = float(np.hypot(steps_a[..., 0], steps_a[..., 1]).max())
    parts = max(1, math.ceil(longest / (PANEL * width)))
    nodes, weights = np.polynomial.legendre.leggauss(gauss_order(math.ceil(8 * longest / parts / width) / 8, TOLERANCE))
    nodes = ((0.5 * (nodes + 1))[None] + np.arange(parts)[:, None]).ravel() / parts
    weights = np.tile(0.5 * weights / parts, parts)
    scale = 1 / (math.sqrt(2) * width)
    length = np.hypot(steps_b[..., 0], steps_b[..., 1])
    tangent = (steps_b / length[..., None])[:, pairs.column]
    start = (a[:, :-1][:, pairs.row] - b[:, :-1][:, pairs.column]) * scale
    step = steps_a[:, pairs.row] * scale
    cosine = step[..., 0] * tangent[..., 0] + step[..., 1] * tangent[..., 1]
    sine = step[..., 1] * tangent[..., 0] - step[..., 0] * tangent[..., 1]
    along = start[..., 0] * tangent[..., 0] + start[..., 1] * tangent[..., 1]
    across = start[..., 1] * tangent[..., 0] - start[..., 0] * tangent[..., 1]
    ends = (length * scale)[:, pairs.column]
    total = np.zeros(cosine.shape)
    for node, weight in zip(nodes, weights, strict=True):
        u, v = along + cosine * node, across + sine * node
        total += weight * np.exp(-v * v) * (erf(u) - erf(u - ends))
    return np.asarray((total * cosine) @ pairs.times * (math.sqrt(math.pi) * width**2))
