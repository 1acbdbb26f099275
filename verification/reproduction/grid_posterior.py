"""Posteriors of E and ν on a product grid of Gauss points in (log E, ν, V), and the difference between two of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp
from verification.reproduction.field_table import LoadCoordinates

from strandline.foundations import NumericsError
from strandline.parameters import ParameterSpace

Reading = Literal["joint", "cut"]
LogLikelihood = Callable[[Float[np.ndarray, "point 3"]], Float[np.ndarray, " point"]]
"""log L at (E, ν, V); -inf if no state exists there."""

_PANEL_NODES = 4


@dataclass(frozen=True, eq=False)
class ProductGrid:
    """Gauss points and weights in E, ν and V; a fixed V is one point of weight 1."""

    young: Float[np.ndarray, " e"]
    young_weight: Float[np.ndarray, " e"]
    nu: Float[np.ndarray, " nu"]
    nu_weight: Float[np.ndarray, " nu"]
    rate: Float[np.ndarray, " rate"]
    rate_weight: Float[np.ndarray, " rate"]

    @property
    def area(self) -> Float[np.ndarray, "e nu"]:
        """Weights of the (E, ν) plane."""
        return np.asarray(self.young_weight[:, None] * self.nu_weight)

    def plane(self, rate: float) -> Float[np.ndarray, "point 3"]:
        """Return the (E, ν, V) of all points of the plane at one V, ν running fastest."""
        e, nu = (c.ravel() for c in np.meshgrid(self.young, self.nu, indexing="ij"))
        return np.stack([e, nu, np.full(e.shape, rate)], axis=1)


def product_grid(
    space: ParameterSpace, *, panels: tuple[int, int, int] = (64, 32, 24), rate: float | None = None
) -> ProductGrid:
    """Return four Gauss points on each of equal panels of log E, ν and V over the box of `space`.

    The space has E and nu, and V_in unless its fixed value, `rate` in mm²/s, is given.
    """
    softest, stiffest = space["E"].interval
    log_e, log_weight = _gauss(math.log(softest), math.log(stiffest), panels[0])
    nu, nu_weight = _gauss(*space["nu"].interval, panels[1])
    rates, rate_weight = (
        (np.array([rate]), np.ones(1)) if rate is not None else _gauss(*space["V_in"].interval, panels[2])
    )
    e = np.exp(log_e)
    return ProductGrid(e, log_weight * e, nu, nu_weight, rates, rate_weight)


def _gauss(low: float, high: float, panels: int) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    nodes, weights = np.polynomial.legendre.leggauss(_PANEL_NODES)
    width = (high - low) / panels
    starts = low + width * np.arange(panels)
    return (starts[:, None] + 0.5 * width * (nodes + 1)).ravel(), np.tile(0.5 * width * weights, panels)


@dataclass(frozen=True, eq=False)
class GridPosterior:
    """The posterior of (E, ν) on a product grid: its normalised density, 1/Pa, and moments.

    `log_evidence` is log ∫ L p, also for the cut reading, which does not use it; `edge_mass` what would lie beyond the
    soft end of the table if the likelihood kept its value there, as a share of the mass inside. It is taken as zero.
    """

    grid: ProductGrid
    density: Float[np.ndarray, "e nu"]
    mean: Float[np.ndarray, "2"]
    covariance: Float[np.ndarray, "2 2"]
    log_evidence: float
    edge_mass: float

    @property
    def sd(self) -> Float[np.ndarray, "2"]:
        """Standard deviations of E and ν."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))


