"""Global Gaussian approximation of a posterior: mean, covariance, percentile ellipses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.stats import chi2

from strandline.errors import InvalidInput, NumericsError

__all__ = ["GaussianApproximation"]


@dataclass(frozen=True, eq=False)
class GaussianApproximation:
    """A normal distribution with the given mean (dim,) and covariance (dim, dim), in the units of the inputs.

    The global approximation of the study takes the weighted mean and covariance of the particles:
    `GaussianApproximation(posterior.mean, posterior.covariance)`.
    """

    mean: Float[np.ndarray, " dim"]
    covariance: Float[np.ndarray, "dim dim"]

    @property
    def dim(self) -> int:
        """Number of inputs."""
        return len(self.mean)

    def log_density(self, x: Float[np.ndarray, "*point dim"]) -> Float[np.ndarray, "*point"]:
        """Return the log density at points (…, dim)."""
        factor = self.factor()
        log_volume = np.log(np.diag(factor)).sum() + 0.5 * self.dim * np.log(2 * np.pi)
        return np.asarray(-0.5 * self.radius(x) ** 2 - log_volume)

    def radius(self, x: Float[np.ndarray, "*point dim"]) -> Float[np.ndarray, "*point"]:
        """Return the Mahalanobis distance of points (…, dim) from the mean."""
        flat = (np.asarray(x) - self.mean).reshape(-1, self.dim)
        white = solve_triangular(self.factor(), flat.T, lower=True)
        return np.asarray(np.linalg.norm(white, axis=0).reshape(np.shape(x)[:-1]))

    def percentile_radius(self, p: float) -> float:
        """Return the Mahalanobis radius inside which the probability is p, 0 < p < 1."""
        require_fraction(p)
        return float(np.sqrt(chi2.ppf(p, df=self.dim)))

    def marginal(self, indices: Sequence[int]) -> "GaussianApproximation":
        """Return the marginal distribution of the inputs with the given numbers."""
        chosen = list(indices)
        return GaussianApproximation(self.mean[chosen], self.covariance[np.ix_(chosen, chosen)])

    def ellipse(self, p: float, *, pair: tuple[int, int] = (0, 1), number: int = 200) -> Float[np.ndarray, "point 2"]:
        """Return a closed curve (point, 2) that encloses probability p of the marginal of two inputs."""
        plane = self.marginal(pair)
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
        raise InvalidInput(
            "percentile",
            value=p,
            expected="a fraction between 0 and 1",
            remedy="Give 10 % as 0.1.",
        )
