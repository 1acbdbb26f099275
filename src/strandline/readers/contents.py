"""The contents of a file, whatever its format: points, cells in blocks, and data on both."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from strandline.foundations import InvalidInput

CORRECT_IT = "Correct the name of the file in study.yaml, or the file."


class Unreadable(InvalidInput):
    """A file yields no interface.

    Args:
        what: What is wrong, with the name of the file.
        kind: ``result_missing`` | ``result_unreadable`` | ``non_finite`` | ``invalid_interface``.
        value: Value that was found.
        expected: What would have been correct.
        remedy: What to do next.
    """

    def __init__(
        self, what: str, value: object, expected: str, remedy: str = CORRECT_IT, *, kind: str = "result_unreadable"
    ) -> None:
        self.kind = kind
        super().__init__(what, value=value, expected=expected, remedy=remedy)

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(Unreadable, kind=self.kind), (self.what, self.value, self.expected, self.remedy)


refused = Unreadable


@contextmanager
def undamaged(name: str, expected: str) -> Iterator[None]:
    """Turn any error on a damaged file into one line, and ignore warnings."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InvalidInput:
        raise
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        remedy = "Look at the file, or at what writes it."
        if "UnicodeDecodeError" in reason:
            remedy = "Save it as UTF-8."
        if "imagecodecs" in reason:
            remedy = "Save it without this compression, or install what unpacks it: pip install imagecodecs"
        raise refused(f"{name} cannot be read", reason, expected, remedy) from None


@dataclass(frozen=True, eq=False)
class Block:
    """Cells of one kind, by meshio's names (``line``, ``triangle6``, …).

    Args:
        kind: Kind of the cells.
        nodes: Node numbers of each cell.
        data: Arrays by name, one row per cell.
    """

    kind: str
    nodes: Int[np.ndarray, "cell node"]
    data: Mapping[str, Shaped[np.ndarray, "..."]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Contents:
    """Points in the file's unit; without blocks they are a polyline in their order.

    Args:
        points: Points (point, xyz) as in the file.
        blocks: Blocks of cells.
        data: Arrays by name, one row per point.
        displacement: Displacement to add to the points, if the reader knows it.
        pieces: Number of the piece that each point belongs to, if the points are not one polyline.
        lines: Number of the line, from 1, of each point, if the file is a text table.
    """

    points: Float[np.ndarray, "point xyz"]
    blocks: tuple[Block, ...] = ()
    data: Mapping[str, Shaped[np.ndarray, "..."]] = field(default_factory=dict)
    displacement: Float[np.ndarray, "point xyz"] | None = None
    pieces: Int[np.ndarray, " point"] | None = None
    lines: Sequence[int] = ()
