"""Isotropic correlation functions with a length for each input: c(s), s² = Σ_d u_d², u_d = (x_d - x'_d) / l_d.

In units of the lengths they are the isotropic ones; only the derivative with respect to one length differs, with
g(s) = c'(s) / s as there: ∂c/∂log l_d = -u_d² g(s).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.surrogate.kernels.isotropic import Isotropic
from strandline.surrogate.kernels.protocol import Array
from strandline.surrogate.kernels.tiles import Tile, add_over_tiles, clear_above, offsets_of_tile, over_tiles

__all__ = ["Ard"]


@dataclass(frozen=True)
class Ard:
    """A correlation that is isotropic once each input is divided by its own length.

    Args:
        name: the key in `KERNELS`.
        radial: the correlation, its slope and rate, as functions of s.
    """

    name: str
    radial: Isotropic

    @property
    def per_input(self) -> bool:
        """True: each input has its own length."""
        return True

    def value(self, offset: Float[np.ndarray, "*shape dim"]) -> Float[np.ndarray, "*shape"]:
        """Return c."""
        return self.radial.value(offset)

    def weighted_gradient(
        self, offset: Float[np.ndarray, "point run dim"], weight: Float[np.ndarray, " run"]
    ) -> Float[np.ndarray, "point dim"]:
        """Return Σ_run weight ∇c."""
        return self.radial.weighted_gradient(offset, weight)

    def weighted_hessian(
        self, offset: Float[np.ndarray, "point run dim"], weight: Float[np.ndarray, " run"]
    ) -> Float[np.ndarray, "point dim dim"]:
        """Return Σ_run weight ∇∇c."""
        return self.radial.weighted_hessian(offset, weight)

    def of_columns(self, offset: Sequence[Array]) -> Array:
        """Return c of offsets given as one JAX array per input."""
        return self.radial.of_columns(offset)

    def pairs(self, x: Float[np.ndarray, "run dim"], *, unit: Float[np.ndarray, " length"]) -> "_Columns":
        """Return the columns of x / unit."""
        return _Columns(self.radial, np.ascontiguousarray((x / unit).T))


@dataclass(frozen=True, eq=False)
class _Columns:
    """See `Pairs`. Distances are recomputed each time: a matrix for each input would not fit in memory."""

    radial: Isotropic
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
        scaled = self.columns * inverse_lengths[:, None]

        def write(tile: Tile) -> None:
            rows, columns = tile
            s = np.sqrt(_squares(scaled, tile).sum(axis=0))
            np.multiply(self.radial.correlation(s), variance, out=out[rows, columns].T)

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
        scaled = self.columns * inverse_lengths[:, None]

        def part(tile: Tile) -> Float[np.ndarray, " dim"]:
            """Return what one tile adds to the slope."""
            rows, columns = tile
            squares = _squares(scaled, tile)
            weight = precision[rows, columns].T - alpha[columns, None] * alpha[rows]
            weight *= self.radial.slope(np.sqrt(squares.sum(axis=0)))
            clear_above(weight, tile)
            return np.asarray(squares.reshape(len(squares), -1) @ weight.ravel())

        return add_over_tiles(len(alpha), part)


def _squares(scaled: Float[np.ndarray, "dim run"], tile: Tile) -> Float[np.ndarray, "dim column row"]:
    offset = offsets_of_tile(scaled, tile)
    return np.asarray(np.square(offset, out=offset))
