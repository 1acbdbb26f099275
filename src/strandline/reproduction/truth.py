"""The posterior of the true model by quadrature: the log-likelihood of tabulated interfaces, integrated on a grid.

No surrogate of the log-likelihood is fitted to scattered runs. Interfaces come from a `FieldTable`, their measure is
evaluated on a fine tensor grid in the coordinates of that table, along which the ridge of the likelihood runs, and
splines of the fifth degree carry it from there to a product grid of Gauss points in (log E, ν, V). A prior, a fixed
inflow rate, or the reading of an uncertain one costs no new evaluation of the measure.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.interpolate import NdBSpline, make_interp_spline
from scipy.special import logsumexp

from strandline.errors import InvalidInput, NumericsError
from strandline.likelihood import InterfaceLikelihood
from strandline.parameters import ParameterSpace
from strandline.reproduction.batch import batch_log_likelihood
from strandline.reproduction.field_table import FieldTable, LoadCoordinates

__all__ = [
    "Difference",
    "GridPosterior",
    "LogLikelihood",
    "LogLikelihoodField",
    "ProductGrid",
    "Reading",
    "TruePosterior",
    "compare",
    "log_likelihood_field",
    "posterior_on_grid",
    "product_grid",
    "spline_field",
    "total_variation",
    "true_fields",
    "true_posterior",
]

Reading = Literal["joint", "cut"]
LogLikelihood = Callable[[Float[np.ndarray, "point 3"]], Float[np.ndarray, " point"]]
"""log L at (E, ν, V), -inf where there is no state."""

_SPLINE_DEGREE = 5
_PANEL_NODES = 4


@dataclass(frozen=True, eq=False)
class LogLikelihoodField:
    """log L on the box of a table as a tensor spline; -inf outside it.

    Args:
        coordinates: of the box.
        axes: the nodes of each box coordinate; a single node makes the field constant in it.
        values: log L at the nodes.
        spline: through the values, over the coordinates with more than one node.
    """

    coordinates: LoadCoordinates
    axes: tuple[Float[np.ndarray, " s"], Float[np.ndarray, " nu"], Float[np.ndarray, " rate"]]
    values: Float[np.ndarray, "s nu rate"]
    spline: NdBSpline

    def __call__(self, x: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " point"]:
        """Return log L at (E, ν, V)."""
        result = np.full(len(x), -np.inf)
        inside = self.coordinates.inside(x)
        z = np.clip(self.coordinates.to_box(x[inside]), [-1.0, -1.0, -np.inf], 1.0)
        varying = [k for k, axis in enumerate(self.axes) if len(axis) > 1]
        if inside.any():
            result[inside] = self.spline(np.ascontiguousarray(z[:, varying]))
        return result

    def halved(self) -> "LogLikelihoodField":
        """Return the field through every second node."""
        a, b, c = (axis[::2] for axis in self.axes)
        return spline_field(self.coordinates, (a, b, c), self.values[::2, ::2, ::2])


def log_likelihood_field(
    table: FieldTable, likelihood: InterfaceLikelihood, *, nodes: tuple[int, int, int], rate: float | None = None
) -> LogLikelihoodField:
    """Evaluate log L on a tensor grid of the table's box.

    Args:
        table: of the interfaces.
        likelihood: with one observation.
        nodes: in s, ν and V, at least 11 each (the halved field needs 6), odd ones being nested.
        rate: a fixed inflow rate, which has one node; `nodes[2]` does not count then.
    """
    s, nu = (np.linspace(-1.0, 1.0, n) for n in nodes[:2])
    low, high = table.coordinates.rate
    fixed = None if rate is None else 2 * (rate - low) / (high - low) - 1
    rates = np.linspace(-1.0, 1.0, nodes[2]) if fixed is None else np.array([fixed])
    values = np.empty((len(s), len(nu), len(rates)))
    for i in range(len(s)):
        for k in range(len(rates)):
            shapes = table.on_grid(s[i : i + 1], nu, rates[k : k + 1])[0, :, 0]
            values[i, :, k] = batch_log_likelihood(likelihood, shapes)
    return spline_field(table.coordinates, (s, nu, rates), values)


def spline_field(
    coordinates: LoadCoordinates,
    axes: tuple[Float[np.ndarray, " s"], Float[np.ndarray, " nu"], Float[np.ndarray, " rate"]],
    values: Float[np.ndarray, "s nu rate"],
) -> LogLikelihoodField:
    """Return the field through given values of log L.

    Args:
        coordinates: the box.
        axes: equally spaced nodes from -1 to 1 in s, ν and V, at least six each; one node makes it constant.
        values: log L at the nodes.
    """
    coefficients, knots = values, []
    for k, axis in enumerate(axes):
        if len(axis) > 1:
            line = make_interp_spline(axis, np.moveaxis(coefficients, k, 0), k=_SPLINE_DEGREE)
            coefficients = np.moveaxis(line.c, 0, k)
            knots.append(line.t)
    squeezed = np.ascontiguousarray(coefficients.reshape([len(axis) for axis in axes if len(axis) > 1]))
    return LogLikelihoodField(coordinates, axes, values, NdBSpline(tuple(knots), squeezed, k=_SPLINE_DEGREE))


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
    """Return Gauss points on equal panels of log E, ν and V over the box of `space`.

    Args:
        space: has E and nu, and V_in unless `rate` is given.
        panels: of four points each.
        rate: the fixed inflow rate.

    Raises:
        InvalidInput: inputs other than these.
    """
    wanted = {"E", "nu"} if rate is not None else {"E", "nu", "V_in"}
    if set(space.names) != wanted:
        raise InvalidInput(
            "inputs of the posterior by quadrature",
            value=list(space.names),
            expected=f"{', '.join(sorted(wanted))}",
            remedy="Give the inflow rate where it is fixed, and only there.",
        )
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
    """The posterior of (E, ν) on a product grid.

    Args:
        grid: its points.
        density: normalised, at the points of the (E, ν) plane, 1/Pa.
        mean: of E and ν.
        covariance: of E and ν.
        log_evidence: log ∫ L p; of the cut reading too, where the posterior does not use it.
        log_evidence_at_rate: log Z(V) at the points in V.
        edge_mass: the mass that lay beyond the soft end of the table if the likelihood stayed there what it is at that
            end, as a share of the mass inside. Taken as zero everywhere else.
    """

    grid: ProductGrid
    density: Float[np.ndarray, "e nu"]
    mean: Float[np.ndarray, "2"]
    covariance: Float[np.ndarray, "2 2"]
    log_evidence: float
    log_evidence_at_rate: Float[np.ndarray, " rate"]
    edge_mass: float

    @property
    def sd(self) -> Float[np.ndarray, "2"]:
        """Standard deviations of E and ν."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))


