"""What a Gaussian process requires of its correlation function c(x - x').

The covariance is σ0² c. Offsets are given in length scales: one length for all inputs, or one for each.
"""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.surrogate.kernels.decay import decay

__all__ = ["Kernel", "LengthScale", "Pairs", "as_length_scale", "as_lengths", "exp"]

Array = Any  # a NumPy or a JAX array of any shape
LengthScale = float | Float[np.ndarray, " dim"]
"""One length for all inputs, or one for each input, in standard deviations of the inputs."""


@runtime_checkable
class Pairs(Protocol):
    """All pairs of training inputs, prepared for many evaluations of the evidence.

    Only lower triangles of column-major matrices are read and written.
    """

    def fill(
        self,
        out: Float[np.ndarray, "run run"],
        *,
        inverse_lengths: Float[np.ndarray, " length"],
        variance: float,
        diagonal: float,
    ) -> None:
        """Write variance · c + diagonal · I into the lower triangle of `out`."""
        ...

    def by_log_lengths(
        self,
        alpha: Float[np.ndarray, " run"],
        precision: Float[np.ndarray, "run run"],
        *,
        inverse_lengths: Float[np.ndarray, " length"],
    ) -> Float[np.ndarray, " length"]:
        """Return Σ_i>j (α_i α_j - P_ij) ∂c_ij / ∂log l for each length."""
        ...


@runtime_checkable
class Kernel(Protocol):
    """A differentiable correlation function."""

    @property
    def name(self) -> str:
        """Its name, for messages and results."""
        ...

    @property
    def per_input(self) -> bool:
        """Whether each input has its own length."""
        ...

    def value(self, offset: Float[np.ndarray, "*shape dim"]) -> Float[np.ndarray, "*shape"]:
        """Return c."""
        ...

    def weighted_gradient(
        self, offset: Float[np.ndarray, "point run dim"], weight: Float[np.ndarray, " run"]
    ) -> Float[np.ndarray, "point dim"]:
        """Return Σ_run weight ∇c, the gradient with respect to the offset."""
        ...

    def weighted_hessian(
        self, offset: Float[np.ndarray, "point run dim"], weight: Float[np.ndarray, " run"]
    ) -> Float[np.ndarray, "point dim dim"]:
        """Return Σ_run weight ∇∇c, the Hessian with respect to the offset; exact at training points too."""
        ...

    def of_columns(self, offset: Sequence[Array]) -> Array:
        """Return c of offsets given as one JAX array per input, all of one shape."""
        ...

    def pairs(self, x: Float[np.ndarray, "run dim"], *, unit: Float[np.ndarray, " length"]) -> Pairs:
        """Return the pairs of x / unit."""
        ...


def as_lengths(kernel: Kernel, length_scale: LengthScale, dim: int) -> Float[np.ndarray, " length"]:
    """Return the lengths that `kernel` has in `dim` dimensions; one number stands for all of them.

    Raises:
        InvalidInput: a length that is not positive, or several lengths that are not one for each input.
    """
    given, count = np.atleast_1d(np.asarray(length_scale, float)), dim if kernel.per_input else 1
    if given.size not in (1, count) or not (given > 0).all():
        raise InvalidInput(
            f"length scale of {kernel.name}",
            value=given.tolist(),
            expected=f"one positive number{f', or {count}' if count > 1 else ''}",
            remedy="Give one number; kernels named _product or _ard take one for each input as well.",
        )
    return np.array(np.broadcast_to(given, count))


def as_length_scale(kernel: Kernel, lengths: Float[np.ndarray, " length"]) -> LengthScale:
    """Return lengths as a user sees them: a number, or one for each input."""
    return lengths if kernel.per_input else float(lengths[0])


def exp(x: Array) -> Array:
    """Return the exponential of a NumPy or a JAX array of numbers that are not positive."""
    return decay(x) if isinstance(x, jax.Array) else np.exp(x)
