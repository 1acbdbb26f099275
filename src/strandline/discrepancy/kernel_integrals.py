"""The inner product of two interfaces as currents: with one point per cell, or to a tolerance whatever their cells.

⟨S,T⟩ = ∫_S ∫_T K(x, y) n(x)·m(y) dy dx with the kernel K = exp(-|x-y|²/2σ²) and unit normals n, m; mm² in the plane,
mm⁴ for surfaces. Eqs. (10)-(11) of the study; σ is its σ_W.
"""

import math
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.special import erf, gammaln, roots_jacobi

from strandline.discrepancy.kernel_sums import SMALL, Nodes, kernel_sum
from strandline.foundations import NumericsError
from strandline.interface import Interface

Pairs = Int[np.ndarray, " pair"]
PANEL = 6.0  # longest piece of a segment that one Gauss rule integrates over, in kernel widths
BLOCK = 1 << 16  # pairs of pieces processed at once; this bounds the memory
_FAR = 1e-12
_RADII = np.geomspace(1.05, 1e4, 300)
TRIANGLE = 2.5
"""Radius of the largest triangle that one rule integrates over, in kernel widths; larger ones are divided."""
_HIGHEST = 30


def centre_product(a: Interface, b: Interface, width: float) -> float:
    """Return Σ_i Σ_j K(c_i, d_j) n_i·m_j, mm² (mm⁴), with cell centres c, d and normals n, m times length (area).

    If there are very many cells, pairs so far apart that they add up to less than 1e-12 of `natural_scale(a)` are left
    out.
    """
    nodes, reach = Nodes(a.centres, a.normals), math.inf
    if len(a.cells) * len(b.cells) > SMALL:
        sizes = float(a.sizes.sum()) * float(b.sizes.sum())
        reach = width * math.sqrt(2 * math.log(max(sizes / natural_scale(a, width) / _FAR, 1.0)))
    return kernel_sum(nodes, nodes if a is b else Nodes(b.centres, b.normals), width, reach=reach)


def natural_scale(a: Interface, width: float) -> float:
    """Return size · min(size, (σ√2π)^k), mm² (mm⁴), of an interface of k dimensions.

    This is ⟨S,S⟩ of a straight line or a plane much larger (or smaller) than the width.
    """
    size = float(a.sizes.sum())
    return size * min(size, (width * math.sqrt(2 * math.pi)) ** (a.dim - 1))


