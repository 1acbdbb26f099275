"""The inner product of two interfaces as currents: with one point per cell, or of polylines to a tolerance.

⟨S,T⟩ = ∫_S ∫_T K(x, y) n(x)·m(y) dy dx with the kernel K = exp(-|x-y|²/2σ²) and unit normals n, m; mm² in the plane.
Eqs. (10)-(11) of the study; σ is its σ_W.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.special import erf

from strandline.discrepancy.products.kernel_sums import SMALL, Nodes, kernel_sum
from strandline.errors import NumericsError
from strandline.interface import Interface

__all__ = ["PANEL", "centre_product", "gauss_order", "natural_scale", "refined_product"]

PANEL = 6.0
"""Longest piece of a segment that one Gauss rule integrates over, in kernel widths."""
BLOCK = 1 << 16
"""Pairs of pieces processed at once; this bounds the memory."""
_FAR = 1e-12
_RADII = np.geomspace(1.05, 1e4, 300)


def centre_product(a: Interface, b: Interface, width: float) -> float:
    """Return Σ_i Σ_j K(c_i, d_j) n_i·m_j, mm² (mm⁴), with cell centres c, d and normals n, m times length (area).

    If there are very many cells, pairs so far apart that they add up to less than 1e-12 of `natural_scale(a)` are left
    out.
    """
    nodes = Nodes(a.centres, a.normals)
    reach = math.inf if len(a.cells) * len(b.cells) <= SMALL else _reach(a, b, width)
    return kernel_sum(nodes, nodes if a is b else Nodes(b.centres, b.normals), width, reach=reach)


def _reach(a: Interface, b: Interface, width: float) -> float:
    sizes = float(a.sizes.sum()) * float(b.sizes.sum())
    return width * math.sqrt(2 * math.log(max(sizes / natural_scale(a, width) / _FAR, 1.0)))


def natural_scale(a: Interface, width: float) -> float:
    """Return size · min(size, (σ√2π)^k), mm² (mm⁴), of an interface of k dimensions.

    This is ⟨S,S⟩ of a straight line or a plane much larger (or smaller) than the width.
    """
    size = float(a.sizes.sum())
    return size * min(size, (width * math.sqrt(2 * math.pi)) ** (a.dim - 1))


def refined_product(a: Interface, b: Interface, width: float, *, tolerance: float) -> float:
    """Return ⟨a,b⟩ of the polylines themselves, mm², whatever their segmentation.

    The integral over a segment of `b` is in closed form (erf). The one over `a` uses Gauss–Legendre rules on pieces no
    longer than `PANEL` widths, of the order at which their error bound (`gauss_order`) falls below `tolerance`.
    Pairs too far apart to matter at this tolerance are left out.

    Args:
        a: polyline of the outer integral.
        b: polyline of the inner integral.
        width: kernel width σ, mm.
        tolerance: error relative to `natural_scale(a)`, if `b` does not pass near one point many times.
    """
    pieces = _Pieces.of(a, PANEL * width)
    longest = float(pieces.lengths.max())
    order = gauss_order(math.ceil(8 * longest / width) / 8, tolerance)
    length = float(b.lengths.sum())
    reach = width * math.sqrt(2 * math.log(max(length / min(length, width), 1.0) / tolerance))
    return math.fsum(
        _pair_integrals(pieces, b, pairs, width, order)
        for rows in _blocks(len(pieces.starts), len(b.cells))
        for pairs in _chunks(_near_pairs(pieces, b, rows, reach), order)
    )


@lru_cache(maxsize=512)
def gauss_order(ratio: float, tolerance: float) -> int:
    """Return how many Gauss–Legendre points integrate the kernel along a piece `ratio` widths long.

    In the complex plane of the arc length the kernel grows as exp(y²/2σ²), where y is the imaginary part. On the
    Bernstein ellipse of radius ρ around the piece it grows by at most exp(ratio²(ρ - 1/ρ)²/32). So the error of m
    points, exact for polynomials up to degree 2m-1, is at most 4 ρ^(1-2m)/(ρ-1) times that, relative to the piece's
    length times the integral of the kernel. The best ρ is used.

    Raises:
        NumericsError: no rule of up to 100 points reaches the tolerance.
    """
    growth = (ratio * (_RADII - 1 / _RADII)) ** 2 / 32
    for order in range(1, 101):
        log_bound = math.log(4) + growth + (1 - 2 * order) * np.log(_RADII) - np.log(_RADII - 1)
        if log_bound.min() <= math.log(tolerance):
            return order
    raise NumericsError(
        f"no Gauss rule integrates a piece of {ratio:g} kernel widths to {tolerance:g}; allow a larger tolerance"
    )


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Straight pieces of a polyline: starts and steps (from start to end), mm."""

    starts: Float[np.ndarray, "piece 2"]
    steps: Float[np.ndarray, "piece 2"]

    @classmethod
    def of(cls, polyline: Interface, longest: float) -> "_Pieces":
        """Divide every segment into equal pieces no longer than `longest`."""
        parts = np.maximum(np.ceil(polyline.lengths / longest).astype(int), 1)
        steps = np.repeat((polyline.ends - polyline.starts) / parts[:, None], parts, axis=0)
        rank = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        return cls(np.repeat(polyline.starts, parts, axis=0) + rank[:, None] * steps, steps)

    @property
    def lengths(self) -> Float[np.ndarray, " piece"]:
        return np.asarray(np.hypot(self.steps[:, 0], self.steps[:, 1]))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pieces `row` in the frame of the segments `column`: all of shape (pair,)."""

    row: Int[np.ndarray, " pair"]
    column: Int[np.ndarray, " pair"]


def _near_pairs(pieces: _Pieces, b: Interface, rows: slice, reach: float) -> _Pairs:
    """Return the pairs (piece, segment) that come within `reach` of each other, perhaps a few more."""
    tangents = (b.ends - b.starts) / b.lengths[:, None]
    middle = pieces.starts[rows] + 0.5 * pieces.steps[rows]
    x, y = (middle[:, k, None] - b.starts[:, k] for k in (0, 1))
    along = x * tangents[:, 0] + y * tangents[:, 1]
    beyond = along - np.clip(along, 0.0, b.lengths)
    off = x * tangents[:, 1] - y * tangents[:, 0]
    near = beyond**2 + off**2 <= (reach + 0.5 * pieces.lengths[rows, None]) ** 2
    row, column = np.nonzero(near)
    return _Pairs(row + rows.start, column)


def _pair_integrals(pieces: _Pieces, b: Interface, pairs: _Pairs, width: float, order: int) -> float:
    """Return Σ over the pairs of n·m ∫∫ K; `along` and `across` are the nodes' coordinates in the segment's frame."""
    nodes, weights = _unit_gauss(order)
    scale = 1 / (math.sqrt(2) * width)
    lengths = b.lengths[pairs.column]
    t = (b.ends - b.starts)[pairs.column] / lengths[:, None]
    start = (pieces.starts[pairs.row] - b.starts[pairs.column]) * scale
    step = pieces.steps[pairs.row] * scale
    cosine = step[:, 0] * t[:, 0] + step[:, 1] * t[:, 1]
    sine = step[:, 1] * t[:, 0] - step[:, 0] * t[:, 1]
    along = (start[:, 0] * t[:, 0] + start[:, 1] * t[:, 1])[:, None] + cosine[:, None] * nodes
    across = (start[:, 1] * t[:, 0] - start[:, 0] * t[:, 1])[:, None] + sine[:, None] * nodes
    inner = np.exp(-(across**2)) * (erf(along) - erf(along - (lengths * scale)[:, None]))
    return float(cosine @ (inner @ weights)) * math.sqrt(math.pi) * width**2


@lru_cache(maxsize=128)
def _unit_gauss(order: int) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Return nodes and weights of the Gauss–Legendre rule on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return 0.5 * (nodes + 1), 0.5 * weights


def _blocks(rows: int, columns: int) -> Iterator[slice]:
    size = max(1, BLOCK // columns)
    return (slice(k, min(k + size, rows)) for k in range(0, rows, size))


def _chunks(pairs: _Pairs, order: int) -> Iterator[_Pairs]:
    size = max(1, BLOCK // order)
    return (_Pairs(pairs.row[k : k + size], pairs.column[k : k + size]) for k in range(0, len(pairs.row), size))
