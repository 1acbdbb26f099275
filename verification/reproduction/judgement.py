"""A judged claim, and the figures of a density or a likelihood by which claims are judged."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from scipy.signal import find_peaks

from strandline.posterior import GaussianApproximation, KernelDensity, Posterior, Weighted, histogram

Verdict = Literal["confirmed", "refuted", "differs"]
_GRID = 401
PROMINENCE = 0.05
"""A local maximum of a marginal counts if it rises above its surroundings by this share of the highest maximum."""


@dataclass(frozen=True)
class Claim:
    """A claim of the study, supported by these of its figures, and what our numbers say about it, and the study's.

    The verdict ``differs`` is for a setting of the study that cannot be compared with ours.
    """

    key: str
    statement: str
    figures: tuple[int, ...]
    verdict: Verdict
    because: str
    numbers: Mapping[str, Any]
    study: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return the entry of claims.json."""
        return {name: value for name, value in asdict(self).items() if name != "key"}


@dataclass(frozen=True, eq=False)
class LikelihoodField:
    """A log-likelihood on a grid of two inputs."""

    x: Float[np.ndarray, " x"]
    y: Float[np.ndarray, " y"]
    values: Float[np.ndarray, "x y"]

    @property
    def peak(self) -> tuple[float, float]:
        """The grid point of highest likelihood."""
        i, j = np.unravel_index(int(np.argmax(self.values)), self.values.shape)
        return float(self.x[i]), float(self.y[j])

    def share_above(self, fraction: float) -> float:
        """Return the share of the box where the likelihood exceeds `fraction` of its maximum."""
        return float(np.mean(self.values > self.values.max() + np.log(fraction)))

    def at(self, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, " point"]:
        """Return the log-likelihood at the grid points next to `points`."""
        i = np.abs(self.x[:, None] - points[:, 0]).argmin(axis=0)
        j = np.abs(self.y[:, None] - points[:, 1]).argmin(axis=0)
        return np.asarray(self.values[i, j])

    @property
    def ridge(self) -> Float[np.ndarray, " y"]:
        """The value of the first input with the highest likelihood at each value of the second (y,)."""
        return np.asarray(self.x[np.argmax(self.values, axis=0)])


def modes(posterior: Posterior, name: str) -> list[float]:
    """Return the local maxima of the kernel density estimate of a marginal, the highest first."""
    grid, density = _marginal(posterior, name)
    padded = np.concatenate([[0.0], density, [0.0]])
    found, _ = find_peaks(padded, prominence=PROMINENCE * density.max())
    ordered = sorted(found - 1, key=lambda i: -density[i])
    return [float(grid[i]) for i in ordered]


def plateau(posterior: Posterior, name: str) -> float:
    """Return the length over which a marginal exceeds 0.8 of its maximum, in its standard deviations.

    It is 1.34 for a Gaussian and √12 = 3.46 for a uniform density.
    """
    grid, density = _marginal(posterior, name)
    step = grid[1] - grid[0]
    (sd,) = Weighted(posterior.columns([name]), posterior.weights).sd
    return float(step * np.count_nonzero(density >= 0.8 * density.max()) / sd)


def distance_to_prior(posterior: Posterior, name: str) -> float:
    """Return the total variation between a marginal and its prior, both as histograms over the box."""
    _, mass, prior = _beside_prior(posterior, name)
    return float(0.5 * np.abs(mass - prior).sum())


def density_over_prior(posterior: Posterior, name: str, value: float) -> float:
    """Return the ratio of a marginal to its prior at `value`, both as histograms over the box."""
    edges, mass, prior = _beside_prior(posterior, name)
    at = int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(mass) - 1))
    return float(mass[at] / prior[at])


def correlation_ratio(posterior: Posterior, name: str, given: str, *, bins: int = 20) -> float:
    """Return the square root of the share of an input's variance that its mean given another input explains.

    It is |ρ| for a normal distribution; unlike ρ it also sees a curved dependence. The other input is cut into `bins`
    parts of equal weight, so that it is about √(bins/n), not 0, for n draws of independent inputs.
    """
    value, by = posterior.columns([name, given]).T
    order = np.argsort(by, kind="stable")
    weights, value = posterior.weights[order], value[order]
    part = np.minimum((bins * (np.cumsum(weights) - 0.5 * weights)).astype(int), bins - 1)
    mass, first = (np.bincount(part, w, bins) for w in (weights, weights * value))
    mean, held = weights @ value, mass > 0
    between = mass[held] @ (first[held] / mass[held] - mean) ** 2
    return float(np.sqrt(between / (weights @ (value - mean) ** 2)))


def angle_between_axes(
    one: Float[np.ndarray, "2 2"], other: Float[np.ndarray, "2 2"], scale: Float[np.ndarray, "2"]
) -> float:
    """Return the angle between the main axes of two covariances, degrees, with inputs divided by `scale`."""
    axes = [np.linalg.eigh(c / np.outer(scale, scale))[1][:, -1] for c in (one, other)]
    return float(np.degrees(np.arccos(min(1.0, abs(axes[0] @ axes[1])))))


def mass_within(posterior: Posterior, approximation: GaussianApproximation, level: float) -> float:
    """Return the posterior mass inside the ellipse that holds `level` of a Gaussian approximation's mass."""
    inside = approximation.radius(posterior.draws) <= approximation.percentile_radius(level)
    return float(posterior.weights[inside].sum())


def _beside_prior(
    posterior: Posterior, name: str, bins: int = 30
) -> tuple[Float[np.ndarray, " edge"], Float[np.ndarray, " bin"], Float[np.ndarray, " bin"]]:
    """Return the edges of bins over the box, and the mass of a marginal and of its prior in each bin."""
    parameter = posterior.space[name]
    bars = histogram(posterior.columns([name])[:, 0], posterior.weights, bounds=parameter.interval, bins=bins)
    below = np.asarray(parameter.truncated_prior.cdf(bars.edges))
    return bars.edges, bars.mass, np.diff(below)


def _marginal(posterior: Posterior, name: str) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """Return a grid over the box and the kernel density estimate there."""
    interval = posterior.space[name].interval
    grid = np.linspace(*interval, _GRID)
    estimate = KernelDensity.fit(posterior.columns([name]), posterior.weights, bounds=[interval])
    return grid, np.asarray(estimate.density(grid[:, None]))
