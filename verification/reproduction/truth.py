"""The posterior of the true model by quadrature: the log-likelihood of tabulated interfaces, integrated on a grid.

No surrogate of the log-likelihood is fitted to scattered runs. Interfaces come from a `FieldTable`, their measure is
evaluated on a fine tensor grid in the coordinates of that table, along which the ridge of the likelihood runs, and
splines of the fifth degree interpolate it to a product grid of Gauss points in (log E, ν, V). Another prior, fixed
inflow rate or reading of an uncertain one needs no new evaluation of the measure.
"""

from dataclasses import dataclass

from verification.reproduction.field_table import FieldTable
from verification.reproduction.grid_posterior import (
    Difference,
    GridPosterior,
    ProductGrid,
    Reading,
    compare,
    posterior_on_grid,
    product_grid,
)
from verification.reproduction.log_likelihood_field import LogLikelihoodField, log_likelihood_field

from strandline.likelihood import InterfaceLikelihood
from strandline.parameters import ParameterSpace

__all__ = ["TruePosterior", "true_fields", "true_posterior"]


@dataclass(frozen=True, eq=False)
class TruePosterior:
    """The posterior of the true model with its own errors.

    Args:
        posterior: Posterior with the finest discretisation.
        field: Log-likelihood behind it.
        from_half_table: Difference of the posterior from the nested table of half the intervals.
        from_half_field: Difference of the posterior from every second node of the log-likelihood.
        from_half_grid: Difference of the posterior on half the panels.
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
    """Return the posterior of the true model and the effect of halving each of its three discretisations.

    Args:
        table: Table of the interfaces.
        likelihood: Likelihood of one observation.
        space: Space of E and nu, and of V_in unless `rate` is given.
        rate: Fixed inflow rate, mm²/s.
        reading: Reading of an uncertain inflow rate.
        nodes: Number of nodes of the log-likelihood in s, ν and V.
        panels: Number of panels of the quadrature in log E, ν and V, even.
        fields: Log-likelihoods of `table` and of its halved table from `true_fields`, if already known.
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
    """Return the log-likelihood of a table and, on half the nodes, that of its nested table of half the intervals."""
    fine = log_likelihood_field(table, likelihood, nodes=nodes, rate=rate)
    half = (nodes[0] // 2 + 1, nodes[1] // 2 + 1, nodes[2] // 2 + 1)
    return fine, log_likelihood_field(table.halved(), likelihood, nodes=half, rate=rate)
