"""Approximations of a posterior: a Gaussian by mean and covariance, or by the curvature at its mode (Laplace), and a
weighted Gaussian kernel density estimate with an optimised bandwidth and mirrored bounds.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular
from scipy.optimize import minimize_scalar
from scipy.spatial.distance import cdist
from scipy.special import ndtr
from scipy.stats import chi2

from strandline.foundations import NumericsError, require, side_by_side, use_double
from strandline.parameters import ParameterSpace
from strandline.posterior.weighted import Weighted, systematic_indices


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
        _require_fraction(p)
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


def _require_fraction(p: float) -> None:
    """Refuse a percentile that is not a fraction between 0 and 1."""
    require(0.0 < p < 1.0, "percentile", p, "a fraction between 0 and 1", "Give 10 % as 0.1.")


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
    eigenvalues = np.linalg.eigvalsh(hessian)
    return LaplaceApproximation(np.asarray(mode, float), hessian, covariance, definite, eigenvalues)


def log_prior_hessian(space: ParameterSpace, x: Float[np.ndarray, " dim"]) -> Float[np.ndarray, "dim dim"]:
    """Return the exact second derivatives of the log prior at a physical point x (dim,) inside the support.

    Raises:
        InvalidInput: JAX runs in single precision, or the prior density at x is zero.
    """
    use_double()
    finite, at = np.isfinite(space.log_prior(np.asarray(x))), dict(space.as_mapping(np.asarray(x)))
    words = "a point of positive and finite prior density", "Choose a point inside the support of every prior."
    require(finite, "log prior at the point of its Hessian", at, *words)
    return np.asarray(jax.jit(jax.hessian(space.log_prior))(jnp.asarray(x)))


def _symmetric(hessian: Float[np.ndarray, "dim dim"]) -> Float[np.ndarray, "dim dim"]:
    """Return the symmetric part; refuse a matrix that is far from symmetric or not finite."""
    size = np.sqrt(np.outer(np.abs(np.diag(hessian)), np.abs(np.diag(hessian)))) + np.abs(hessian)
    skew = np.abs(hessian - hessian.T)
    right = np.isfinite(hessian).all() and not (skew > 1e-3 * np.maximum(size, size.T)).any()
    remedy = "Check the derivatives; if they are finite differences, change the step."
    require(right, "Hessian of the log posterior", hessian.tolist(), "a finite, symmetric matrix", remedy)
    return np.asarray(0.5 * (hessian + hessian.T))


PerCentre = Float[np.ndarray, " centre"]
Matrix = Float[np.ndarray, "dim dim"]
Bounds = Float[np.ndarray, "dim 2"]
Draws = Float[np.ndarray, "particle dim"]
Weights = Float[np.ndarray, " particle"]
Values = Float[np.ndarray, " point"]
Points = Float[np.ndarray, "point dim"]
Centres = Float[np.ndarray, "centre dim"]
_BLOCK = 256  # points processed at once
_INTEGRAL_POINTS = 257
_REACH = 6.0
"""Distance, in kernel standard deviations, beyond which a kernel counts as zero: it is 1e-8 of its peak there."""
Squares = list[tuple[Bool[np.ndarray, " centre"], Float[np.ndarray, "_ centre"]]]


def slope_correction(
    points: Values, centres: PerCentre, weights: PerCentre, width: float, bounds: tuple[float, float]
) -> Values:
    """Return what to add to a mirrored Gaussian kernel estimate of one input so that it follows the slope at a bound.

    Mirrored kernels have no slope at a bound: if the true density falls towards it, the estimate is too high; if it
    rises, the estimate is too low. The local linear boundary kernel (Jones 1993, Statistics and Computing 3, 135) has
    no such error but more noise. The difference between the two is therefore shrunk by its own sampling variance, as in
    a James-Stein estimator: if the draws do not support a difference, the mirrored estimate stays as it is. Away from
    the bounds, which may be infinite, both are equal and nothing is added.
    """
    found = []
    for block in np.array_split(points, max(1, -(-len(points) // _BLOCK))):
        below, above = ((bound - block) / width for bound in bounds)
        mass = ndtr(above) - ndtr(below)
        first = _normal(below) - _normal(above)
        second = mass + _moment(below) - _moment(above)
        z = (centres - block[:, None]) / width
        kernel = _normal(z)
        linear = (second[:, None] - first[:, None] * z) * kernel / (second * mass - first**2)[:, None]
        mirrored = kernel + sum(_normal((2 * b - centres - block[:, None]) / width) for b in bounds if np.isfinite(b))
        terms = (linear - mirrored) / width
        difference = terms @ weights
        variance = (terms - difference[:, None]) ** 2 @ weights**2
        kept = np.maximum(0.0, 1.0 - variance / np.maximum(difference**2, np.finfo(float).tiny))
        found.append(kept * difference)
    return np.concatenate(found)


def _normal(z: Float[np.ndarray, "*point"]) -> Float[np.ndarray, "*point"]:
    return np.asarray(np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi))


def _moment(z: Values) -> Values:
    """Return z φ(z), zero at infinity."""
    finite = np.where(np.isfinite(z), z, 0.0)
    return np.asarray(finite * _normal(finite))


@dataclass(frozen=True, eq=False)
class KernelDensity:
    """Mixture of Gaussian kernels, one about each distinct draw, mirrored at the bounds.

    Copies of a draw are merged and their weights added. `factor` is the lower Cholesky factor of the kernel's
    covariance, which includes the bandwidth, relative to the draws' standard deviation. Bounds are infinite if there
    are none. A plain kernel estimate leaks across the bounds and declines towards them although the posterior does not.
    Mirroring at every bound folds the leaking mass back, which is exact as long as the kernels are narrow compared with
    the box. The estimate of a single input also follows the slope of the density at its bounds (`slope_correction`).
    """

    centres: Centres
    weights: PerCentre
    factor: Matrix
    bandwidth: float
    bounds: Bounds

    @classmethod
    def fit(
        cls,
        draws: Draws,
        weights: Weights,
        *,
        bounds: Sequence[tuple[float, float]] | None = None,
        bandwidth: float | None = None,
        loo_points: int = 1000,
    ) -> "KernelDensity":
        """Return the estimate of weighted draws, physical; kernels are mirrored at the bounds (low, high) of each
        input.

        The bandwidth, relative to the standard deviation of the draws, is by default the one with the highest
        leave-one-out likelihood. More than `loo_points` draws are thinned for it by systematic resampling, and the
        bandwidth is then scaled by n^(-1/(dim+4)) to the full set.

        Raises:
            NumericsError: the draws have no spread in some direction.
        """
        centres, mass = _distinct(draws, weights)
        limits = np.array([(-np.inf, np.inf)] * draws.shape[1] if bounds is None else bounds, float)
        unit = _factor(centres, mass)
        if bandwidth is None:
            bandwidth = _optimal_bandwidth(centres, mass, unit, limits, loo_points)
        return cls(centres, mass, bandwidth * unit, float(bandwidth), limits)

    @property
    def dim(self) -> int:
        return int(self.centres.shape[1])

    def density(self, points: Points) -> Values:
        """Return the density at points (point, dim); zero outside the bounds."""
        inside = ((points >= self.bounds[:, 0]) & (points <= self.bounds[:, 1])).all(axis=1)
        total = np.zeros(len(points))
        total[inside] = self._raw(points[inside]) / self._integral
        return total

    def _raw(self, points: Points) -> Values:
        """Return the density at points inside the bounds before it is normalised."""
        total = np.zeros(len(points))
        for near, image in _images(points, self.bounds, _reach(self.factor)):
            total[near] += self._unbounded(image)
        close = np.abs(points - self.bounds.T[:, None]).min(axis=0) <= _reach(self.factor)
        if self.dim == 1 and close.any():
            low, high = self.bounds[0]
            near, width = close[:, 0], float(self.factor[0, 0])
            total[near] += slope_correction(points[near, 0], self.centres[:, 0], self.weights, width, (low, high))
        return np.maximum(total, 0.0)

    @cached_property
    def _integral(self) -> float:
        """The integral of `_raw`: mirroring keeps the mass of kernels; the slope correction changes it slightly."""
        if self.dim > 1 or not np.isfinite(self.bounds).any():
            return 1.0
        reach = float(_reach(self.factor)[0])
        low = max(float(self.bounds[0, 0]), float(self.centres.min()) - reach)
        high = min(float(self.bounds[0, 1]), float(self.centres.max()) + reach)
        grid = np.linspace(low, high, _INTEGRAL_POINTS)
        return float(np.trapezoid(self._raw(grid[:, None]), grid))

    def _unbounded(self, points: Points) -> Values:
        """Return the density of the kernels without mirroring, in blocks of points."""
        white, white_centres = _whiten(points, self.factor), _whiten(self.centres, self.factor)
        norm = np.prod(np.diag(self.factor)) * (2 * np.pi) ** (self.dim / 2)

        def summed(block: Float[np.ndarray, "some dim"]) -> Float[np.ndarray, " some"]:
            return np.asarray(np.exp(-0.5 * cdist(block, white_centres, "sqeuclidean")) @ self.weights)

        blocks = np.array_split(white, max(1, len(white) // 256))
        return np.asarray(np.concatenate([*side_by_side(summed, blocks)]) / norm)


def enclosing_levels(density: Float[np.ndarray, "y x"], masses: Sequence[float]) -> Float[np.ndarray, " n"]:
    """Return the levels whose contours enclose these probabilities, of a density on a grid that holds all of it."""
    for p in masses:
        _require_fraction(p)
    across, up = (np.r_[0.5, np.ones(number - 2), 0.5] for number in density.shape[::-1])
    order = np.argsort(-density, axis=None)
    inside = np.cumsum((density * np.outer(up, across)).ravel()[order])
    return np.asarray(np.interp(masses, inside / inside[-1], density.ravel()[order]))


def _distinct(draws: Draws, weights: Weights) -> tuple[Centres, PerCentre]:
    """Merge copies of a draw: resampling makes them, and each would have a neighbour at distance zero."""
    centres, member = np.unique(draws[weights > 0], axis=0, return_inverse=True)
    mass = np.bincount(member.ravel(), weights=weights[weights > 0], minlength=len(centres))
    return centres, mass / mass.sum()


def _factor(centres: Centres, weights: PerCentre) -> Matrix:
    covariance = Weighted(centres, weights).covariance
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError as error:
        raise NumericsError(
            f"a kernel density estimate needs spread in every direction; {len(centres)} distinct draws have the "
            f"variances {np.diag(covariance).tolist()}. Use more particles or leave the constant input out."
        ) from error


def _optimal_bandwidth(centres: Centres, weights: PerCentre, unit: Matrix, bounds: Bounds, loo_points: int) -> float:
    """Return the bandwidth with the highest leave-one-out likelihood, within a factor of 10 of the normal rule."""
    power = -1.0 / (unit.shape[0] + 4)
    points, mass = centres, weights
    if len(points) > loo_points:
        chosen = systematic_indices(weights, loo_points, np.random.default_rng(0))
        points, mass = _distinct(centres[chosen], np.full(loo_points, 1.0 / loo_points))
    normal_rule = (_size(mass) * (unit.shape[0] + 2) / 4) ** power
    upper = 3.0 * normal_rule
    squares = _pair_squares(points, unit, bounds, upper)
    found = minimize_scalar(
        lambda log_h: -_leave_one_out(squares, mass, float(np.exp(log_h)), unit.shape[0]),
        bounds=(np.log(0.1 * normal_rule), np.log(upper)),
        method="bounded",
        options={"xatol": 0.01},
    )
    return float(np.exp(found.x) * (_size(weights) / _size(mass)) ** power)


def _pair_squares(points: Centres, unit: Matrix, bounds: Bounds, upper: float) -> Squares:
    """Return, image by image, squared distances to all other points in standard deviations; a point's own are inf."""
    white = _whiten(points, unit)
    found = []
    for near, image in _images(points, bounds, _reach(upper * unit)):
        squares = cdist(_whiten(image, unit), white, "sqeuclidean")
        squares[np.arange(len(image)), np.flatnonzero(near)] = np.inf
        found.append((near, squares))
    return found


