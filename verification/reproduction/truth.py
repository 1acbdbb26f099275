"""The posterior of the true model by quadrature: the log-likelihood of tabulated interfaces, integrated on a grid.

No surrogate of the log-likelihood is fitted to scattered runs. Interfaces come from a `FieldTable`, their measure is
evaluated on a fine tensor grid in the coordinates of that table, along which the ridge of the likelihood runs, and
splines of the fifth degree interpolate it to a product grid of Gauss points in (log E, ν, V). Another prior, fixed
inflow rate or reading of an uncertain one needs no new evaluation of the measure.
"""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float
from scipy.interpolate import NdBSpline, make_interp_spline
from verification.reproduction.field_table import FieldTable, LoadCoordinates
from verification.reproduction.grid_posterior import (
    Difference,
    GridPosterior,
    Reading,
    compare,
    posteriors_on_grid,
    product_grid,
)

from strandline.discrepancy import squared_discrepancies
from strandline.interface import Interface
from strandline.likelihood import InterfaceLikelihood
from strandline.parameters import ParameterSpace

_SPLINE_DEGREE = 5
NODES = (97, 41, 33)
"""Nodes of the log-likelihood in load, ν and V."""


@dataclass(frozen=True, eq=False)
class LogLikelihoodField:
    """log L on the box of a table as a tensor spline over the coordinates with more than one node; -inf outside it."""

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
    table: FieldTable,
    likelihood: InterfaceLikelihood,
    *,
    nodes: tuple[int, int, int] = NODES,
    rate: float | None = None,
) -> LogLikelihoodField:
    """Return the log-likelihood of one observed polyline, without its constant, on equally spaced nodes in s, ν and V.

    There are at least 11 each (the halved field needs 6); odd numbers are nested. A fixed rate has one node.
    """
    s, nu = (np.linspace(-1.0, 1.0, n) for n in nodes[:2])
    low, high = table.coordinates.rate
    rates = np.linspace(-1.0, 1.0, nodes[2]) if rate is None else np.array([2 * (rate - low) / (high - low) - 1])
    values = np.empty((len(s), len(nu), len(rates)))
    (seen,) = likelihood.observations
    jax.config.update("jax_enable_x64", True)
    for i in range(len(s)):
        for k in range(len(rates)):
            shapes = table.on_grid(s[i : i + 1], nu, rates[k : k + 1])[0, :, 0]
            template = Interface.polyline(shapes[0])
            squares = squared_discrepancies(likelihood.discrepancy, shapes, template, seen.interface)
            values[i, :, k] = seen.noise.log_density(squares)
    return spline_field(table.coordinates, (s, nu, rates), values)


def spline_field(
    coordinates: LoadCoordinates,
    axes: tuple[Float[np.ndarray, " s"], Float[np.ndarray, " nu"], Float[np.ndarray, " rate"]],
    values: Float[np.ndarray, "s nu rate"],
) -> LogLikelihoodField:
    """Return the field through values of log L at equally spaced nodes, at least six in a coordinate, or one."""
    coefficients, knots = values, []
    for k, axis in enumerate(axes):
        if len(axis) > 1:
            line = make_interp_spline(axis, np.moveaxis(coefficients, k, 0), k=_SPLINE_DEGREE)
            coefficients = np.moveaxis(line.c, 0, k)
            knots.append(line.t)
    squeezed = np.ascontiguousarray(coefficients.reshape([len(axis) for axis in axes if len(axis) > 1]))
    return LogLikelihoodField(coordinates, axes, values, NdBSpline(tuple(knots), squeezed, k=_SPLINE_DEGREE))


def true_fields(
    table: FieldTable, likelihood: InterfaceLikelihood, *, nodes: tuple[int, int, int], rate: float | None = None
) -> tuple[LogLikelihoodField, LogLikelihoodField]:
    """Return the log-likelihood of a table and, on half the nodes, that of its nested table of half the intervals."""
    half = (nodes[0] // 2 + 1, nodes[1] // 2 + 1, nodes[2] // 2 + 1)
    fine = log_likelihood_field(table, likelihood, nodes=nodes, rate=rate)
    return fine, log_likelihood_field(table.halved(), likelihood, nodes=half, rate=rate)


@dataclass(frozen=True, eq=False)
class TruePosterior:
    """The posterior of the true model, its log-likelihood, and its difference from coarser discretisations.

    Those are the nested table of half the intervals, and every second node of the log-likelihood.
    """

    posterior: GridPosterior
    field: LogLikelihoodField
    from_half_table: Difference
    from_half_field: Difference


def true_posteriors(
    fields: tuple[LogLikelihoodField, LogLikelihoodField],
    space: ParameterSpace,
    *,
    rate: float | None = None,
    panels: tuple[int, int, int] = (64, 32, 24),
) -> dict[Reading, TruePosterior]:
    """Return the posterior of the true model in both readings of an uncertain inflow rate; the same for a fixed `rate`.

    The fields are those of a table and of its halved table; `panels` of the quadrature are in log E, ν and V.
    """
    fine, coarse = fields
    grid = product_grid(space, panels=panels, rate=rate)
    best, *halves = (
        posteriors_on_grid(field, space, grid, coordinates=fine.coordinates) for field in (fine, coarse, fine.halved())
    )
    return {
        reading: TruePosterior(found, fine, *(compare(half[reading], found) for half in halves))
        for reading, found in best.items()
    }


def true_posterior(
    table: FieldTable, likelihood: InterfaceLikelihood, space: ParameterSpace, *, rate: float | None = None
) -> TruePosterior:
    """Return the posterior of the true model, which the data let update an uncertain inflow rate."""
    return true_posteriors(true_fields(table, likelihood, nodes=NODES, rate=rate), space, rate=rate)["joint"]
