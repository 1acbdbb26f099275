"""Isotropic correlation functions c(s) of the scaled distance s = r / l.

Everything that a Gaussian process needs follows from three functions of s:

- c(s), the correlation;
- g(s) = c'(s) / s, finite at s = 0: ∇c = g(s) (x - x') / l², and ∂c/∂log l = -s² g(s);
- g'(s): ∇∇c = g(s) I / l² + g'(s) / s · (x - x')(x - x')ᵀ / l⁴.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from strandline.numerics.linear_algebra import distances
from strandline.surrogate.kernels.protocol import Array
from strandline.surrogate.kernels.tiles import Tile, add_over_tiles, clear_above, over_tiles

__all__ = ["Isotropic"]


@dataclass(frozen=True)
class Isotropic:
    """A twice differentiable isotropic correlation; functions of s = r / l on NumPy and JAX arrays of any shape.

    Args:
        name: the key in `KERNELS`.
        correlation: c(s).
        slope: g(s) = c'(s) / s.
        slope_rate: g'(s).
    """

    name: str
    correlation: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    slope_rate: Callable[[Array], Array]

    @property
    def per_input(self) -> bool:
        """False: one length for all inputs."""
        return False

    def by_log_length(self, s: Array) -> Array:
        """Return ∂c / ∂log l."""
        return -s * s * self.slope(s)

    def value(self, offset: Float[np.ndarray, "*shape dim"]) -> Float[np.ndarray, "*shape"]:
        """Return c."""
        return np.asarray(self.correlation(_norm(offset)))

    def weighted_gradient(
        self, offset: Float[np.ndarray, "point run dim"], weight: Float[np.ndarray, " run"]
    ) -> Float[np.ndarray, "point dim"]:
        """Return Σ_run weight ∇c."""
        return np.asarray(np.einsum("bn,bnd->bd", self.slope(_norm(offset)) * weight, offset))

    def weighted_hessian(
        self, offset: Float[np.ndarray, "point run dim"], weight: Float[np.ndarray, " run"]
    ) -> Float[np.ndarray, "point dim dim"]:
        """Return Σ_run weight ∇∇c."""
        s = _norm(offset)
        direction = offset / np.where(s > 0, s, 1.0)[..., None]
        bend = self.slope_rate(s) * s * weight
        out = np.einsum("bn,bnd,bne->bde", bend, direction, direction, optimize=True)
        out += (self.slope(s) @ weight)[:, None, None] * np.eye(offset.shape[-1])
        return np.asarray(out)

    def of_columns(self, offset: Sequence[Array]) -> Array:
        """Return c of offsets given as one JAX array per input."""
        return self.correlation(jnp.sqrt(sum(column**2 for column in offset)))

    def pairs(self, x: Float[np.ndarray, "run dim"], *, unit: Float[np.ndarray, " length"]) -> "_Distances":
        """Return the distances of all pairs of x / unit."""
        return _Distances(self, distances(x) / unit)


@dataclass(frozen=True, eq=False)
class _Distances:
    """See `Pairs`."""

    kernel: Isotropic
    r: Float[np.ndarray, "run run"]

    def fill(
        self,
        out: Float[np.ndarray, "run run"],
        *,
        inverse_lengths: Float[np.ndarray, "1"],
        variance: float,
        diagonal: float,
    ) -> None:
        """Write variance · c + diagonal · I into the lower triangle of `out`."""
        inverse = float(inverse_lengths[0])

        def write(tile: Tile) -> None:
            rows, columns = tile
            s = inverse * self.r[rows, columns].T
            np.multiply(self.kernel.correlation(s), variance, out=out[rows, columns].T)

        over_tiles(len(out), write)
        np.einsum("ii->i", out)[:] += diagonal

    def by_log_lengths(
        self,
        alpha: Float[np.ndarray, " run"],
        precision: Float[np.ndarray, "run run"],
        *,
        inverse_lengths: Float[np.ndarray, "1"],
    ) -> Float[np.ndarray, "1"]:
        """Return Σ_i>j (α_i α_j - P_ij) ∂c_ij / ∂log l; the diagonal adds nothing."""
        inverse = float(inverse_lengths[0])

        def part(tile: Tile) -> Float[np.ndarray, "1"]:
            """Return what one tile adds to the slope."""
            rows, columns = tile
            slope = self.kernel.by_log_length(inverse * self.r[rows, columns].T)
            slope *= alpha[columns, None] * alpha[rows] - precision[rows, columns].T
            clear_above(slope, tile)
            return np.array([slope.sum()])

        return add_over_tiles(len(alpha), part)


def _norm(offset: Float[np.ndarray, "*shape dim"]) -> Float[np.ndarray, "*shape"]:
    return np.asarray(np.sqrt(np.einsum("...d,...d->...", offset, offset)))
