"""A conditioned Gaussian process: prediction and exact second derivatives in physical coordinates."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from strandline.foundations import require
from strandline.surrogate.covariance import factorise, solve
from strandline.surrogate.kernels import Kernel, LengthScale, as_length_scale, as_lengths

_PAIRS_PER_BLOCK = 2**20
_UNROLL = 8
Inputs = Float[np.ndarray, "run dim"]
Targets = Float[np.ndarray, " run"]
Particles = Float[jax.Array, "particle dim"]
PerParticle = Float[jax.Array, " particle"]


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A zero-mean Gaussian process on centred targets and inputs standardised column by column.

    Inputs of all methods are physical; so are the coordinates of the derivatives. With mean `shift` and standard
    deviation `scale` of each input, `x_train` is (x - shift) / scale; `alpha` is (K + σ_n² I)⁻¹ (y - target_mean),
    `cholesky` the lower factor of K + σ_n² I. The length scale l is in standard deviations of the inputs, one for each
    input if the kernel has several; the signal variance σ0² and the nugget σ_n² are in squared units of the target.
    """

    x_train: Inputs
    shift: Float[np.ndarray, " dim"]
    scale: Float[np.ndarray, " dim"]
    target_mean: float
    alpha: Targets
    cholesky: Float[np.ndarray, "run run"]
    kernel: Kernel
    length_scale: LengthScale
    signal_variance: float
    nugget: float

    @property
    def dim(self) -> int:
        """Number of inputs."""
        return int(self.x_train.shape[1])

    def mean(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the posterior mean, in units of the target."""
        out = np.empty(len(x))
        for rows, offset in self._blocks(x):
            out[rows] = self.kernel.value(offset) @ self.alpha
        return self.target_mean + self.signal_variance * out

    def variance(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the posterior variance of the function itself (without the nugget), never negative."""
        out = np.empty(len(x))
        for rows, offset in self._blocks(x):
            k = self.signal_variance * self.kernel.value(offset)
            half = solve_triangular(self.cholesky, k.T, lower=True, check_finite=False)
            out[rows] = self.signal_variance - np.einsum("ij,ij->j", half, half)
        return np.maximum(out, 0.0)

    def hessian(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point dim dim"]:
        """Return the Hessian of the mean with respect to the physical inputs; exact at training points too."""
        out = np.empty((*x.shape, self.dim))
        for rows, offset in self._blocks(x):
            out[rows] = self.kernel.weighted_hessian(offset, self.alpha)
        unit = self.length_scale * self.scale
        return np.asarray(self.signal_variance * out / (unit[:, None] * unit))

    def _blocks(self, x: Float[np.ndarray, "point dim"]) -> Iterator[tuple[slice, Float[np.ndarray, "block run dim"]]]:
        """Yield rows of x with their offsets from the training points, in length scales."""
        expected = f"{self.dim} columns, as in the training runs"
        remedy = "Pass physical points, one row each, inputs in the order of the training."
        require(x.shape[1] == self.dim, "points for the Gaussian process", f"{x.shape[1]} columns", expected, remedy)
        points = (x - self.shift) / (self.scale * self.length_scale)
        train = self.x_train / self.length_scale
        size = max(1, _PAIRS_PER_BLOCK // len(train))
        for start in range(0, len(x), size):
            rows = slice(start, min(start + size, len(x)))
            yield rows, points[rows, None, :] - train


def standardisation(x: Inputs) -> tuple[Float[np.ndarray, " dim"], Float[np.ndarray, " dim"]]:
    """Return the mean and the standard deviation of each column.

    Raises:
        InvalidInput: a column that does not vary.
    """
    shift, scale = x.mean(axis=0), x.std(axis=0)
    flat = scale <= 1e-12 * np.maximum(np.abs(shift), np.finfo(float).tiny)
    which, expected = int(np.argmax(flat)), "an input that varies between the runs"
    remedy = "Leave the constant input out of the calibration."
    require(not flat.any(), f"training inputs, column {which}", float(shift[which]), expected, remedy)
    return shift, scale


def condition(
    x: Inputs, y: Targets, *, kernel: Kernel, length_scale: LengthScale, signal_variance: float, nugget: float
) -> GaussianProcess:
    """Return the Gaussian process conditioned on physical inputs x and targets y; hyperparameters are those of
    `GaussianProcess`.

    Raises:
        InvalidInput: an input column that does not vary, or a length scale that is not positive.
        NumericsError: the covariance is not positive definite.
    """
    shift, scale = standardisation(x)
    x_train, target_mean = (x - shift) / scale, float(y.mean())
    lengths = as_lengths(kernel, length_scale, x.shape[1])
    K = np.zeros((len(y), len(y)), order="F")
    pairs = kernel.pairs(x_train, unit=lengths)
    pairs.fill(K, inverse_lengths=np.ones(len(lengths)), variance=signal_variance, diagonal=nugget)
    factorise(K)
    return GaussianProcess(
        x_train=x_train,
        shift=shift,
        scale=scale,
        target_mean=target_mean,
        alpha=solve(K, y - target_mean),
        cholesky=K,
        kernel=kernel,
        length_scale=as_length_scale(kernel, lengths),
        signal_variance=float(signal_variance),
        nugget=float(nugget),
    )


def batched_mean(gp: GaussianProcess, *, fused: bool | None = None) -> Callable[[Particles], PerParticle]:
    """Return the posterior mean as a jittable JAX function of physical points (particle, dim).

    JAX's derivatives of it are NaN at a training point (√r² at 0); `GaussianProcess.hessian` is exact there too. If
    `fused`, one kernel reduces over a (particle, run) array, which suits an accelerator; False scans over the training
    points, which suits a CPU. None (the default) chooses by JAX's default back end.
    """
    unit, weight = gp.scale * gp.length_scale, gp.signal_variance * gp.alpha
    train, correlation = gp.x_train / gp.length_scale, gp.kernel.of_columns
    in_one = jax.default_backend() != "cpu" if fused is None else fused

    def offsets(points: jax.Array, centre: jax.Array) -> list[jax.Array]:
        """Return points - centre, coordinates on the leading axis."""
        return [p - c for p, c in zip(points, centre, strict=True)]

    def mean(x: Particles) -> PerParticle:
        points = ((x - gp.shift) / unit).T
        if in_one:
            offset = offsets(points[:, :, None], jnp.asarray(train.T)[:, None, :])
            return gp.target_mean + jnp.sum(correlation(offset) * weight, axis=1)

        def add(total: jax.Array, run: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
            centre, w = run
            return total + w * correlation(offsets(points, centre)), None

        start = jnp.zeros(len(x), points.dtype)
        total, _ = jax.lax.scan(add, start, (jnp.asarray(train), jnp.asarray(weight)), unroll=_UNROLL)
        return gp.target_mean + total

    return mean