def posteriors_on_grid(
    log_likelihood: LogLikelihood,
    space: ParameterSpace,
    grid: ProductGrid,
    *,
    coordinates: LoadCoordinates | None = None,
) -> dict[Reading, GridPosterior]:
    """Integrate prior times likelihood in both readings of V, which are the same if V is fixed.

    ``joint`` integrates V out of the posterior of all inputs; ``cut`` averages the posteriors at each V, each
    normalised by its own evidence, over the prior of V: the data do not update V. The mass at the soft end of the table
    behind the likelihood needs its coordinates.
    """
    log_area = np.log(grid.area)
    slices, edges = [], []
    for rate in grid.rate.tolist():
        x = grid.plane(rate)
        slices.append((log_likelihood(x) + _log_prior(space, x)).reshape(log_area.shape))
        edges.append(-np.inf if coordinates is None else _log_edge(log_likelihood, space, grid, coordinates, rate))
    log_values = np.array(slices)
    log_z = logsumexp(log_values + log_area, axis=(1, 2))
    if not np.isfinite(log_z).all():
        where = float(grid.rate[np.argmin(np.isfinite(log_z))])
        raise NumericsError(f"the likelihood is zero all over the box at V_in = {where:g}; widen the box of E")
    fixed = "V_in" not in space.names
    log_rate = np.log(grid.rate_weight) + (0.0 if fixed else space["V_in"].truncated_prior.log_density(grid.rate))
    evidence = float(logsumexp(log_rate + log_z))
    weights: dict[Reading, Float[np.ndarray, " rate"]] = {"joint": log_rate - evidence, "cut": log_rate - log_z}
    found = {}
    for reading, log_weight in weights.items():
        density = np.exp(logsumexp(log_values + log_weight[:, None, None], axis=0))
        edge = float(np.exp(logsumexp(np.array(edges) + log_weight)))
        found[reading] = _normalised(grid, density, evidence, edge)
    return found


def posterior_on_grid(log_likelihood: LogLikelihood, space: ParameterSpace, grid: ProductGrid) -> GridPosterior:
    """Return the joint reading, the posterior if V is fixed."""
    return posteriors_on_grid(log_likelihood, space, grid)["joint"]


def _normalised(grid: ProductGrid, density: Float[np.ndarray, "e nu"], evidence: float, edge: float) -> GridPosterior:
    mass = density * grid.area
    total = float(mass.sum())
    mass = mass / total
    x = np.stack(np.meshgrid(grid.young, grid.nu, indexing="ij"), axis=-1)
    mean = np.einsum("ij,ijk->k", mass, x)
    covariance = np.einsum("ij,ijk,ijl->kl", mass, x - mean, x - mean)
    return GridPosterior(grid, density / total, mean, covariance, evidence, edge / total)


def _log_prior(space: ParameterSpace, x: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " point"]:
    """Return the log prior of E and ν."""
    columns = {name: x[:, k] for k, name in enumerate(LoadCoordinates.names)}
    names = [name for name in space.names if name != "V_in"]
    return np.asarray(sum(space[name].truncated_prior.log_density(columns[name]) for name in names))


def _log_edge(
    log_likelihood: LogLikelihood, space: ParameterSpace, grid: ProductGrid, coordinates: LoadCoordinates, rate: float
) -> float:
    """Return the log of ∫ prior · (likelihood at the soft end) over the part of the box beyond the soft end."""
    low = space["E"].interval[0]
    softest = np.minimum(coordinates.softest(grid.nu, rate), space["E"].interval[1])
    beyond = np.maximum(softest - low, 0.0)
    if not (beyond > 0).any():
        return -np.inf
    x = np.stack([np.maximum(softest, low), grid.nu, np.full(len(grid.nu), rate)], axis=1)
    values = log_likelihood(x) + _log_prior(space, x)
    return float(logsumexp(values, b=beyond * grid.nu_weight))


@dataclass(frozen=True, eq=False)
class Difference:
    """The difference of one posterior from another: means in the other's sds, ratio of the sds minus 1, log evidences.

    There is no total variation between posteriors on different grids.
    """

    mean: Float[np.ndarray, "2"]
    sd_ratio: Float[np.ndarray, "2"]
    log_evidence: float
    total_variation: float | None


def compare(one: GridPosterior, other: GridPosterior) -> Difference:
    """Return the difference of `one` from `other`."""
    same = np.array_equal(one.grid.young, other.grid.young) and np.array_equal(one.grid.nu, other.grid.nu)
    return Difference(
        mean=(one.mean - other.mean) / other.sd,
        sd_ratio=one.sd / other.sd - 1,
        log_evidence=one.log_evidence - other.log_evidence,
        total_variation=total_variation(one, other) if same else None,
    )


def total_variation(one: GridPosterior, other: GridPosterior) -> float:
    """Return ½ ∫ |p - q| on the same grid: 0 for equal densities, 1 for densities that do not overlap."""
    return float(0.5 * np.sum(np.abs(one.density - other.density) * one.grid.area))