def refined_product(a: Interface, b: Interface, width: float, *, tolerance: float) -> float:
    """Return ⟨a,b⟩ of the polylines themselves, mm², whatever their segmentation.

    The integral over a segment of `b` is in closed form (erf). The one over `a` uses Gauss–Legendre rules on pieces no
    longer than `PANEL` widths, of the order at which their error bound (`gauss_order`) falls below `tolerance`. Pairs
    too far apart to matter at this tolerance are left out. The error is relative to `natural_scale(a)`, if `b` does not
    pass near one point many times.
    """
    pieces = _Pieces(a, PANEL * width)
    longest = float(pieces.lengths.max())
    order = gauss_order(math.ceil(8 * longest / width) / 8, tolerance)
    length = float(b.lengths.sum())
    reach = width * math.sqrt(2 * math.log(max(length / min(length, width), 1.0) / tolerance))
    rows, size = max(1, BLOCK // len(b.cells)), max(1, BLOCK // order)
    near = (_near_pairs(pieces, b, slice(k, k + rows), reach) for k in range(0, len(pieces.starts), rows))
    return math.fsum(
        _pair_integrals(pieces, b, row[k : k + size], column[k : k + size], width, order)
        for row, column in near
        for k in range(0, len(row), size)
    )


@lru_cache(maxsize=512)
def gauss_order(ratio: float, tolerance: float) -> int:
    """Return how many Gauss–Legendre points integrate the kernel along a piece `ratio` widths long.

    In the complex plane of the arc length the kernel grows as exp(y²/2σ²), where y is the imaginary part. On the
    Bernstein ellipse of radius ρ around the piece it grows by at most exp(ratio²(ρ - 1/ρ)²/32). So the error of m
    points, exact for polynomials up to degree 2m-1, is at most 4 ρ^(1-2m)/(ρ-1) times that, relative to the piece's
    length times the integral of the kernel. The best ρ is used.
    """
    growth = (ratio * (_RADII - 1 / _RADII)) ** 2 / 32
    for order in range(1, 101):
        log_bound = math.log(4) + growth + (1 - 2 * order) * np.log(_RADII) - np.log(_RADII - 1)
        if log_bound.min() <= math.log(tolerance):
            return order
    raise NumericsError(
        f"no Gauss rule integrates a piece of {ratio:g} kernel widths to {tolerance:g}; allow a larger tolerance"
    )


class _Pieces:
    """Equal straight pieces of each segment of a polyline: starts, and steps from start to end, (piece, 2), mm."""

    def __init__(self, polyline: Interface, longest: float) -> None:
        parts = np.maximum(np.ceil(polyline.lengths / longest).astype(int), 1)
        self.steps = np.repeat((polyline.ends - polyline.starts) / parts[:, None], parts, axis=0)
        rank = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        self.starts = np.repeat(polyline.starts, parts, axis=0) + rank[:, None] * self.steps

    @property
    def lengths(self) -> Float[np.ndarray, " piece"]:
        return np.asarray(np.hypot(self.steps[:, 0], self.steps[:, 1]))


def _near_pairs(pieces: _Pieces, b: Interface, rows: slice, reach: float) -> tuple[Pairs, Pairs]:
    """Return the pieces and segments that come within `reach` of each other, perhaps a few more."""
    tangents = (b.ends - b.starts) / b.lengths[:, None]
    middle = pieces.starts[rows] + 0.5 * pieces.steps[rows]
    x, y = (middle[:, k, None] - b.starts[:, k] for k in (0, 1))
    along = x * tangents[:, 0] + y * tangents[:, 1]
    beyond = along - np.clip(along, 0.0, b.lengths)
    off = x * tangents[:, 1] - y * tangents[:, 0]
    near = beyond**2 + off**2 <= (reach + 0.5 * pieces.lengths[rows, None]) ** 2
    row, column = np.nonzero(near)
    return row + rows.start, column


def _pair_integrals(pieces: _Pieces, b: Interface, row: Pairs, column: Pairs, width: float, order: int) -> float:
    """Return Σ over the pairs of n·m ∫∫ K; `along` and `across` are the nodes' coordinates in the segment's frame."""
    nodes, weights = _unit_gauss(order)
    scale = 1 / (math.sqrt(2) * width)
    lengths = b.lengths[column]
    t = (b.ends - b.starts)[column] / lengths[:, None]
    start = (pieces.starts[row] - b.starts[column]) * scale
    step = pieces.steps[row] * scale
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


def refined_surface_product(a: Interface, b: Interface, width: float, *, tolerance: float) -> float:
    """Return ⟨a,b⟩ of the surfaces themselves, mm⁴, whatever their triangulation.

    Gauss rules on triangles no larger than `TRIANGLE` widths integrate both, each of the order at which its error bound
    (`error_bound`) falls below the tolerance. Pairs too far apart to matter at this tolerance are left out. The error
    is relative to area · min(area, 2πσ²) of `a`, the ⟨a,a⟩ of a plane much larger (or smaller) than the width, if `b`
    does not pass near one point many times.
    """
    (area, other), plane = (float(one.areas.sum()) for one in (a, b)), 2 * math.pi * width**2
    least = min(area, plane)
    reach = width * math.sqrt(2 * math.log(max(2 * other / (least * tolerance), 1.0)))
    near = min(other, math.pi * reach**2)
    allowed = 0.25 * tolerance * least / near
    nodes = surface_nodes(a, width, allowed)
    return kernel_sum(nodes, nodes if a is b else surface_nodes(b, width, allowed), width, reach=reach)


def surface_nodes(surface: Interface, width: float, tolerance: float) -> Nodes:
    """Return quadrature points of a surface, (node, 3) mm, and normals times their shares of the area, (node, 3) mm².

    They integrate the kernel around any point to `tolerance` relative to the area times the kernel's peak.
    """
    corners, normals = surface.points[surface.cells], surface.normals
    radii = _enclosing_radii(corners) / width
    parts = np.maximum(np.ceil(radii / TRIANGLE), 1).astype(int)
    ratios = np.ceil(8 * radii / parts) / 8
    orders = np.array([triangle_order(ratio, tolerance) for ratio in ratios.tolist()])
    found = []
    for part, order in np.unique(np.stack([parts, orders]), axis=1).T.tolist():
        some = (parts == part) & (orders == order)
        shares, weights = _divided_rule(part, order)
        found.append(
            Nodes(
                np.einsum("nk,tkx->tnx", shares, corners[some]).reshape(-1, 3),
                (weights[:, None] * normals[some][:, None]).reshape(-1, 3),
            )
        )
    return Nodes(np.concatenate([one.points for one in found]), np.concatenate([one.normals for one in found]))


@lru_cache(maxsize=4096)
def triangle_order(ratio: float, tolerance: float) -> int:
    """Return the lowest order of a rule whose error bound on a triangle of radius `ratio` widths is in tolerance."""
    for order in range(1, _HIGHEST + 1):
        if error_bound(order, ratio) <= tolerance:
            return order
    raise NumericsError(
        f"no rule integrates a triangle of radius {ratio:g} kernel widths to {tolerance:g}; allow a larger tolerance"
    )


def error_bound(order: int, ratio: float) -> float:
    """Return a bound on the error of `triangle_rule(order)`, relative to the area times the kernel's peak.

    The kernel is a mean of plane waves exp(ik·x), where k is normal with variance 1/σ² per component. On a disc of
    radius R around the triangle, a polynomial of degree p along k comes within 2 Σ_{n>p} |J_n(|k|R)| ≤
    2 Σ_{n>p} (|k|R/2)ⁿ/n! of such a wave. The rule is exact for p = 2·order-1 and its weights are positive, so its
    error is at most twice the mean of that: 4 Σ_{n>p} (R/√2σ)ⁿ Γ(1+n/2)/n!, with R = ratio · σ.
    """
    n = np.arange(2 * order, 2 * order + 200)
    return float(4 * np.exp(n * math.log(ratio / math.sqrt(2)) + gammaln(1 + n / 2) - gammaln(n + 1)).sum())


@lru_cache(maxsize=64)
def triangle_rule(order: int) -> tuple[Float[np.ndarray, "node 3"], Float[np.ndarray, " node"]]:
    """Return shares of the corners and weights (sum 1) of a rule with order² points, exact up to degree 2·order-1.

    The rule is Gauss–Jacobi along the line from the first corner and Gauss–Legendre across it.
    """
    s, along = roots_jacobi(order, 0, 1)
    t, across = np.polynomial.legendre.leggauss(order)
    s, t = 0.5 * (s + 1), 0.5 * (t + 1)
    shares = np.stack(np.broadcast_arrays(1 - s[:, None], s[:, None] * (1 - t), s[:, None] * t), axis=-1)
    weights = np.outer(along, across).ravel()
    return shares.reshape(-1, 3), weights / weights.sum()


@lru_cache(maxsize=64)
def _divided_rule(parts: int, order: int) -> tuple[Float[np.ndarray, "node 3"], Float[np.ndarray, " node"]]:
    """Return the rule on parts² equal triangles, similar to the whole, that cut each side into `parts`."""
    shares, weights = triangle_rule(order)
    rows, columns = np.divmod(np.arange(parts**2), parts)
    upright = rows + columns < parts
    i, j = (np.where(upright, one, parts - one) for one in (rows, columns))
    k = np.where(upright, parts - 1, parts + 1) - i - j
    lattice, sign = np.stack([i, j, k], axis=1), np.where(upright, 1, -1)
    pieces = (lattice[:, None] + sign[:, None, None] * shares) / parts
    return pieces.reshape(-1, 3), np.tile(weights, parts**2) / parts**2


def _enclosing_radii(corners: Float[np.ndarray, "cell 3 3"]) -> Float[np.ndarray, " cell"]:
    """Return the radius, mm, of the smallest disc that holds each triangle."""
    sides = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
    a, b, c = sides.T
    twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    acute = a**2 + b**2 > c**2
    return np.asarray(np.where(acute, a * b * c / (2 * twice), 0.5 * c))
