"""Proper orthogonal decomposition of displaced interfaces, weighted by length (area)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["Modes", "decompose"]

MOST = 20
"""Largest number of modes with their own process."""
STEP = 0.5
"""Derivatives enter the decomposition as a step of this many standard deviations of an input."""
_NOTHING = 1e-14


@dataclass(frozen=True, eq=False)
class Modes:
    """An orthonormal basis of the fields seen; the squared norm of a field is its mean square along the interface.

    Args:
        mean: Mean field (value,), mm.
        roots: Square roots of the weights of the values, whose squares sum to the number of conditions.
        basis: Orthonormal weighted fields of the modes (mode, value).
        tail: Weighted fields of the modes cut off, times their standard deviations over the runs (rest, value), mm.
    """

    mean: Float[np.ndarray, " value"]
    roots: Float[np.ndarray, " value"]
    basis: Float[np.ndarray, "mode value"]
    tail: Float[np.ndarray, "rest value"]

    @property
    def remainder(self) -> float:
        """Root mean square of the modes cut off, along the interface, mm."""
        return float(np.sqrt(np.sum(self.tail**2)))

    def coefficients(self, fields: Float[np.ndarray, "run value"]) -> Float[np.ndarray, "run mode"]:
        """Return the coefficients of fields, mm."""
        return np.asarray(((fields - self.mean) * self.roots) @ self.basis.T)

    def by_input(self, derivatives: Float[np.ndarray, "run value dim"]) -> Float[np.ndarray, "run mode dim"]:
        """Return derivatives of the coefficients, given those of the fields."""
        return np.asarray(np.einsum("rvd,mv->rmd", derivatives * self.roots[:, None], self.basis, optimize=True))

    def fields(self, coefficients: Float[np.ndarray, "run mode"]) -> Float[np.ndarray, "run value"]:
        """Return the fields with these coefficients."""
        return np.asarray(self.mean + (coefficients @ self.basis) / self.roots)


def decompose(
    fields: Float[np.ndarray, "run value"],
    weights: Float[np.ndarray, " value"],
    derivatives: Float[np.ndarray, "run value dim"] | None,
    *,
    tolerance: float,
    most: int = MOST,
) -> Modes:
    """Return the fewest modes that leave a root mean square of the fields below `tolerance`, mm.

    Args:
        fields: Fields (run, value), mm.
        weights: Share of the interface that each value stands for.
        derivatives: Derivatives of the fields with respect to the standardised inputs (run, value, dim), whose
            directions the modes span too; None: there are none.
        tolerance: Largest root mean square of the remainder, mm.
        most: Largest number of modes.
    """
    mean, roots = fields.mean(axis=0), np.sqrt(weights)
    centred = (fields - mean) * roots
    rows = [centred]
    if derivatives is not None:
        steps = np.moveaxis(STEP * derivatives * roots[:, None], 2, 1)
        rows.append(steps.reshape(-1, fields.shape[1]))
    _, sizes, basis = np.linalg.svd(np.concatenate(rows), full_matrices=False)
    basis = basis[sizes > _NOTHING * max(float(sizes[0]), _NOTHING)]
    shares = np.mean((centred @ basis.T) ** 2, axis=0)
    left = shares.sum() - np.cumsum(shares)
    enough = np.flatnonzero(left <= tolerance**2)
    number = min(int(enough[0]) + 1 if enough.size else len(basis), most)
    tail = basis[number:] * np.sqrt(shares[number:])[:, None]
    return Modes(mean, roots, basis[:number], tail)
