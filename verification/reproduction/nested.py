"""The gain from more forward runs: surrogates of nested designs against the true posterior (study S2, Fig. 8).

A Sobol design of n points starts with every smaller one, so the runs of the largest design are enough for all.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from verification.reproduction.grid_posterior import (
    Difference,
    GridPosterior,
    LogLikelihood,
    compare,
    posterior_on_grid,
)

from strandline.errors import InvalidInput
from strandline.parameters import ParameterSpace
from strandline.surrogate import GaussianProcess, LogLikelihoodSurrogate, fit_log_likelihood

__all__ = ["SIZES", "NestedDesign", "NestedStep", "maximum_likelihood", "nested_surrogates", "two_inputs"]

SIZES = (50, 100, 200, 400, 700, 1000)


@dataclass(frozen=True, eq=False)
class NestedDesign:
    """The outcome of a design of two inputs, in its order.

    Args:
        x: (E, ν) of all runs, including the failed ones.
        log_likelihoods: Log-likelihood of each run (run,), NaN if it failed.
    """

    x: Float[np.ndarray, "run 2"]
    log_likelihoods: Float[np.ndarray, " run"]

    @property
    def ok(self) -> Bool[np.ndarray, " run"]:
        """Which runs have an interface."""
        return np.asarray(np.isfinite(self.log_likelihoods))

    def first(self, runs: int) -> "NestedDesign":
        """Return the design of the first `runs` runs of this one.

        Raises:
            InvalidInput: It has fewer runs than that.
        """
        if not 0 < runs <= len(self.x):
            raise InvalidInput(
                "size of a nested design",
                value=runs,
                expected=f"1 to {len(self.x)}, the runs of the largest one",
                remedy="Make more runs, or leave this size out.",
            )
        return NestedDesign(self.x[:runs], self.log_likelihoods[:runs])


@dataclass(frozen=True, eq=False)
class NestedStep:
    """The result of the first `runs` points of the design.

    Args:
        runs: Size of the design.
        succeeded: Number of runs that the surrogate was fitted to.
        surrogate: Surrogate of the log-likelihood.
        posterior: Posterior of the surrogate by quadrature on the grid of the truth, without sampling noise.
        difference: Difference of that posterior from the truth; its total variation is the actual error.
        maximum_likelihood: (E, ν) at the maximum of the surrogate in the box.
        loo_rms_near_mode: Leave-one-out error of the runs near the mode, which a user sees without knowing the truth.
        near_mode: Number of runs near the mode.
    """

    runs: int
    succeeded: int
    surrogate: LogLikelihoodSurrogate
    posterior: GridPosterior
    difference: Difference
    maximum_likelihood: Float[np.ndarray, "2"]
    loo_rms_near_mode: float
    near_mode: int

    @property
    def total_variation(self) -> float:
        """½ ∫ |p - q| between the posterior of the surrogate and the true one."""
        assert self.difference.total_variation is not None
        return self.difference.total_variation


def nested_surrogates(
    design: NestedDesign,
    truth: GridPosterior,
    space: ParameterSpace,
    *,
    sizes: Sequence[int] = SIZES,
    kernel: str = "matern32",
) -> tuple[NestedStep, ...]:
    """Fit the surrogate to each of the nested designs and measure its posterior against the truth.

    Args:
        design: The largest design.
        truth: True posterior on a grid of (E, ν) at the fixed inflow rate of the design.
        space: Space of E and ν, in this order.
        sizes: Sizes of the nested designs.
        kernel: Kernel of the surrogate, a name in `KERNELS`.

    Raises:
        InvalidInput: A size is larger than the design.
        TooFewRuns: Too few of the first runs succeeded.
    """
    return tuple(_step(design.first(runs), truth, space, kernel) for runs in sizes)


def _step(design: NestedDesign, truth: GridPosterior, space: ParameterSpace, kernel: str) -> NestedStep:
    x, values = design.x[design.ok], design.log_likelihoods[design.ok]
    surrogate = fit_log_likelihood(x, values, kernel=kernel)
    posterior = posterior_on_grid(two_inputs(surrogate.process), space, truth.grid)
    return NestedStep(
        runs=len(design.x),
        succeeded=len(x),
        surrogate=surrogate,
        posterior=posterior,
        difference=compare(posterior, truth),
        maximum_likelihood=maximum_likelihood(surrogate.process, x[np.argmax(values)], space),
        loo_rms_near_mode=surrogate.validation.loo_rms_near_mode,
        near_mode=surrogate.validation.near_mode_count,
    )


def two_inputs(process: GaussianProcess) -> LogLikelihood:
    """Return a surrogate over (E, ν) as a log-likelihood over (E, ν, V), to be used at the V of its runs."""
    return lambda x: process.mean(np.ascontiguousarray(x[:, :2]))


def maximum_likelihood(
    process: GaussianProcess, best_run: Float[np.ndarray, "2"], space: ParameterSpace
) -> Float[np.ndarray, "2"]:
    """Return the point of the box with the largest mean of the surrogate, by grids narrowed around the best point."""
    low, high = space.low, space.high
    best, reach = best_run, 0.5 * (high - low)
    centre, points = 0.5 * (low + high), 201
    for _ in range(5):
        axes = [
            np.linspace(max(a, c - r), min(b, c + r), points)
            for a, b, c, r in zip(low, high, centre, reach, strict=True)
        ]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        candidates = np.concatenate([grid, best[None]])
        best = candidates[np.argmax(process.mean(candidates))]
        centre, reach, points = best, reach / 25, 41
    return np.asarray(best)
