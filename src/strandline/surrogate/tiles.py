"""The lower triangle of a matrix of all pairs in tiles that stay in the cache; several threads process many of them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from strandline.foundations import side_by_side

Tile = tuple[slice, slice]
"""Rows and columns; arrays of a tile have the rows last, as they lie in a column-major matrix."""

_WIDTH, _HEIGHT = 32, 256
_ENOUGH_FOR_THREADS = 500

T = TypeVar("T")
Lengths = Float[np.ndarray, " length"]
Matrix = Float[np.ndarray, "run run"]
Tiled = Float[np.ndarray, "column row"]


@dataclass(frozen=True, eq=False)
class TiledPairs:
    """Pairs of training inputs whose matrices are filled and summed tile by tile, see `kernels.Pairs`.

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
