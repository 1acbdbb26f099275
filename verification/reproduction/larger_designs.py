"""How many runs the surrogate of three inputs would need: Sobol designs far larger than the study's (study S5).

Even a design of ten thousand runs needs no forward run: the log-likelihoods of the true model are read from its field.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from verification.reproduction.grid_posterior import (
    Difference,
    GridPosterior,
    LogLikelihood,
    Reading,
    compare,
    posterior_on_grid,
    product_grid,
)
from verification.reproduction.log_likelihood_field import LogLikelihoodField

from strandline.design import sobol
from strandline.parameters import ParameterSpace
from strandline.surrogate import GaussianProcess, fit_log_likelihood
from strandline.surrogate.gaussian_process import condition

__all__ = [
    "FITTED", "LARGER", "MEAN_WITHIN", "READINGS", "SD_WITHIN", "LargerDesign", "larger_designs", "runs_to_find",
]  # fmt: skip

LARGER = (1000, 2000, 4000, 8000)
FITTED = 2000
"""Largest number of runs that the hyperparameters are fitted to; larger designs keep the hyperparameters."""
READINGS: tuple[Reading, ...] = ("joint", "cut")
PANELS = (24, 12, 8)
MEAN_WITHIN = 0.15
"""Largest error of a mean, in standard deviations, for a posterior to count as found."""
SD_WITHIN = 0.1


@dataclass(frozen=True, eq=False)
class LargerDesign:
    """The result of a design of `runs` points.

    Args:
        runs: Size of the design.
        succeeded: Number of points inside the table, which the surrogate is conditioned on.
        differences: Differences of the surrogate's posterior from the true one, by reading.
    """

    runs: int
    succeeded: int
    differences: Mapping[Reading, Difference]

    def found(self, reading: Reading) -> bool:
        """Return whether all means are within `MEAN_WITHIN` sd and all sds within a share `SD_WITHIN` of the truth."""
        off = self.differences[reading]
        return bool((np.abs(off.mean) <= MEAN_WITHIN).all() and (np.abs(off.sd_ratio) <= SD_WITHIN).all())


def larger_designs(
    field: LogLikelihoodField,
    truth: Mapping[Reading, GridPosterior],
    space: ParameterSpace,
    *,
    sizes: Sequence[int] = LARGER,
    fitted: int = FITTED,
    panels: tuple[int, int, int] = PANELS,
) -> tuple[LargerDesign, ...]:
    """Fit the study's surrogate to the true log-likelihood at more and more Sobol points and integrate its posterior.

    Args:
        field: Log-likelihood of the true model.
        truth: Posteriors of the true model, ``joint`` and ``cut``.
        space: Space of E, ν and V, in this order.
        sizes: Sizes of the designs, ascending.
        fitted: Largest number of runs that the hyperparameters are fitted to.
        panels: Number of panels of the quadrature of the surrogate in log E, ν and V.
    """
    x = space.to_physical(sobol(max(sizes), space.dim))
    values = field(x)
    ok = np.isfinite(values)
    first = fit_log_likelihood(x[ok][:fitted], values[ok][:fitted]).process
    grid = product_grid(space, panels=panels)
    designs = []
    for runs in sizes:
        inside = ok & (np.arange(len(x)) < runs)
        likelihood = _read_once(_within(field, _process(x[inside], values[inside], first)))
        differences = {
            reading: compare(posterior_on_grid(likelihood, space, grid, reading=reading), truth[reading])
            for reading in READINGS
        }
        designs.append(LargerDesign(runs, int(inside.sum()), differences))
    return tuple(designs)


def runs_to_find(designs: Sequence[LargerDesign], reading: Reading) -> int | None:
    """Return the smallest size from which on designs find the posterior of a reading; None if the last does not."""
    missed = [design.runs for design in designs if not design.found(reading)]
    return next((d.runs for d in designs if d.runs > max(missed, default=0)), None)


def _process(
    x: Float[np.ndarray, "run 3"], values: Float[np.ndarray, " run"], first: GaussianProcess
) -> GaussianProcess:
    """Return the surrogate of these runs, with the hyperparameters of `first` if it has no more runs.

    Length scales are in standard deviations of the inputs, which further Sobol points hardly change.
    """
    if len(x) < len(first.x_train):
        return fit_log_likelihood(x, values).process
    return condition(
        x,
        values,
        kernel=first.kernel,
        length_scale=first.length_scale,
        signal_variance=first.signal_variance,
        nugget=first.nugget,
    )


def _within(field: LogLikelihoodField, process: GaussianProcess) -> LogLikelihood:
    """Return the surrogate inside the table, -inf elsewhere."""

    def likelihood(x: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " point"]:
        values = np.full(len(x), -np.inf)
        inside = field.coordinates.inside(x)
        values[inside] = process.mean(x[inside])
        return values

    return likelihood


def _read_once(likelihood: LogLikelihood) -> LogLikelihood:
    """Return the same function; it keeps its values at the slices of a grid for a second reading."""
    kept: dict[bytes, Float[np.ndarray, " point"]] = {}

    def values(x: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " point"]:
        key = x[0].tobytes() + len(x).to_bytes(8, "little")
        if key not in kept:
            kept[key] = likelihood(x)
        return kept[key]

    return values