def posterior_on_grid(
    log_likelihood: LogLikelihood,
    space: ParameterSpace,
    grid: ProductGrid,
    *,
    reading: Reading = "joint",
    coordinates: LoadCoordinates | None = None,
) -> GridPosterior:
    """Integrate prior times likelihood.

    Args:
        log_likelihood: of the true model, or a surrogate's.
        space: the inputs with their priors.
        grid: from `product_grid`; V fixed or not.
        reading: ``joint`` integrates V out of the posterior of all inputs; ``cut`` averages the posteriors at each V,
            each normalised by its own evidence, over the prior of V: the data do not update V. Alike where V is fixed.
        coordinates: of the table behind the likelihood, for the mass at its soft end.

    Raises:
        NumericsError: no state inside the box at a V that the prior admits.
    """
    log_area = np.log(grid.area)
    slices, edges = [], []
    for rate in grid.rate.tolist():
        x = grid.plane(rate)
        prior = _log_prior(space, x, without_rate=True).reshape(log_area.shape)
        slices.append(log_likelihood(x).reshape(log_area.shape) + prior)
        edges.append(-np.inf if coordinates is None else _log_edge(log_likelihood, space, grid, coordinates, rate))
    log_values = np.array(slices)
    log_z = logsumexp(log_values + log_area, axis=(1, 2))
    if not np.isfinite(log_z).all():
        where = float(grid.rate[np.argmin(np.isfinite(log_z))])
        raise NumericsError(f"the likelihood is zero all over the box at V_in = {where:g}; widen the box of E")
    log_rate = np.log(grid.rate_weight) + _log_rate_prior(space, grid.rate)
    evidence = float(logsumexp(log_rate + log_z))
    log_weight = log_rate - log_z if reading == "cut" else log_rate - evidence
    density = np.exp(logsumexp(log_values + log_weight[:, None, None], axis=0))
    edge = float(np.exp(logsumexp(np.array(edges) + log_weight)))
    return _moments(grid, density, evidence, log_z, edge)


