"""Correlation functions c(x - x') of the Gaussian processes.

The covariance is σ0² c. Offsets are given in length scales: one length for all inputs, or one for each.

Everything that a Gaussian process needs of a function of the scaled distance s follows from three functions:

- c(s), the correlation;
- g(s) = c'(s) / s, finite at s = 0: ∇c = g(s) u for the scaled offset u, and ∂c/∂log l = -s² g(s), or -u_d² g(s) for
  a length of one input;
- g'(s): ∇∇c = g(s) I + g'(s) / s · u uᵀ.

In a product over the inputs of functions p(t) exp(-t), t = κ |u|, each input has its own length, and the whole has one
variance: if each factor had its own, data could determine only their product. The Matérn functions of half-integer
order have this form, and their product needs a single exponential: c = Π_d p(t_d) · exp(-Σ_d t_d). Relative to c:

- ∂c/∂u_d = -κ² u_d q(t_d) c with the decline q(t) = (p - p') / (t p), and ∂c/∂log l_d = t_d² q(t_d) c;
- ∂²c/∂u_d² = κ² (p - 2p' + p'') / p · c, the curvature.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from strandline.foundations import WHOLE, assembled, lookup, require
from strandline.surrogate.covariance import Lengths, TiledPairs, differences, distances

Offsets = Float[np.ndarray, "point run dim"]
Values = Float[np.ndarray, " run"]

Array = Any  # a NumPy or a JAX array of any shape
LengthScale = float | Float[np.ndarray, " dim"]
"""One length for all inputs, or one for each input, in standard deviations of the inputs."""
_LOG2_E = math.log2(math.e)
_LOWEST = -900.0


@runtime_checkable
class Kernel(Protocol):
    """A differentiable correlation function."""

    @property
    def name(self) -> str:
        """Its name, for messages and results."""

    @property
    def per_input(self) -> bool:
        """Whether each input has its own length."""

    def value(self, offset: Float[np.ndarray, "*shape dim"]) -> Float[np.ndarray, "*shape"]:
        """Return c."""

    def weighted_hessian(self, offset: Offsets, weight: Values) -> Float[np.ndarray, "point dim dim"]:
        """Return Σ_run weight ∇∇c, the Hessian with respect to the offset; exact at training points too."""

    def of_columns(self, offset: Sequence[Array]) -> Array:
        """Return c of offsets given as one JAX array per input, all of one shape."""

    def pairs(self, x: Float[np.ndarray, "run dim"], *, unit: Lengths) -> TiledPairs:
        """Return all pairs of x / unit, prepared for many evaluations of the evidence."""


def as_lengths(kernel: Kernel, length_scale: LengthScale, dim: int) -> Lengths:
    """Return the lengths that `kernel` has in `dim` dimensions; one number stands for all of them.

    Raises:
        InvalidInput: a length that is not positive, or several lengths that are not one for each input.
    """
    given, count = np.atleast_1d(np.asarray(length_scale, float)), dim if kernel.per_input else 1
    right = given.size in (1, count) and (given > 0).all()
    expected = f"one positive number{f', or {count}' if count > 1 else ''}"
    remedy = "Give one number; kernels named _product or _ard take one for each input as well."
    require(right, f"length scale of {kernel.name}", given.tolist(), expected, remedy)
    return np.array(np.broadcast_to(given, count))


def as_length_scale(kernel: Kernel, lengths: Lengths) -> LengthScale:
    """Return lengths as a user sees them: a number, or one for each input."""
    return lengths if kernel.per_input else float(lengths[0])


@jax.custom_jvp
def decay(x: jax.Array) -> jax.Array:
    """Return exp(x) for x ≤ 0, with relative error 2e-14 + 2e-16 |x|; JAX's own in single precision.

    There are no special cases, except that results below 1e-270 are cut there. In the sampler's sum over a kernel of
    the distance it saves a fifth of the time; in a product, whose loop has more in its registers, JAX's own is faster.
    """
    if x.dtype != np.float64:
        return jnp.exp(x)
    exponent = jnp.maximum(x * _LOG2_E, _LOWEST)
    nearest = jax.lax.round(exponent, jax.lax.RoundingMethod.TO_NEAREST_EVEN)
    power: jax.Array = assembled(exponent - nearest, nearest + WHOLE)
    return power


@decay.defjvp
def _decay_slope(at: tuple[jax.Array], by: tuple[jax.Array]) -> tuple[jax.Array, jax.Array]:
    (x,), (change,) = at, by
    value = decay(x)
    return value, value * change


def exp(x: Array) -> Array:
    """Return the exponential of a NumPy or a JAX array of numbers that are not positive."""
    return decay(x) if isinstance(x, jax.Array) else np.exp(x)


class _Named:
    """A kernel of `KERNELS` is pickled by its name, because its functions have none."""

    name: str

    def __reduce_ex__(self, protocol: Any) -> Any:
        known: object = KERNELS.get(self.name)
        if known is self:
            return kernel_named, (self.name,)
        return super().__reduce_ex__(protocol)


@dataclass(frozen=True)
class Isotropic(_Named):
    """A twice differentiable correlation of the distance; functions of s on NumPy and JAX arrays of any shape.

    These are c(s), the slope g(s) = c'(s) / s and its rate g'(s); `name` is the key in `KERNELS`. If each input has its
    own length (ARD), the correlation depends on the distance all the same.
    """

    name: str
    correlation: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    slope_rate: Callable[[Array], Array]
    per_input: bool = field(default=False, kw_only=True)

    def value(self, offset: Float[np.ndarray, "*shape dim"]) -> Float[np.ndarray, "*shape"]:
        return np.asarray(self.correlation(_norm(offset)))

    def weighted_hessian(self, offset: Offsets, weight: Values) -> Float[np.ndarray, "point dim dim"]:
        s = _norm(offset)
        direction = offset / np.where(s > 0, s, 1.0)[..., None]
        bend = self.slope_rate(s) * s * weight
        out = np.einsum("bn,bnd,bne->bde", bend, direction, direction, optimize=True)
        out += (self.slope(s) @ weight)[:, None, None] * np.eye(offset.shape[-1])
        return np.asarray(out)

    def of_columns(self, offset: Sequence[Array]) -> Array:
        return self.correlation(jnp.sqrt(sum(column**2 for column in offset)))

    def pairs(self, x: Float[np.ndarray, "run dim"], *, unit: Lengths) -> TiledPairs:
        """Return the distances of all pairs of x / unit; with several lengths its columns, as distances change."""
        if not self.per_input:
            apart = distances(x) / unit
            return TiledPairs(
                lambda tile, inverse: inverse[0] * apart[tile].T,
                self.correlation,
                lambda s: (-s * s * self.slope(s), None),
            )
        columns = np.ascontiguousarray((x / unit).T)
        return TiledPairs(
            lambda tile, inverse: differences(columns, tile, inverse, np.square),
            lambda squares: self.correlation(np.sqrt(squares.sum(axis=0))),
            lambda squares: (-self.slope(np.sqrt(squares.sum(axis=0))), squares),
        )


def _norm(offset: Float[np.ndarray, "*shape dim"]) -> Float[np.ndarray, "*shape"]:
    return np.asarray(np.sqrt(np.einsum("...d,...d->...", offset, offset)))


@dataclass(frozen=True)
class Product(_Named):
    """A product of one-dimensional correlations; functions of t ≥ 0 on NumPy and JAX arrays of any shape.

    These are the polynomial p(t) with p(0) = 1, the decline (p - p') / (t p) and the curvature (p - 2p' + p'') / p.
    `name` is the key in `KERNELS`, `rate` is κ.
    """

    name: str
    rate: float
    polynomial: Callable[[Array], Array]
    decline: Callable[[Array], Array]
    curvature: Callable[[Array], Array]
    per_input: bool = field(default=True, init=False)

    def value(self, offset: Float[np.ndarray, "*shape dim"]) -> Float[np.ndarray, "*shape"]:
        return self._correlation(self.rate * np.abs(offset), axis=-1)

    def weighted_hessian(self, offset: Offsets, weight: Values) -> Float[np.ndarray, "point dim dim"]:
        c, slope = self.value(offset) * weight, -(self.rate**2) * self.decline(self.rate * np.abs(offset)) * offset
        bend = self.rate**2 * self.curvature(self.rate * np.abs(offset))
        out = np.einsum("bn,bnd,bne->bde", c, slope, slope, optimize=True)
        np.einsum("bdd->bd", out)[:] = np.einsum("bn,bnd->bd", c, bend)
        return np.asarray(out)

    def of_columns(self, offset: Sequence[Array]) -> Array:
        distance = [jnp.abs(column) for column in offset]
        return math.prod(self.polynomial(self.rate * u) for u in distance) * jnp.exp(-self.rate * sum(distance))

    def pairs(self, x: Float[np.ndarray, "run dim"], *, unit: Lengths) -> TiledPairs:
        """Return the columns of x / unit: a matrix of distances for each input would not fit in memory."""
        columns = np.ascontiguousarray((x / unit).T)
        return TiledPairs(
            lambda tile, inverse: differences(columns, tile, self.rate * inverse, np.abs),
            self._correlation,
            self._slopes,
        )

    def _correlation(self, t: Float[np.ndarray, "..."], axis: int = 0) -> Float[np.ndarray, "..."]:
        decay = np.asarray(-t.sum(axis=axis))
        return np.asarray(np.prod(self.polynomial(t), axis=axis) * np.exp(decay, out=decay))

    def _slopes(self, t: Float[np.ndarray, "dim column row"]) -> tuple[Float[np.ndarray, "column row"], Any]:
        """Return c and t² q(t): their product is ∂c/∂log l, input by input."""
        growth = self.decline(t)
        growth *= t  # in place: a tile stays in the cache
        growth *= t
        return self._correlation(t), growth


_ROOT3, _ROOT5 = math.sqrt(3.0), math.sqrt(5.0)
_THIRD = 1.0 / 3.0  # NumPy divides several times slower than it multiplies


def _at(rate: float, function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Return a function of t = rate · s as one of s."""
    return lambda s: function(rate * s)


