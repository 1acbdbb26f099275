"""The gain from more forward runs: surrogates of larger and larger designs, against the truth.

A Sobol design of n points starts with every smaller one, so the runs of the largest design are enough for all. Nested
designs of two inputs (study S2, Fig. 8) and larger designs of three (S5) are compared with true posteriors; the latter
need no forward run, since the log-likelihoods of the true model are read from its field. In seven inputs (S6, Remark 9
and Fig. 12) there is no true posterior, only errors at test points.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp
from verification.reproduction.grid_posterior import (
    Difference,
    GridPosterior,
    Reading,
    compare,
    posterior_on_grid,
    posteriors_on_grid,
    product_grid,
    total_variation,
)
from verification.reproduction.truth import LogLikelihoodField

from strandline.design import sobol
from strandline.foundations import InvalidInput
from strandline.parameters import ParameterSpace
from strandline.surrogate import GaussianProcess, LogLikelihoodSurrogate, fit_log_likelihood
from strandline.surrogate.gaussian_process import condition

NESTED, SEVEN_INPUTS = (50, 100, 200, 400, 700, 1000), (100, 200, 500, 1000, 2000, 5000)
"""Training sizes of Fig. 8 and Fig. 12."""
LARGER = (1000, 2000, 4000, 8000)
FITTED = 2000
"""Largest number of runs that the hyperparameters are fitted to; larger designs keep the hyperparameters."""
READINGS: tuple[Reading, ...] = ("joint", "cut")
PANELS = (24, 12, 8)
MEAN_WITHIN = 0.15
"""Largest error of a mean, in standard deviations, for a posterior to count as found."""
SD_WITHIN = 0.1


@dataclass(frozen=True, eq=False)
class NestedStep:
    """The surrogate from the first runs of a design, of which `succeeded` did not fail.

    `total_variation` is between its posterior by quadrature and the true one, `maximum_likelihood` is (E, ν) at the
    maximum of the surrogate in the box.
    """

    runs: int
    succeeded: int
    surrogate: LogLikelihoodSurrogate
    total_variation: float
    maximum_likelihood: Float[np.ndarray, "2"]


def nested_surrogates(
    x: Float[np.ndarray, "run 2"],
    log_likelihoods: Float[np.ndarray, " run"],
    truth: GridPosterior,
    space: ParameterSpace,
    *,
    sizes: Sequence[int],
) -> tuple[NestedStep, ...]:
    """Fit the surrogate to each of the nested designs and measure its posterior against the truth.

    `x` are the (E, ν) of all runs of the largest design; the log-likelihoods of failed ones are NaN. The truth is at
    the fixed inflow rate of the design.
    """
    _require_runs(sizes, len(x))
    steps = []
    for runs in sizes:
        ok = np.isfinite(log_likelihoods[:runs])
        inputs, values = x[:runs][ok], log_likelihoods[:runs][ok]
        surrogate = fit_log_likelihood(inputs, values)
        process = surrogate.process
        found = posterior_on_grid(lambda x, p=process: p.mean(np.ascontiguousarray(x[:, :2])), space, truth.grid)
        best = _maximum_likelihood(process, inputs[np.argmax(values)], space)
        steps.append(NestedStep(runs, len(inputs), surrogate, total_variation(found, truth), best))
    return tuple(steps)


def _maximum_likelihood(
    process: GaussianProcess, best_run: Float[np.ndarray, "2"], space: ParameterSpace
) -> Float[np.ndarray, "2"]:
    """Return the point of the box with the largest mean of the surrogate, by grids narrowed around the best point."""
    low, high, best, points, reach = space.low, space.high, best_run, 201, 0.02 * (space.high - space.low)
    for _ in range(5):
        axes = np.linspace(low, high, points, axis=1)
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        candidates = np.concatenate([grid, best[None]])
        best = candidates[np.argmax(process.mean(candidates))]
        low, high = np.maximum(best - reach, space.low), np.minimum(best + reach, space.high)
        points, reach = 41, reach / 25
    return np.asarray(best)


@dataclass(frozen=True, eq=False)
class LargerDesign:
    """How far the posterior from a design is from the true one; `succeeded` of its points are inside the table."""

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
    sizes: Sequence[int],
    panels: tuple[int, int, int] = PANELS,
) -> tuple[LargerDesign, ...]:
    """Fit the study's surrogate to the true log-likelihood at more and more Sobol points and integrate its posterior.

    A design of more than `FITTED` runs keeps the hyperparameters of its first ones: length scales are in standard
    deviations of the inputs, which further Sobol points hardly change. `panels` of the quadrature are in log E, ν, V.
    """
    x = space.to_physical(sobol(max(sizes), space.dim))
    values = field(x)
    ok = np.isfinite(values)
    first = fit_log_likelihood(x[ok][:FITTED], values[ok][:FITTED]).process
    kept = {"kernel": first.kernel, "length_scale": first.length_scale}
    kept |= {"signal_variance": first.signal_variance, "nugget": first.nugget}
    grid = product_grid(space, panels=panels)
    designs = []
    for runs in sizes:
        used = ok & (np.arange(len(x)) < runs)
        few = used.sum() < len(first.x_train)
        process = fit_log_likelihood(x[used], values[used]).process if few else condition(x[used], values[used], **kept)

        posteriors = posteriors_on_grid(partial(_inside, field, process), space, grid)
        differences = {reading: compare(posteriors[reading], truth[reading]) for reading in READINGS}
        designs.append(LargerDesign(runs, int(used.sum()), differences))
    return tuple(designs)


def _inside(
    field: LogLikelihoodField, process: GaussianProcess, points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, " point"]:
    """Return the mean of a surrogate, -inf outside the table of the true model."""
    inside = field.coordinates.inside(points)
    found = np.full(len(points), -np.inf)
    found[inside] = process.mean(points[inside])
    return found


def runs_to_find(designs: Sequence[LargerDesign], reading: Reading) -> int | None:
    """Return the smallest size from which on designs find the posterior of a reading; None if the last does not."""
    missed = [design.runs for design in designs if not design.found(reading)]
    return next((d.runs for d in designs if d.runs > max(missed, default=0)), None)


@dataclass(frozen=True, eq=False)
class Convergence:
    """Relative L² errors of the surrogate's mean m at test points, ‖m - 𝓛‖ / ‖𝓛‖ and ‖exp m - L‖ / ‖L‖, by size."""

    sizes: tuple[int, ...]
    log_likelihood: tuple[float, ...]
    likelihood: tuple[float, ...]


