"""The log-likelihood of tabulated interfaces on a fine grid, interpolated between its points by splines.

The grid is in the coordinates of the table, along which the ridge of the likelihood runs.
"""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float
from scipy.interpolate import NdBSpline, make_interp_spline
from verification.reproduction.field_table import FieldTable, LoadCoordinates

from strandline.discrepancy import squared_discrepancies
from strandline.interface import Interface
from strandline.likelihood import InterfaceLikelihood

__all__ = ["LogLikelihoodField", "log_likelihood_field", "spline_field"]

_SPLINE_DEGREE = 5


@dataclass(frozen=True, eq=False)
class LogLikelihoodField:
    """log L on the box of a table as a tensor spline; -inf outside it.

    Args:
        coordinates: Coordinates of the box.
        axes: Nodes of each box coordinate; with a single node the field is constant in it.
        values: log L at the nodes.
        spline: Spline through the values, over the coordinates with more than one node.
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
        table: Table of the interfaces.
        likelihood: Likelihood of one observation.
        nodes: Number of nodes in s, ν and V, at least 11 each (the halved field needs 6); odd numbers are nested.
        rate: Fixed inflow rate, which has one node; then `nodes[2]` is not used.
    """
    s, nu = (np.linspace(-1.0, 1.0, n) for n in nodes[:2])
    low, high = table.coordinates.rate
    fixed = None if rate is None else 2 * (rate - low) / (high - low) - 1
    rates = np.linspace(-1.0, 1.0, nodes[2]) if fixed is None else np.array([fixed])
    values = np.empty((len(s), len(nu), len(rates)))
    jax.config.update("jax_enable_x64", True)
    for i in range(len(s)):
        for k in range(len(rates)):
            shapes = table.on_grid(s[i : i + 1], nu, rates[k : k + 1])[0, :, 0]
            values[i, :, k] = _log_likelihood(likelihood, shapes)
    return spline_field(table.coordinates, (s, nu, rates), values)


def _log_likelihood(
    likelihood: InterfaceLikelihood, shapes: Float[np.ndarray, "run point 2"]
) -> Float[np.ndarray, " run"]:
    """Return log L of each polyline, without the constant."""
    (seen,) = likelihood.observations
    template = Interface.polyline(shapes[0])
    squares = squared_discrepancies(likelihood.discrepancy, shapes, template, seen.interface)
    return seen.noise.log_density(squares)


def spline_field(
    coordinates: LoadCoordinates,
    axes: tuple[Float[np.ndarray, " s"], Float[np.ndarray, " nu"], Float[np.ndarray, " rate"]],
    values: Float[np.ndarray, "s nu rate"],
) -> LogLikelihoodField:
    """Return the field through given values of log L.

    Args:
        coordinates: Coordinates of the box.
        axes: Equally spaced nodes from -1 to 1 in s, ν and V, at least six each, or one if the field is constant.
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