def _moments(
    grid: ProductGrid,
    density: Float[np.ndarray, "e nu"],
    evidence: float,
    log_z: Float[np.ndarray, " rate"],
    edge: float,
) -> GridPosterior:
    mass = density * grid.area
    total = float(mass.sum())
    mass = mass / total
    x = np.stack(np.meshgrid(grid.young, grid.nu, indexing="ij"), axis=-1)
    mean = np.einsum("ij,ijk->k", mass, x)
    covariance = np.einsum("ij,ijk,ijl->kl", mass, x - mean, x - mean)
    return GridPosterior(grid, density / total, mean, covariance, evidence, log_z, edge / total)


def _log_prior(
    space: ParameterSpace, x: Float[np.ndarray, "point 3"], *, without_rate: bool
) -> Float[np.ndarray, " point"]:
    names = [name for name in space.names if not (without_rate and name == "V_in")]
    columns = {name: x[:, k] for k, name in enumerate(LoadCoordinates.names)}
    return np.asarray(sum(space[name].truncated_prior.log_density(columns[name]) for name in names))


def _log_rate_prior(space: ParameterSpace, rate: Float[np.ndarray, " rate"]) -> Float[np.ndarray, " rate"]:
    """Return the log prior of V; a fixed V has the prior 1."""
    if "V_in" not in space.names:
        return np.zeros(len(rate))
    return np.asarray(space["V_in"].truncated_prior.log_density(rate))


def _log_edge(
    log_likelihood: LogLikelihood, space: ParameterSpace, grid: ProductGrid, coordinates: LoadCoordinates, rate: float
) -> float:
    """Return the log of ∫ prior · (likelihood at the soft end) over the part of the box beyond that end."""
    low = space["E"].interval[0]
    softest = np.minimum(coordinates.softest(grid.nu, rate), space["E"].interval[1])
    beyond = np.maximum(softest - low, 0.0)
    if not (beyond > 0).any():
        return -np.inf
    x = np.stack([np.maximum(softest, low), grid.nu, np.full(len(grid.nu), rate)], axis=1)
    values = log_likelihood(x) + _log_prior(space, x, without_rate=True)
    return float(logsumexp(values, b=beyond * grid.nu_weight))


@dataclass(frozen=True, eq=False)
class Difference:
    """How far a posterior is from another one, in the other's standard deviations.

    Args:
        mean: difference of the means, in standard deviations.
        sd_ratio: ratio of the standard deviations, less 1.
        correlation: difference of the correlations of E and ν.
        log_evidence: difference of the log evidences.
        total_variation: ½ ∫ |p - q|; None on different grids.
    """

    mean: Float[np.ndarray, "2"]
    sd_ratio: Float[np.ndarray, "2"]
    correlation: float
    log_evidence: float
    total_variation: float | None


