"""Sobol' sensitivity indices: which inputs, alone or together, make a function vary under the prior."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import stats

from strandline.foundations import NumericsError
from strandline.parameters import ParameterSpace


@dataclass(frozen=True, eq=False)
class SobolIndices:
    """Shares of the variance of a function of independent inputs, with bootstrap intervals; each (dim,).

    `first` is the share that an input explains alone, `total` that which involves it, alone or together with others.
    """

    first: Float[np.ndarray, " dim"]
    first_low: Float[np.ndarray, " dim"]
    first_high: Float[np.ndarray, " dim"]
    total: Float[np.ndarray, " dim"]
    total_low: Float[np.ndarray, " dim"]
    total_high: Float[np.ndarray, " dim"]
    evaluations: int


def sobol_indices(
    function: Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, " point"]],
    space: ParameterSpace,
    *,
    number: int = 2048,
    seed: int = 1,
    level: float = 0.95,
    resamples: int = 200,
) -> SobolIndices:
    """Return first-order and total indices of `function` under the prior, by the estimators of Saltelli et al. (2010).

    For a log-likelihood they show what the data distinguish over the *whole* prior, above all in its far tail. The
    indices of the likelihood itself, a narrow peak, would be near 0 and 1, since only interactions are left. To see
    what the data say about an input, look at its marginal, not at these indices. The function of physical points gets
    (dim + 2) times `number` of them, a power of 2: two Sobol' samples and their mixtures. `level` is the probability of
    the bootstrap intervals, from so many resamples.

    Raises:
        NumericsError: the function does not vary under the prior, or is not finite.
    """

    rng = np.random.default_rng(seed)
    both = stats.qmc.Sobol(2 * space.dim, rng=rng).random(number)
    one, other = (space.prior_quantiles(sample) for sample in np.stack(np.split(both, 2, axis=1)))
    mixed = [np.where(np.arange(space.dim) == i, other, one) for i in range(space.dim)]  # a column from the other
    values = np.array([np.asarray(function(points), float) for points in (one, other, *mixed)])
    if not np.isfinite(values).all() or np.ptp(values[:2]) == 0.0:
        raise NumericsError(
            "the sensitivity indices of a function that is constant or not finite under the prior are undefined. "
            "Fix the function there."
        )
    first, total = _estimated(values)
    drawn = np.array([_estimated(values[:, rng.integers(number, size=number)]) for _ in range(resamples)])
    low, high = np.quantile(drawn, [0.5 * (1 - level), 0.5 * (1 + level)], axis=0)
    return SobolIndices(first, low[0], high[0], total, low[1], high[1], evaluations=values.size)


def _estimated(
    values: Float[np.ndarray, "evaluation point"],
) -> tuple[Float[np.ndarray, " dim"], Float[np.ndarray, " dim"]]:
    known = {"f_A": values[:1], "f_B": values[1:2], "f_AB": values[2:, None]}
    found = stats.sobol_indices(func=known, n=values.shape[1])
    return np.ravel(found.first_order), np.ravel(found.total_order)
