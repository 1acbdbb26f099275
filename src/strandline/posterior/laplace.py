"""Laplace approximation: the log posterior's curvature at its mode, as a Gaussian."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput, NumericsError
from strandline.numerics.threads import use_double
from strandline.parameters import ParameterSpace
from strandline.posterior.gaussian import GaussianApproximation

__all__ = ["LaplaceApproximation", "laplace", "log_prior_hessian"]


@dataclass(frozen=True, eq=False)
class LaplaceApproximation:
    """Second-order expansion of the log posterior about a mode; see `laplace`.

    Args:
        mode: Point of the expansion (dim,), physical.
        hessian: Second derivatives of the log posterior there (dim, dim).
        covariance: Minus the inverse of `hessian`; None if that is not a covariance.
        definite: Whether `hessian` is negative definite.
        eigenvalues: Eigenvalues of `hessian` (dim,), ascending; one above zero marks a direction in which `mode` is
            not a maximum.
    """

    mode: Float[np.ndarray, " dim"]
    hessian: Float[np.ndarray, "dim dim"]
    covariance: Float[np.ndarray, "dim dim"] | None
    definite: bool
    eigenvalues: Float[np.ndarray, " dim"]

    @property
    def gaussian(self) -> GaussianApproximation:
        """The Gaussian about the mode.

        Raises:
            NumericsError: The Hessian is indefinite, so there is no Gaussian.
        """
        if self.covariance is None:
            raise NumericsError(
                "the Hessian of the log posterior is not negative definite; its eigenvalues are "
                f"{self.eigenvalues.tolist()}: "
                "there is no Laplace approximation. The point may be off the mode or on a bound; use the particles."
            )
        return GaussianApproximation(self.mode, self.covariance)


def laplace(
    log_posterior_hessian_at_map: Float[np.ndarray, "dim dim"], mode: Float[np.ndarray, " dim"]
) -> LaplaceApproximation:
    """Return the Laplace approximation about `mode`; an indefinite Hessian is reported, not inverted.

    Definiteness is decided after scaling to a unit diagonal, so that it does not depend on the units of the inputs.

    Args:
        log_posterior_hessian_at_map: second derivatives of log likelihood + log prior (dim, dim), physical units.
        mode: the point they were taken at (dim,).

    Raises:
        InvalidInput: a Hessian that is not finite or not symmetric.
    """
    hessian = _symmetric(np.asarray(log_posterior_hessian_at_map, float))
    curvature = np.diag(hessian)
    scale = 1.0 / np.sqrt(np.where(curvature < 0, -curvature, 1.0))
    scaled = -hessian * np.outer(scale, scale)
    floor = len(hessian) * np.finfo(float).eps
    definite = bool((curvature < 0).all() and np.linalg.eigvalsh(scaled)[0] > floor)
    covariance = np.linalg.inv(scaled) * np.outer(scale, scale) if definite else None
    return LaplaceApproximation(
        mode=np.asarray(mode, float),
        hessian=hessian,
        covariance=covariance,
        definite=definite,
        eigenvalues=np.linalg.eigvalsh(hessian),
    )


def log_prior_hessian(space: ParameterSpace, x: Float[np.ndarray, " dim"]) -> Float[np.ndarray, "dim dim"]:
    """Return the exact second derivatives of the log prior at a physical point x (dim,) inside the support.

    Raises:
        InvalidInput: JAX runs in single precision, or the prior density at x is zero.
    """
    use_double()
    if not np.isfinite(space.log_prior(np.asarray(x))):
        raise InvalidInput(
            "log prior at the point of its Hessian",
            value=dict(space.as_mapping(np.asarray(x))),
            expected="a point of positive and finite prior density",
            remedy="Choose a point inside the support of every prior.",
        )
    return np.asarray(jax.jit(jax.hessian(space.log_prior))(jnp.asarray(x)))


def _symmetric(hessian: Float[np.ndarray, "dim dim"]) -> Float[np.ndarray, "dim dim"]:
    """Return the symmetric part; refuse a matrix that is far from symmetric or not finite."""
    size = np.sqrt(np.outer(np.abs(np.diag(hessian)), np.abs(np.diag(hessian)))) + np.abs(hessian)
    skew = np.abs(hessian - hessian.T)
    if not np.isfinite(hessian).all() or (skew > 1e-3 * np.maximum(size, size.T)).any():
        raise InvalidInput(
            "Hessian of the log posterior",
            value=hessian.tolist(),
            expected="a finite, symmetric matrix",
            remedy="Check the derivatives; if they are finite differences, change the step.",
        )
    return np.asarray(0.5 * (hessian + hessian.T))
