"""The sparse direct solver for Newton's method: UMFPACK, which NGSolve includes, or MKL PARDISO from the package mkl.

NGSolve finds PARDISO by itself if mkl is installed, and runs it on one thread. PARDISO needs care. Its analysis
(matching, scaling, ordering) costs several times its factorisation, so it is kept. It is made with the first values
that a matrix is factorised with; a `FlowCell` chooses these itself, so that no run depends on earlier runs. If the
analysis does not suit later values, above all at ν = 0.5, or if a matrix is singular, PARDISO perturbs pivots and
returns wrong results without a warning. So its residual is checked, and a bad solution computed again with its own
analysis.
"""

import contextlib
import ctypes
import os
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float
from ngsolve import la

from strandline.foundations import ForwardModelError, unfit

STANDARD_OUTPUT = 1
SOLVERS = ("umfpack", "pardiso")
VARIABLE = "STRANDLINE_LINEAR_SOLVER"
RESIDUAL_TOLERANCE = 1e-6
"""Largest ‖Jx - b‖ / ‖b‖ of PARDISO; close to a fold, UMFPACK leaves up to 1e-8."""
AT_ONCE = 32
"""Right-hand sides that PARDISO takes at once: each costs a third of one alone; more are no faster."""
Vector = Float[np.ndarray, " unknown"]
Vectors = Float[np.ndarray, "right unknown"]


@contextlib.contextmanager
def without_prints() -> Iterator[None]:
    """Discard what this process writes to standard output, even outside Python.

    The C library buffers its prints, so they are flushed before and after. If standard output is closed, or the
    system is not POSIX, this does nothing.
    """
    library = ctypes.CDLL(None) if os.name == "posix" else None
    try:
        kept = None if library is None else os.dup(STANDARD_OUTPUT)
    except OSError:
        kept = None
    if library is None or kept is None:
        yield
        return
    library.fflush(None)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, STANDARD_OUTPUT)
    os.close(nowhere)
    try:
        yield
    finally:
        library.fflush(None)
        os.dup2(kept, STANDARD_OUTPUT)
        os.close(kept)


@cache
def linear_solver() -> str:
    """Return one of `SOLVERS`: the environment's choice, else PARDISO if it works; decided once per process."""
    chosen, what = os.environ.get(VARIABLE), f"environment variable {VARIABLE}"
    if chosen is None:
        return "pardiso" if _pardiso_works() else "umfpack"
    if chosen not in SOLVERS:
        remedy = "Correct it, or unset it to use the fastest solver installed."
        raise unfit(what, chosen or "an empty text", f"one of {', '.join(SOLVERS)}", remedy)
    if chosen == "pardiso" and not _pardiso_works():
        remedy = 'Install it by `pip install "strandline[mkl]"`, or unset the variable.'
        raise unfit(what, chosen, "umfpack, because NGSolve finds no PARDISO", remedy)
    return chosen


class Factorisation:
    """A sparse LU of the reduced Jacobian with `size` rows; it stays valid when the NGSolve matrix changes.

    With `own_analysis`, PARDISO analyses these values for themselves. This takes several times as long, and then
    solving with this and other matrices by turns needs no new factorisations.
    """

    def __init__(self, matrix: Any, size: int, *, own_analysis: bool = False) -> None:
        try:
            self._lu: _Pardiso | _Umfpack
            self._lu = _Pardiso(matrix, size, own_analysis) if linear_solver() == "pardiso" else _Umfpack(matrix, size)
        except Exception as error:
            raise ForwardModelError("linear_solve", f"the Jacobian could not be factorised: {error}") from error

    def solve(self, right: Vector) -> Vector:
        """Return J⁻¹ right; fails as ``linear_solve`` if that is not finite, or does not solve the equations."""
        return _finite(self._lu.solve(right))

    def solve_transposed(self, rights: Vectors) -> Vectors:
        """Return J⁻ᵀ of each right-hand side, several at a time with PARDISO; fails as `solve`."""
        return _finite(self._lu.solve_transposed(rights))


class _Umfpack:
    def __init__(self, matrix: Any, size: int) -> None:
        with without_prints():  # it prints a line for a singular matrix before it raises
            self._inverse = matrix.Inverse(inverse="umfpack")
        self._right, self._left = la.CreateVVector(size), la.CreateVVector(size)

    def solve(self, right: Vector) -> Vector:
        return _product(self._inverse, right, self._right, self._left)

    def solve_transposed(self, rights: Vectors) -> Vectors:
        return np.stack([_product(self._inverse.T, right, self._right, self._left) for right in rights])


