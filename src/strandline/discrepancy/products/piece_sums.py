"""Inner products of polylines as currents, many at once, by Gauss rules on their pieces: compiled, and with NumPy.

⟨a,b⟩ = Σ over pairs of pieces of h·g Σ_ξ Σ_η w_ξ w_η K(x + ξh, y + ηg), with middles x, y, halves h, g and
Gauss–Legendre nodes ξ, η and weights on [-1, 1]. The unit of length is σ_W √(2 ln 2): the kernel K is 2^-|x - y|².
"""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.discrepancy.products.pieces import Pairs, Pieces
from strandline.numerics.compiled import WIDEST
from strandline.numerics.exp2 import WHOLE, exp2_of_minus

__all__ = ["Orders", "PieceSum", "compiled_sum", "plain_sum"]

Orders = tuple[int, int]
"""Number of Gauss points on a piece of one side and of the other."""
PieceSum = Callable[[Pieces, Pieces, Pairs, Orders], Float[np.ndarray, " run"]]

_CHUNK = 1 << 15
"""Numbers that NumPy processes at once."""
_PIECES = 64
"""The number of pieces is padded to a multiple of this."""
_FARTHEST, _STEEPEST = 900.0, 200.0
"""Limits of exponents, to avoid overflow; only pairs so far apart that they contribute nothing reach them."""


def plain_sum(a: Pieces, b: Pieces, pairs: Pairs, orders: Orders) -> Float[np.ndarray, " run"]:
    """Return ⟨a,b⟩ of each run, in squares of the unit; `b` may be the same for all runs."""
    (nodes, weights), (others, other_weights) = (np.polynomial.legendre.leggauss(order) for order in orders)
    total = np.zeros(a.middles.shape[2])
    size = max(1, _CHUNK // len(total))
    for k in range(0, len(pairs.row), size):
        i, j = pairs.row[k : k + size], pairs.column[k : k + size]
        h, g = a.halves[i], b.halves[j].reshape(len(j), 2, -1)
        apart = a.middles[i] - b.middles[j].reshape(g.shape)
        kernel = np.zeros((len(i), len(total)))
        for x, w in zip(nodes, weights, strict=True):
            for y, v in zip(others, other_weights, strict=True):
                kernel += w * v * np.exp2(-((apart + x * h - y * g) ** 2).sum(axis=1))
        total += pairs.times[k : k + size] @ (kernel * (h * g).sum(axis=1))
    return total


def compiled_sum(a: Pieces, b: Pieces, pairs: Pairs, orders: Orders) -> Float[np.ndarray, " run"]:
    """Return the same, with JAX in double precision."""
    number = len(pairs.row)
    room = (1 << max(number - 1, 0).bit_length()) - number  # few lengths: each one is compiled for
    rows = (np.pad(some, (0, room)) for some in (pairs.row, pairs.column, pairs.times))
    pieces = (_padded(some) for some in (a.middles, a.halves, b.middles, b.halves))
    return np.asarray(_loop()(*pieces, *rows, number, WHOLE, orders=orders))


def _padded(pieces: Float[np.ndarray, "piece 2 *run"]) -> Float[np.ndarray, "more 2 *run"]:
    """Return pieces with more behind them, which no pair refers to, so that there are few lengths."""
    room = -len(pieces) % _PIECES
    return np.pad(pieces, ((0, room), *((0, 0),) * (pieces.ndim - 1)))


@lru_cache(maxsize=1)
def _loop() -> Any:
    """Return the compiled loop over the pairs, with the runs on the last axis."""
    import jax
    import jax.numpy as jnp

    @partial(jax.jit, compiler_options=WIDEST, static_argnames="orders")
    def loop(
        middles: Any,
        halves: Any,
        others: Any,
        other_halves: Any,
        row: Any,
        column: Any,
        times: Any,
        number: Any,
        whole: Any,
        *,
        orders: Orders,
    ) -> Any:
        """Sum the contributions of the pairs in turn."""

        def add(k: Any, total: Any) -> Any:
            i, j = row[k], column[k]
            apart = [middles[i, axis] - others[j, axis] for axis in (0, 1)]
            h, g = [halves[i, axis] for axis in (0, 1)], [other_halves[j, axis] for axis in (0, 1)]
            return total + times[k] * _pair(apart, h, g, whole, orders)

        return jax.lax.fori_loop(0, number, add, jnp.zeros(middles.shape[2]))

    return loop


def _pair(apart: Any, h: Any, g: Any, whole: Any, orders: Orders) -> Any:
    """Return the contribution of one pair of pieces.

    |d + ξh - ηg|² = |d|² + (ξ²|h|² + 2ξ d·h) + (η²|g|² - 2η d·g) - 2ξη h·g: the kernel is a product of four powers.
    Only the one with h·g depends on both nodes; a pair of nodes and the opposite pair share it.
    """
    import jax.numpy as jnp

    power = partial(exp2_of_minus, whole=whole, bounded=True)
    both = _dot(h, g)
    zero, ours = _powers(power, _dot(h, h), 2 * _dot(apart, h), orders[0])
    other_zero, theirs = _powers(power, _dot(g, g), -2 * _dot(apart, g), orders[1])
    total = zero * other_zero
    for _, ahead, behind in theirs:
        total += zero * (ahead + behind)
    for x, ahead, behind in ours:
        total += other_zero * (ahead + behind)
        for y, other_ahead, other_behind in theirs:
            twist = 2 * (x * y)
            total += power(-twist * both) * (ahead * other_ahead + behind * other_behind)
            total += power(twist * both) * (ahead * other_behind + behind * other_ahead)
    return total * power(jnp.minimum(_dot(apart, apart), _FARTHEST)) * both


def _powers(power: Any, square: Any, slope: Any, order: int) -> tuple[float, list[tuple[float, Any, Any]]]:
    """Return the weight of the node 0, and each positive node ξ with w_ξ 2^-(ξ² square ± ξ slope)."""
    import jax.numpy as jnp

    slope = jnp.clip(slope, -_STEEPEST, _STEEPEST)
    nodes, weights = np.polynomial.legendre.leggauss(order)
    positive = zip(nodes[(order + 1) // 2 :].tolist(), weights[(order + 1) // 2 :].tolist(), strict=True)
    return float(weights[order // 2]) * (order % 2), [
        (x, w * power(x * x * square + x * slope), w * power(x * x * square - x * slope)) for x, w in positive
    ]


def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1]
