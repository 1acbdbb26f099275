"""Covariance matrices of all pairs of runs: filled in tiles that stay in the cache, factorised and inverted in place.

Only lower triangles are touched; several threads process many tiles.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float
from scipy.linalg import lapack
from scipy.spatial.distance import cdist

from strandline.foundations import NumericsError, side_by_side

Tile = tuple[slice, slice]
"""Rows and columns; arrays of a tile have the rows last, as they lie in a column-major matrix."""
_WIDTH, _HEIGHT = 32, 256
_ENOUGH_FOR_THREADS = 500
T = TypeVar("T")
Lengths = Float[np.ndarray, " length"]
Matrix = Float[np.ndarray, "run run"]
Tiled = Float[np.ndarray, "column row"]


def distances(x: Float[np.ndarray, "run dim"]) -> Matrix:
    """Return the Euclidean distances of all pairs, in column-major order for LAPACK."""
    return np.asfortranarray(cdist(x, x))


def factorise(K: Matrix) -> None:
    """Overwrite the lower triangle of K (column-major) with its Cholesky factor and clear the upper one.

    Raises:
        NumericsError: K is not positive definite in floating point.
    """
    _, info = lapack.dpotrf(K, lower=1, clean=1, overwrite_a=1)
    if info != 0:
        raise NumericsError(
            f"the covariance of the {len(K)} training runs is not positive definite (minor {info}). "
            "Raise the nugget, bound the length scale lower, or clip extreme log-likelihoods."
        )


def invert(L: Matrix) -> None:
    """Overwrite the Cholesky factor L (column-major) with the lower triangle of (L Lᵀ)⁻¹."""
    lapack.dpotri(L, lower=1, overwrite_c=1)


def solve(L: Matrix, y: Float[np.ndarray, " run"]) -> Float[np.ndarray, " run"]:
    """Return (L Lᵀ)⁻¹ y."""
    solution, _ = lapack.dpotrs(L, y, lower=1)
    return np.asarray(solution)


@dataclass(frozen=True, eq=False)
class TiledPairs:
    """Pairs of training inputs whose column-major matrices are filled and summed tile by tile.

    `offsets` returns what the correlation c depends on for the pairs of a tile, given inverse lengths, `slopes` a
    factor a and terms b_d of the same, for ∂c/∂log l_d = a b_d; None: b is 1.
    """

    offsets: Callable[[Tile, Lengths], Float[np.ndarray, "..."]]
    correlation: Callable[[Any], Tiled]
    slopes: Callable[[Any], tuple[Tiled, Float[np.ndarray, "dim column row"] | None]]

    def fill(self, out: Matrix, *, inverse_lengths: Lengths, variance: float, diagonal: float) -> None:
        """Write variance · c + diagonal · I into the lower triangle of `out`."""

        def write(tile: Tile) -> None:
            np.multiply(self.correlation(self.offsets(tile, inverse_lengths)), variance, out=out[tile].T)

        over_tiles(len(out), write)
        np.einsum("ii->i", out)[:] += diagonal

    def by_log_lengths(
        self, alpha: Float[np.ndarray, " run"], precision: Matrix, *, inverse_lengths: Lengths
    ) -> Lengths:
        """Return Σ_i>j (α_i α_j - P_ij) ∂c_ij / ∂log l for each length, the same bits for any number of threads."""

        def part(tile: Tile) -> Lengths:
            rows, columns = tile
            factor, terms = self.slopes(self.offsets(tile, inverse_lengths))
            weight = alpha[columns, None] * alpha[rows]
            weight -= precision[tile].T
            weight *= factor
            if rows.start < columns.stop:  # nothing on and above the diagonal
                weight[np.arange(columns.start, columns.stop)[:, None] >= np.arange(rows.start, rows.stop)] = 0.0
            return np.array([weight.sum()]) if terms is None else terms.reshape(len(terms), -1) @ weight.ravel()

        return np.asarray(np.sum(over_tiles(len(alpha), part), axis=0))


def differences(
    columns: Float[np.ndarray, "dim run"], tile: Tile, scale: Float[np.ndarray, " dim"], size: np.ufunc
) -> Float[np.ndarray, "dim column row"]:
    """Return the size (`np.abs`, `np.square`) of the differences of all pairs of a tile, times `scale`, by input."""
    down, across = (columns[:, some] * scale[:, None] for some in tile)
    offset = across[:, :, None] - down[:, None]
    return np.asarray(size(offset, out=offset))


def over_tiles(number: int, task: Callable[[Tile], T]) -> list[T]:
    """Return the results of `task` for each tile of a triangle of `number` rows, in the order of the tiles."""

    def group(tiles: list[Tile]) -> list[T]:
        return [task(tile) for tile in tiles]

    groups = side_by_side(group, _groups(number)) if number >= _ENOUGH_FOR_THREADS else map(group, _groups(number))
    return [one for found in groups for one in found]


def _groups(number: int) -> Iterator[list[Tile]]:
    """Yield the tiles of the lower triangle, one list for each group of columns."""
    for start in range(0, number, _WIDTH):
        columns = slice(start, min(start + _WIDTH, number))
        yield [(slice(top, min(top + _HEIGHT, number)), columns) for top in range(start, number, _HEIGHT)]