class _Pardiso:
    """One set of values, and its own analysis, or one shared with other sets until it no longer suits this one."""

    def __init__(self, matrix: Any, size: int, own_analysis: bool) -> None:
        self._values = np.array(matrix.AsVector().FV().NumPy())
        if not np.isfinite(self._values).all():
            raise ValueError("an entry is not finite")
        if own_analysis:
            self._analysis, self._shared = _Analysis(matrix, size, loaded=self._values), False
            return
        if matrix not in _analyses:
            _analyses[matrix] = _Analysis(matrix, size)
        self._analysis, self._shared = _analyses[matrix], True
        self._analysis.factorise(self._values)

    def solve(self, right: Vector) -> Vector:
        return self._checked(_Analysis.solve, right)

    def solve_transposed(self, rights: Vectors) -> Vectors:
        return self._checked(_Analysis.solve_transposed, rights)

    def _checked(
        self, solve: Callable[["_Analysis", np.ndarray], tuple[np.ndarray, float]], right: np.ndarray
    ) -> np.ndarray:
        """Return the solution; a shared analysis that does not suit these values is replaced by a new one."""
        self._analysis.factorise(self._values)
        x, residual = solve(self._analysis, right)
        if self._shared and not residual <= RESIDUAL_TOLERANCE * np.linalg.norm(right):
            self._analysis, self._shared = self._analysis.renewed(), False
            x, residual = solve(self._analysis, right)
        if not residual <= RESIDUAL_TOLERANCE * np.linalg.norm(right):
            message = "the Jacobian is singular, or nearly so: PARDISO does not solve the equations"
            raise ForwardModelError("linear_solve", message, {"linear_residual": float(residual)})
        return x


class _Analysis:
    """PARDISO's analysis of a copy of `matrix`, and the factorisation of the values loaded last."""

    def __init__(self, matrix: Any, size: int, *, loaded: object = None, refinement: int = 0) -> None:
        self._matrix, self._size = matrix.CreateMatrix(), size
        self._entries = self._matrix.AsVector().FV().NumPy()
        self._entries[:] = matrix.AsVector().FV().NumPy()
        self._loaded = loaded
        self._inverse = self._matrix.Inverse(inverse="pardiso", flags={"refinement": refinement})
        self._right, self._left = la.CreateVVector(size), la.CreateVVector(size)

    def factorise(self, values: Float[np.ndarray, " nonzero"]) -> None:
        """Factorise the matrix with `values`, unless that array was loaded last."""
        if self._loaded is values:
            return
        self._loaded = None
        self._entries[:] = values
        self._inverse.Update()
        self._loaded = values

    def solve(self, right: Vector) -> tuple[Vector, float]:
        """Return the solution, and the length of its residual."""
        x = _product(self._inverse, right, self._right, self._left)
        back = _product(self._matrix, x, self._right, self._left)
        return x, float(np.linalg.norm(back - right))

    def solve_transposed(self, rights: Vectors) -> tuple[Vectors, float]:
        """Return the solutions, and the length of the residual of their sum."""
        parts = np.split(rights, range(AT_ONCE, len(rights), AT_ONCE))
        x = np.concatenate([self._several_transposed(part) for part in parts])
        back = _product(self._matrix.T, x.sum(axis=0), self._right, self._left)
        return x, float(np.linalg.norm(back - rights.sum(axis=0)))

    def _several_transposed(self, rights: Vectors) -> Vectors:
        """Return the solutions, at once if NGSolve calls PARDISO from Python, where it takes one right-hand side."""
        inverse = self._inverse
        if len(rights) == 1 or not hasattr(inverse, "_call_pardiso"):
            return np.stack([_product(inverse.T, right, self._right, self._left) for right in rights])
        x, kept = np.empty(rights.shape), (inverse._b, inverse._x)
        inverse._b, inverse._x = (np.ctypeslib.as_ctypes(array.ravel()) for array in (rights, x))
        inverse._nrhs[0], inverse._params[11] = len(rights), 2  # 2: the transpose
        try:
            inverse._call_pardiso(33)
        finally:
            inverse._b, inverse._x = kept
            inverse._nrhs[0], inverse._params[11] = 1, 0
        return x

    def renewed(self) -> "_Analysis":
        """Return a new analysis for the values loaded, with as much iterative refinement as is useful."""
        return _Analysis(self._matrix, self._size, loaded=self._loaded, refinement=16)


_analyses: WeakKeyDictionary[Any, _Analysis] = WeakKeyDictionary()
"""Analyses by matrix; an analysis refers to a copy only, so it is freed together with its matrix."""


def _finite(result: np.ndarray) -> np.ndarray:
    if not np.isfinite(result).all():
        raise ForwardModelError("linear_solve", "the linear solve gave values that are not finite")
    return result


def _product(operator: Any, vector: Vector, given: Any, result: Any) -> Vector:
    """Return operator · vector, through two NGSolve vectors."""
    given.FV().NumPy()[:] = vector
    operator.Mult(given, result)
    return np.array(result.FV().NumPy())


def _pardiso_works() -> bool:
    """Return whether PARDISO solves 2 × 2 equations, with new values too; NGSolve's errors depend on its version."""
    matrix = la.SparseMatrixd.CreateFromCOO([0, 0, 1, 1], [0, 1, 0, 1], [1.0, 2.0, 3.0, 4.0], 2, 2)
    try:
        analysis = _Analysis(matrix, 2)
        analysis.factorise(np.array([0.0, 2.0, 3.0, 4.0]))
        x, _ = analysis.solve(np.array([2.0, 7.0]))
    except Exception:
        return False
    return bool(np.allclose(x, 1.0))