def convergence_study(
    x: Float[np.ndarray, "run dim"],
    log_likelihood: Float[np.ndarray, " run"],
    x_test: Float[np.ndarray, "point dim"],
    log_likelihood_test: Float[np.ndarray, " point"],
    *,
    sizes: Sequence[int],
    kernel: str = "matern32",
) -> Convergence:
    """Fit surrogates to more and more of the first runs, and compare each with the truth at the test points.

    Runs are in the order of the Sobol sequence, without failed ones; test points come from later in it, the study takes
    100. Inputs are physical; `kernel` is a name in `KERNELS`.
    """
    _require_runs(sizes, len(x))
    means = [fit_log_likelihood(x[:n], log_likelihood[:n], kernel=kernel).process.mean(x_test) for n in sizes]
    return Convergence(
        tuple(sizes),
        tuple(relative_error(mean, log_likelihood_test) for mean in means),
        tuple(relative_error_of_exponentials(mean, log_likelihood_test) for mean in means),
    )


def relative_error(found: Float[np.ndarray, " point"], truth: Float[np.ndarray, " point"]) -> float:
    """Return ‖found - truth‖ / ‖truth‖."""
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def relative_error_of_exponentials(found: Float[np.ndarray, " point"], truth: Float[np.ndarray, " point"]) -> float:
    """Return ‖exp found - exp truth‖ / ‖exp truth‖, whatever the size of the exponents; inf if it overflows."""
    top = max(found.max(), truth.max())
    difference = float(np.linalg.norm(np.exp(found - top) - np.exp(truth - top)))
    if difference == 0:
        return 0.0
    with np.errstate(over="ignore"):
        return float(np.exp(np.log(difference) - 0.5 * logsumexp(2 * (truth - top))))


def _require_runs(sizes: Sequence[int], runs: int) -> None:
    if max(sizes) > runs:
        remedy, expected = "Make more runs, or leave some sizes out.", f"none above {runs}, the number of runs"
        raise InvalidInput("numbers of training runs", value=list(sizes), expected=expected, remedy=remedy)
