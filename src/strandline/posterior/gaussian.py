"""Gaussian approximations of a posterior: by mean and covariance, and by the curvature at its mode (Laplace)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.stats import chi2

from strandline.foundations import InvalidInput, NumericsError, use_double
from strandline.parameters import ParameterSpace


@dataclass(frozen=True, eq=False)
class GaussianApproximation:
    """A normal distribution with the given mean (dim,) and covariance (dim, dim), in the units of the inputs.

    The global approximation of the study takes the weighted mean and covariance of the particles:
    `GaussianApproximation(posterior.mean, posterior.covariance)`.
    """

    mean: Float[np.ndarray, " dim"]
    covariance: Float[np.ndarray, "dim dim"]

    def radius(self, x: Float[np.ndarray, "*point dim"]) -> Float[np.ndarray, "*point"]:
        """Return the Mahalanobis distance of points (…, dim) from the mean."""
        flat = (np.asarray(x) - self.mean).reshape(-1, len(self.mean))
        white = solve_triangular(self.factor(), flat.T, lower=True)
        return np.asarray(np.linalg.norm(white, axis=0).reshape(np.shape(x)[:-1]))

    def percentile_radius(self, p: float) -> float:
        """Return the Mahalanobis radius inside which the probability is p, 0 < p < 1."""
        require_fraction(p)
        return float(np.sqrt(chi2.ppf(p, df=len(self.mean))))

    def ellipse(self, p: float, *, pair: tuple[int, int] = (0, 1), number: int = 200) -> Float[np.ndarray, "point 2"]:
        """Return a closed curve (point, 2) that encloses probability p of the marginal of two inputs."""
        chosen = list(pair)
        plane = GaussianApproximation(self.mean[chosen], self.covariance[np.ix_(chosen, chosen)])
        angle = np.linspace(0.0, 2 * np.pi, number)
        circle = plane.percentile_radius(p) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.asarray(plane.mean + circle @ plane.factor().T)

    def factor(self) -> Float[np.ndarray, "dim dim"]:
        """Return the lower Cholesky factor of the covariance.

        Raises:
            NumericsError: the covariance is not positive definite.
        """
        try:
            return np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError as error:
            raise NumericsError(
                "the covariance of a Gaussian is not positive definite; its diagonal is "
                f"{np.diag(self.covariance).tolist()}: "
                "an input without spread has no Gaussian approximation: leave it out."
            ) from error


def require_fraction(p: float) -> None:
    """Refuse a percentile that is not a fraction between 0 and 1."""
    if not 0.0 < p < 1.0:
        raise InvalidInput("percentile", value=p, expected="a fraction between 0 and 1", remedy="Give 10 % as 0.1.")


@dataclass(frozen=True, eq=False)
class LaplaceApproximation:
    """Second-order expansion of the log posterior about a mode, physical; see `laplace`.

    `covariance` is minus the inverse of `hessian`; None if that is not a covariance. Eigenvalues of `hessian` are
    ascending; one above zero marks a direction in which `mode` is not a maximum.
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

    The Hessian is that of log likelihood + log prior at the mode, in physical units. Definiteness is decided after
    scaling to a unit diagonal, so that it does not depend on the units of the inputs.

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
