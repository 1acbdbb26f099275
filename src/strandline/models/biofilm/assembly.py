"""Parts that add up to the residual and the Jacobian of a system, and the sparse matrix of its free unknowns."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from ngsolve import la
from scipy.sparse import csr_array

__all__ = ["Part", "Pattern", "SymbolicPart", "product"]

Values = Float[np.ndarray, " dof"]
Entries = Float[np.ndarray, " entry"]
Numbers = Int[np.ndarray, " entry"]


@runtime_checkable
class Part(Protocol):
    """What some elements add, as a function of an NGSolve function with the coefficients of all unknowns."""

    def places(self) -> tuple[Numbers, Numbers]:
        """Return row and column of each entry that `jacobian` has returned; those of one place add up."""
        ...

    def residual(self, state: Any) -> Values: ...

    def jacobian(self, state: Any) -> Entries: ...


class SymbolicPart:
    """A form that NGSolve differentiates.

    Args:
        form: NGSolve form.
    """

    def __init__(self, form: Any) -> None:
        self.form = form

    def places(self) -> tuple[Numbers, Numbers]:
        """Return row and column of each entry that `jacobian` has returned."""
        return _places(self.form.mat)

    def residual(self, state: Any) -> Values:
        """Return what the form adds to the residual of each row."""
        result = state.vec.CreateVector()
        self.form.Apply(state.vec, result)
        return np.array(result.FV().NumPy())

    def jacobian(self, state: Any) -> Entries:
        """Return the entries of the form's derivative."""
        self.form.AssembleLinearization(state.vec)
        return np.array(self.form.mat.AsVector().FV().NumPy())


def product(places: tuple[Numbers, Numbers], entries: Entries, vector: Values) -> Values:
    """Return the product of the square matrix with these entries and a vector."""
    rows, columns = places
    return np.bincount(rows, weights=entries * vector[columns], minlength=len(vector))


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where the entries of the parts go in the sparse matrix of the free unknowns.

    Args:
        matrix: NGSolve matrix.
        constants: Its values from constant rows.
        slots: Place of each entry of the parts among the values; one behind the last for those left out.
    """

    matrix: Any
    constants: Float[np.ndarray, " nonzero"]
    slots: Int[np.ndarray, " entry"]

    def fill(self, entries: Entries) -> Any:
        """Write the sums of the entries and the constant rows into the matrix; return it."""
        sums = np.bincount(self.slots, weights=entries, minlength=len(self.constants) + 1)
        self.matrix.AsVector().FV().NumPy()[:] = sums[:-1] + self.constants
        return self.matrix

    @classmethod
    def find(
        cls,
        places: tuple[Numbers, Numbers],
        used: Bool[np.ndarray, " entry"],
        constant: csr_array,
        is_constant: Bool[np.ndarray, " dof"],
        free: Int[np.ndarray, " unknown"],
    ) -> "Pattern":
        """Return the pattern of the places where some entry is not zero.

        Args:
            places: Row and column of each entry of the parts.
            used: Which entries are not zero; if only a load is zero now, other entries hold its place.
            constant: The constant rows (constant, dof).
            is_constant: Which rows come from it, not from the parts.
            free: Numbers of the free unknowns.
        """
        number, count = np.full(len(is_constant), -1), len(free)
        number[free] = np.arange(count)

        def codes(at: tuple[Numbers, Numbers], kept: Bool[np.ndarray, " entry"]) -> Numbers:
            """Return a number for each place in the reduced matrix; -1 for entries that are left out."""
            rows, columns = (number[part] for part in at)
            return np.where(kept & (rows >= 0) & (columns >= 0), rows * count + columns, -1)

        fixed = constant.tocoo()
        of_parts = codes(places, ~is_constant[places[0]])
        of_constants = codes((np.flatnonzero(is_constant)[fixed.row], fixed.col), fixed.data != 0.0)
        distinct = np.unique(np.concatenate([of_parts[used], of_constants]))
        distinct = distinct[distinct >= 0]
        ones = np.ones(len(distinct))
        matrix = la.SparseMatrixd.CreateFromCOO(
            (distinct // count).tolist(), (distinct % count).tolist(), ones.tolist(), count, count
        )
        found = np.minimum(np.searchsorted(distinct, of_parts), len(distinct) - 1)
        slots = np.where(distinct[found] == of_parts, found, len(distinct))
        kept, constants = of_constants >= 0, np.zeros(len(distinct))
        constants[np.searchsorted(distinct, of_constants[kept])] = fixed.data[kept]
        return cls(matrix, constants, slots)


def _places(matrix: Any) -> tuple[Numbers, Numbers]:
    """Return row and column of each entry of an NGSolve matrix."""
    _, columns, pointers = matrix.CSR()
    counts: Int[np.ndarray, " row"] = np.diff(np.array(pointers, dtype=np.int64))
    return np.repeat(np.arange(len(counts)), counts), np.array(columns, dtype=np.int64)
