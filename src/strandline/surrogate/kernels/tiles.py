"""The lower triangle of a matrix in tiles that stay in the cache, processed by several threads if that is worth it.

NumPy releases the interpreter lock during an operation on a tile, so threads overlap. Their number is
``OMP_NUM_THREADS``, the limit that BLAS follows as well; by default, the number of cores of the process.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from jaxtyping import Float

__all__ = ["Tile", "add_over_tiles", "clear_above", "lower_tiles", "offsets_of_tile", "over_tiles", "threads"]

Tile = tuple[slice, slice]
"""Rows and columns; arrays of a tile have the rows last, as they lie in a column-major matrix."""

_WIDTH, _HEIGHT = 32, 256
_ENOUGH_FOR_THREADS = 500

T = TypeVar("T")


def lower_tiles(number: int) -> Iterator[list[Tile]]:
    """Yield the tiles of the lower triangle, one list for each group of columns."""
    for start in range(0, number, _WIDTH):
        columns = slice(start, min(start + _WIDTH, number))
        yield [(slice(top, min(top + _HEIGHT, number)), columns) for top in range(start, number, _HEIGHT)]


def over_tiles(number: int, task: Callable[[Tile], T]) -> list[T]:
    """Return the results of `task` for each tile of a triangle of `number` rows, in the order of the tiles."""

    def group(tiles: list[Tile]) -> list[T]:
        return [task(tile) for tile in tiles]

    workers = threads() if number >= _ENOUGH_FOR_THREADS else 1
    if workers == 1:
        return [one for tiles in lower_tiles(number) for one in group(tiles)]
    with ThreadPoolExecutor(workers) as pool:
        return [one for found in pool.map(group, lower_tiles(number)) for one in found]


def add_over_tiles(number: int, task: Callable[[Tile], Float[np.ndarray, " term"]]) -> Float[np.ndarray, " term"]:
    """Return the sum of `task` over all tiles, the same to the last bit whatever the number of threads."""
    return np.asarray(np.sum(over_tiles(number, task), axis=0))


def offsets_of_tile(columns: Float[np.ndarray, "dim run"], tile: Tile) -> Float[np.ndarray, "dim column row"]:
    """Return the differences of all pairs of a tile, input by input."""
    down, across = tile
    return np.asarray(columns[:, across, None] - columns[:, None, down])


def clear_above(values: Float[np.ndarray, "column row"], tile: Tile) -> None:
    """Set the values on and above the diagonal to zero."""
    rows, columns = tile
    if rows.start < columns.stop:
        values[np.arange(columns.start, columns.stop)[:, None] >= np.arange(rows.start, rows.stop)] = 0.0


def threads() -> int:
    """Return the number of threads to use."""
    limit = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    if limit.isdigit() and int(limit) > 0:
        return int(limit)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
