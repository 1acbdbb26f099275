"""The inner product of two triangulated surfaces as currents, integrated to a tolerance whatever their triangles.

⟨S,T⟩ = ∫_S ∫_T K(x, y) n(x)·m(y) dA dA with the kernel K = exp(-|x-y|²/2σ²) and unit normals n, m; mm⁴.
"""

import math
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln, roots_jacobi

from strandline.discrepancy.products.kernel_sums import Nodes, kernel_sum
from strandline.errors import NumericsError
from strandline.interface import Interface

__all__ = ["error_bound", "refined_surface_product", "surface_nodes", "triangle_order", "triangle_rule"]

PANEL = 2.5
"""Radius of the largest triangle that one rule integrates over, in kernel widths; larger ones are divided."""
_HIGHEST = 30


def refined_surface_product(a: Interface, b: Interface, width: float, *, tolerance: float) -> float:
    """Return ⟨a,b⟩ of the surfaces themselves, mm⁴, whatever their triangulation.

    Both are integrated by Gauss rules on triangles no larger than `PANEL` widths, each of the order at which its error
    bound (`error_bound`) falls below the tolerance. Pairs too far apart to matter at this tolerance are left out.

    Args:
        a: one surface.
        b: the other surface.
        width: kernel width σ, mm.
        tolerance: error relative to area · min(area, 2πσ²) of `a`, the ⟨a,a⟩ of a plane much larger (or smaller) than
            the width, if `b` does not pass near one point many times.

    Raises:
        NumericsError: no rule reaches the tolerance.
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
    parts = np.maximum(np.ceil(radii / PANEL), 1).astype(int)
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
    """Return the lowest order of a rule whose error bound on a triangle of radius `ratio` widths is within tolerance.

    Raises:
        NumericsError: no order up to the highest reaches it.
    """
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