def compare(one: GridPosterior, other: GridPosterior) -> Difference:
    """Return how far `one` is from `other`."""
    a, b = (p.covariance[0, 1] / p.sd.prod() for p in (one, other))
    return Difference(
        mean=(one.mean - other.mean) / other.sd,
        sd_ratio=one.sd / other.sd - 1,
        correlation=float(a - b),
        log_evidence=one.log_evidence - other.log_evidence,
        total_variation=total_variation(one, other) if one.density.shape == other.density.shape else None,
    )


def total_variation(one: GridPosterior, other: GridPosterior) -> float:
    """Return ½ ∫ |p - q| over the (E, ν) plane: 0 for the same density, 1 for densities that do not meet.

    Raises:
        InvalidInput: different grids.
    """
    same = np.array_equal(one.grid.young, other.grid.young) and np.array_equal(one.grid.nu, other.grid.nu)
    if not same:
        raise InvalidInput(
            "grids of two posteriors", value="different points", expected="the same", remedy="Use one grid for both."
        )
    return float(0.5 * np.sum(np.abs(one.density - other.density) * one.grid.area))


@dataclass(frozen=True, eq=False)
class TruePosterior:
    """The posterior of the true model with its own errors.

    Args:
        posterior: the best one.
        field: the log-likelihood behind it.
        from_half_table: how far the one from the nested table of half the intervals is from it.
        from_half_field: how far the one from every second node of the log-likelihood is.
        from_half_grid: how far the one on half the panels is.
    """

    posterior: GridPosterior
    field: LogLikelihoodField
    from_half_table: Difference
    from_half_field: Difference
    from_half_grid: Difference


def true_posterior(
    table: FieldTable,
    likelihood: InterfaceLikelihood,
    space: ParameterSpace,
    *,
    rate: float | None = None,
    reading: Reading = "joint",
    nodes: tuple[int, int, int] = (97, 41, 33),
    panels: tuple[int, int, int] = (64, 32, 24),
    fields: tuple[LogLikelihoodField, LogLikelihoodField] | None = None,
) -> TruePosterior:
    """Return the posterior of the true model and what halving each of its three discretisations does to it.

    Args:
        table: of the interfaces.
        likelihood: with one observation.
        space: has E and nu, and V_in unless `rate` is given.
        rate: the fixed inflow rate.
        reading: of an uncertain inflow rate.
        nodes: of the log-likelihood.
        panels: of the quadrature, even.
        fields: the log-likelihood of `table` and of its halved one, where they are known: of `true_fields`.
    """
    field, coarse = fields or true_fields(table, likelihood, nodes=nodes, rate=rate)
    grid = product_grid(space, panels=panels, rate=rate)
    half_grid = product_grid(space, panels=(panels[0] // 2, panels[1] // 2, panels[2] // 2), rate=rate)

    def result(source: LogLikelihoodField, points: ProductGrid) -> GridPosterior:
        return posterior_on_grid(source, space, points, reading=reading, coordinates=table.coordinates)

    best = result(field, grid)
    return TruePosterior(
        posterior=best,
        field=field,
        from_half_table=compare(result(coarse, grid), best),
        from_half_field=compare(result(field.halved(), grid), best),
        from_half_grid=compare(result(field, half_grid), best),
    )


def true_fields(
    table: FieldTable,
    likelihood: InterfaceLikelihood,
    *,
    nodes: tuple[int, int, int] = (97, 41, 33),
    rate: float | None = None,
) -> tuple[LogLikelihoodField, LogLikelihoodField]:
    """Return the log-likelihood of a table and, on half the nodes, of its nested table of half the intervals."""
    fine = log_likelihood_field(table, likelihood, nodes=nodes, rate=rate)
    half = (nodes[0] // 2 + 1, nodes[1] // 2 + 1, nodes[2] // 2 + 1)
    return fine, log_likelihood_field(table.halved(), likelihood, nodes=half, rate=rate)
