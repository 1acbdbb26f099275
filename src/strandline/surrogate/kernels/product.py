"""Products over the inputs of one-dimensional correlation functions p(t) exp(-t), t = κ |x - x'| / l.

Each input has its own length l, and the whole has one variance: if each factor had its own, data could determine
only their product. The Matérn functions of half-integer order have this form, and their product needs a single
exponential: c = Π_d p(t_d) · exp(-Σ_d t_d). Relative to c, and with u = (x - x') / l:

- ∂c/∂u_d = -κ² u_d q(t_d) c with the decline q(t) = (p - p') / (t p);
- ∂c/∂log l_d = t_d² q(t_d) c;
- ∂²c/∂u_d² = κ² (p - 2p' + p'') / p · c, the curvature.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from strandline.surrogate.kernels.protocol import Array
from strandline.surrogate.kernels.tiles import Tile, add_over_tiles, clear_above, offsets_of_tile, over_tiles

__all__ = ["Product"]


@dataclass(frozen=True)
class Product:
    """A product of one-dimensional correlations; functions of t ≥ 0 on NumPy and JAX arrays of any shape.

    Args:
        name: the key in `KERNELS`.
        rate: κ.
        polynomial: p(t), p(0) = 1.
        decline: (p - p') / (t p).
        curvature: (p - 2p' + p'') / p.
    """

    name: str
    rate: float
    polynomial: Callable[[Array], Array]
    decline: Callable[[Array], Array]
    curvature: Callable[[Array], Array]

    @property
    def per_input(self) -> bool:
        """True: each input has its own length."""
        return True

    def value(self, offset: Float[np.ndarray, "*shape dim"]) -> Float[np.ndarray, "*shape"]:
        """Return c."""
        t = self.rate * np.abs(offset)
        return np.asarray(np.prod(self.polynomial(t), axis=-1) * np.exp(-t.sum(axis=-1)))

    def weighted_gradient(
        self, offset: Float[np.ndarray, "point run dim"], weight: Float[np.ndarray, " run"]
    ) -> Float[np.ndarray, "point dim"]:
        """Return Σ_run weight ∇c."""
        return np.asarray(np.einsum("bn,bnd->bd", self.value(offset) * weight, self._relative_slope(offset)))

    def weighted_hessian(
        self, offset: Float[np.ndarray, "point run dim"], weight: Float[np.ndarray, " run"]
    ) -> Float[np.ndarray, "point dim dim"]:
        """Return Σ_run weight ∇∇c."""
        c, slope = self.value(offset) * weight, self._relative_slope(offset)
        bend = self.rate**2 * self.curvature(self.rate * np.abs(offset))
        out = np.einsum("bn,bnd,bne->bde", c, slope, slope, optimize=True)
        np.einsum("bdd->bd", out)[:] = np.einsum("bn,bnd->bd", c, bend)
        return np.asarray(out)

    def of_columns(self, offset: Sequence[Array]) -> Array:
        """Return c of offsets given as one JAX array per input."""
        distance = [jnp.abs(column) for column in offset]
        return math.prod(self.polynomial(self.rate * u) for u in distance) * jnp.exp(-self.rate * sum(distance))

    def pairs(self, x: Float[np.ndarray, "run dim"], *, unit: Float[np.ndarray, " length"]) -> "_Columns":
        """Return the columns of x / unit."""
        return _Columns(self, np.ascontiguousarray((x / unit).T))

    def _relative_slope(self, offset: Float[np.ndarray, "*shape dim"]) -> Float[np.ndarray, "*shape dim"]:
        """Return ∇c / c."""
        return np.asarray(-(self.rate**2) * self.decline(self.rate * np.abs(offset)) * offset)


@dataclass(frozen=True, eq=False)
class _Columns:
    """See `Pairs`. Distances are recomputed each time: a matrix for each input would not fit in memory."""

    kernel: Product
    columns: Float[np.ndarray, "dim run"]

    def fill(
        self,
        out: Float[np.ndarray, "run run"],
        *,
        inverse_lengths: Float[np.ndarray, " dim"],
        variance: float,
        diagonal: float,
    ) -> None:
        """Write variance · c + diagonal · I into the lower triangle of `out`."""
        scaled = self._scaled(inverse_lengths)

        def write(tile: Tile) -> None:
            rows, columns = tile
            np.multiply(self._correlation(_distances(scaled, tile)), variance, out=out[rows, columns].T)

        over_tiles(len(out), write)
        np.einsum("ii->i", out)[:] += diagonal

    def by_log_lengths(
        self,
        alpha: Float[np.ndarray, " run"],
        precision: Float[np.ndarray, "run run"],
        *,
        inverse_lengths: Float[np.ndarray, " dim"],
    ) -> Float[np.ndarray, " dim"]:
        """Return Σ_i>j (α_i α_j - P_ij) ∂c_ij / ∂log l_d; the diagonal adds nothing."""
        scaled = self._scaled(inverse_lengths)

        def part(tile: Tile) -> Float[np.ndarray, " dim"]:
            """Return what one tile adds to the slope."""
            rows, columns = tile
            t = _distances(scaled, tile)
            weight = alpha[columns, None] * alpha[rows]
            weight -= precision[rows, columns].T
            weight *= self._correlation(t)
            clear_above(weight, tile)
            growth = self.kernel.decline(t)
            growth *= t
            growth *= t
            return np.asarray(growth.reshape(len(growth), -1) @ weight.ravel())

        return add_over_tiles(len(alpha), part)

    def _scaled(self, inverse_lengths: Float[np.ndarray, " dim"]) -> Float[np.ndarray, "dim run"]:
        return self.columns * (self.kernel.rate * inverse_lengths)[:, None]

    def _correlation(self, t: Float[np.ndarray, "dim column row"]) -> Float[np.ndarray, "column row"]:
        product = np.multiply.reduce(self.kernel.polynomial(t), axis=0)
        decay = t.sum(axis=0)
        np.negative(decay, out=decay)
        product *= np.exp(decay, out=decay)
        return np.asarray(product)


def _distances(scaled: Float[np.ndarray, "dim run"], tile: Tile) -> Float[np.ndarray, "dim column row"]:
    offset = offsets_of_tile(scaled, tile)
    return np.asarray(np.abs(offset, out=offset))