MATERN32 = Isotropic(
    "matern32",
    correlation=_at(_ROOT3, lambda t: (1.0 + t) * exp(-t)),
    slope=_at(_ROOT3, lambda t: -3.0 * exp(-t)),
    slope_rate=_at(_ROOT3, lambda t: 3.0 * _ROOT3 * exp(-t)),
)
MATERN52 = Isotropic(
    "matern52",
    correlation=_at(_ROOT5, lambda t: (1.0 + t * (1.0 + t / 3.0)) * exp(-t)),
    slope=_at(_ROOT5, lambda t: -5.0 / 3.0 * (1.0 + t) * exp(-t)),
    slope_rate=_at(_ROOT5, lambda t: 5.0 / 3.0 * _ROOT5 * t * exp(-t)),
)
SQUARED_EXPONENTIAL = Isotropic(
    "squared_exponential",
    correlation=lambda s: exp(-0.5 * s * s),
    slope=lambda s: -exp(-0.5 * s * s),
    slope_rate=lambda s: s * exp(-0.5 * s * s),
)
"""Its samples are analytic, and its covariance is far worse conditioned than a Matérn one with the same length: the
eigenvalues fall faster than any power. If the factorisation fails in floating point, `NumericsError` is raised, and
the optimiser of the evidence treats such lengths as a wall."""
MATERN32_PRODUCT = Product(
    "matern32_product",
    _ROOT3,
    polynomial=lambda t: 1.0 + t,
    decline=lambda t: 1.0 / (1.0 + t),
    curvature=lambda t: (t - 1.0) / (1.0 + t),
)
MATERN52_PRODUCT = Product(
    "matern52_product",
    _ROOT5,
    polynomial=lambda t: 1.0 + t * (1.0 + _THIRD * t),
    decline=lambda t: (1.0 + t) / (3.0 + t * (3.0 + t)),
    curvature=lambda t: (t * (t - 1.0) - 1.0) / (3.0 + t * (3.0 + t)),
)

KERNELS: dict[str, Kernel] = {
    "matern32": MATERN32,
    "matern32_ard": replace(MATERN32, name="matern32_ard", per_input=True),
    "matern32_product": MATERN32_PRODUCT,
    "matern52": MATERN52,
    "matern52_ard": replace(MATERN52, name="matern52_ard", per_input=True),
    "matern52_product": MATERN52_PRODUCT,
    "squared_exponential": SQUARED_EXPONENTIAL,
    "squared_exponential_ard": replace(SQUARED_EXPONENTIAL, name="squared_exponential_ard", per_input=True),
}
"""Names in study files → kernels; the ones with a length for each input are named _ard or _product."""


def kernel_named(name: str) -> Kernel:
    """Return the kernel of that name in `KERNELS`, or the object ``module:name``.

    Raises:
        InvalidInput: There is no such kernel, or the object is not a kernel.
    """
    found: Any = lookup(KERNELS, name, "name of the kernel")
    expected = "an object with the methods of strandline.surrogate.kernels.Kernel"
    remedy = "Check it with strandline.testing.kernels."
    require(isinstance(found, Kernel), "name of the kernel", name, expected, remedy)
    return found  # type: ignore[no-any-return]