def _leave_one_out(squares: Squares, weights: PerCentre, h: float, dim: int) -> float:
    """Return Σ_i w_i log f_{-i}(x_i): the density at each draw from all others, never from its own mirror image."""
    nearest = np.full(len(weights), np.inf)
    for near, square in squares:
        nearest[near] = np.minimum(nearest[near], square.min(axis=1))
    total = np.zeros(len(weights))
    for near, square in squares:
        total[near] += np.exp((nearest[near, None] - square) / (2 * h * h)) @ weights
    log_density = np.log(total) - nearest / (2 * h * h) - np.log1p(-weights) - dim * np.log(h)
    return float(weights @ log_density)


def _images(
    points: Points, bounds: Bounds, reach: Float[np.ndarray, " dim"]
) -> Iterator[tuple[Bool[np.ndarray, " point"], Float[np.ndarray, "near dim"]]]:
    """Yield (which points, their image) for the points themselves and every mirror image within reach of a bound."""
    for sides in itertools.product((None, 0, 1), repeat=points.shape[1]):
        near, image = np.ones(len(points), bool), points.copy()
        for k, side in enumerate(sides):
            if side is not None:
                near &= np.abs(points[:, k] - bounds[k, side]) <= reach[k]
                image[:, k] = 2 * bounds[k, side] - points[:, k]
        if near.any():
            yield near, image[near]


def _reach(factor: Matrix) -> Float[np.ndarray, " dim"]:
    """Return the distance along each input at which a kernel counts as zero."""
    return np.asarray(_REACH * np.linalg.norm(factor, axis=1))


def _whiten(points: Points, factor: Matrix) -> Points:
    return np.asarray(solve_triangular(factor, points.T, lower=True).T)


def _size(weights: PerCentre) -> float:
    return float(1.0 / np.sum(weights**2))
