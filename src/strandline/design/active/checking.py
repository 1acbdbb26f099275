"""Whether the true model at draws of a posterior confirms it: after a few draws if they leave no doubt, else after all.

The first draws are probes: of many draws those that lie farthest apart, so that tails are tried before anything is
settled. A parabola through the logarithms of true over expected likelihood bounds how far means and standard deviations
would move, see `strandline.design.active.parabola`; the error probability is shared out over all looks. Earlier runs
near the posterior, each predicted from all others, join the parabola: their errors are at least as large. If the bounds
never settle it, the importance weights of all draws but the probes do.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist
from scipy.stats import t

from strandline.design.active.parabola import FREEDOM, Effect, LogRatios, fewest, smooth_effect
from strandline.posterior import NEARLY_EQUAL, Reweighting, largest_usual_k_hat, reweight

FEWEST_DRAWS = 8
"""Fewest draws that can settle anything without earlier runs."""
FEWEST_BESIDES = 2
"""Fewest probes besides two for each input, whatever the number of earlier runs."""
POOL = 200
"""Draws from which the probes are picked."""
ERROR_PROBABILITY, FIRST = 0.05, 0.5
"""Probability that an early verdict is wrong, over all looks together; share of it that the first look has."""
LIKELY = 0.05
"""Probability that each objection of the parabola to all draws is wrong: it has seen tails that the others may miss."""
LEVEL = 0.995
"""Typical probability with which a bound holds: it tells how bounds shrink with more draws."""
GROWTH = 0.25
"""Share by which the draws of a check grow from one look to the next."""
FEWEST_WHOLE = 18
"""Fewest draws besides the probes whose importance weights count."""
MOST_FAILED, MOST_EARLY = 0.1, 3
"""Share of draws whose run may fail; number from which a check ends early because of them."""


@dataclass(frozen=True)
class Tolerances:
    """What a check tolerates: the shift of a mean, in standard deviations; the change of the logarithm of a standard
    deviation; the Pareto shape of the weights, unless nearly all draws are effective or as few normal weights often
    have a larger one; the share of draws that must be effective.
    """

    shift: float
    width: float
    k_hat: float
    effective: float


@dataclass(frozen=True, eq=False)
class BatchCheck:
    """The true model at draws of the posterior, of which some failed: they are left out of the weights.

    `reweighting` is by the draws whose run succeeded, and by the earlier runs if these settled it. It `passed` if all
    figures are within the tolerances; else `reasons` name those outside. `early` tells whether it was settled before
    the last draws, `left_out` how many earlier runs helped to settle it, each predicted from all others, `given_up`
    whether it ended early because all its draws would hardly have settled it.
    """

    draws: int
    failed: int
    reweighting: Reweighting | None
    passed: bool
    reasons: tuple[str, ...]
    early: bool = False
    left_out: int = 0
    given_up: bool = False


def number_of_probes(dim: int, left_out: int = 0) -> int:
    """Return the number of probes: as many as the effect of a smooth error needs besides earlier runs.

    They are at least eight without earlier runs, and reach into the tails of each input in any case.
    """
    alone = max(FEWEST_DRAWS, fewest(dim))
    return min(alone, max(alone - left_out, 2 * dim + FEWEST_BESIDES))


def probes(draws: Float[np.ndarray, "draw dim"], number: int) -> Int[np.ndarray, " probe"]:
    """Return the indices of draws that lie far apart: each is the farthest from those before.

    The first one is the nearest to the mean. Distances are in standard deviations.
    """
    z = (draws - draws.mean(axis=0)) / np.maximum(draws.std(axis=0), np.finfo(float).tiny)
    first = int(np.argmin((z**2).sum(axis=1)))
    nearest = cdist(z, z[first : first + 1])[:, 0]
    nearest[first] = -1.0
    return np.array([first, *islice(farthest_first(z, nearest), max(number - 1, 0))])


def farthest_first(points: Float[np.ndarray, "point dim"], nearest: Float[np.ndarray, " point"]) -> Iterator[int]:
    """Yield the indices of points, each the farthest from those before and from others.

    `nearest` is the distance of each to the nearest of the others; below 0 for a point that is not wanted.
    """
    while nearest.max(initial=-1.0) >= 0:
        farthest = int(np.argmax(nearest))
        yield farthest
        nearest = np.minimum(nearest, cdist(points, points[farthest : farthest + 1])[:, 0])
        nearest[farthest] = -1.0


def looks(fewest: int, most: int, batch: int) -> tuple[int, ...]:
    """Return after how many draws the verdict is sought, if they come in batches of this size.

    They grow by a quarter each time: more looks would leave less of the error probability for each.
    """
    ends, step = [fewest], max(batch, 2)
    while ends[-1] < most:
        ends.append(min(ends[-1] + step * math.ceil(GROWTH * ends[-1] / step), most))
    return tuple(ends)


def error_probability(look: int, looks: int) -> float:
    """Return the probability that the verdict of one look may be wrong. The first look has half of the total."""
    if looks == 1:
        return ERROR_PROBABILITY
    return ERROR_PROBABILITY * (FIRST if look == 0 else (1 - FIRST) / (looks - 1))


def verdict(
    draws: LogRatios,
    posterior: Float[np.ndarray, "particle dim"],
    tolerances: Tolerances,
    *,
    probing: int,
    level: float,
    last: bool,
    left_out: LogRatios | None = None,
    typical: float = 0.0,
    scatter: float = 0.0,
    most: int | None = None,
) -> BatchCheck | Literal["open"]:
    """Return the verdict of the draws so far, or that more are needed.

    Draws count by their expected variances for the bounds that confirm a posterior, but equally for those that object:
    the surrogate may expect errors in a tail that it has missed.

    The first `probing` draws are probes, the others have equal weight, as the many draws `posterior` have. Unless it is
    the `last` one, the verdict is wrong with the probability `level`, see `error_probability`. `left_out` are earlier
    runs near the posterior, each predicted from all others: they can confirm it, but not object, since they are
    predicted with fewer runs than the posterior has. `typical` is the mean variance of the log ratios that the
    surrogate expects over the posterior, `scatter` that by the simulator's own scatter, which the bounds allow for. The
    importance weights of all draws do not: they are certain of shifts only if they are nearly equal. A check is given
    up if `most` draws would hardly settle it; None: it never is.
    """
    good, number, dim = ~np.isnan(draws.values), len(draws), draws.x.shape[1]
    kept, failed = draws[good], int((~good).sum())
    found = reweight(kept.x, kept.values) if len(kept) >= FEWEST_DRAWS else None

    def ended(reasons: tuple[str, ...], weights: Reweighting | None = found) -> BatchCheck:
        return BatchCheck(number, failed, weights, not reasons, reasons, early=not last)

    if failed > max(1.0, MOST_FAILED * number) and (last or failed > MOST_EARLY):
        return ended((f"{failed} of the check's {number} runs failed, more than {MOST_FAILED:.0%}",))
    excluded = not np.isfinite(kept.values).all()
    alike = replace(kept, variances=np.zeros(len(kept)))
    so_far: list[tuple[Effect, int]] = []
    if left_out is not None and len(left_out):
        level /= 2
        both = left_out.joined(kept)
        if not excluded and len(kept) > 2 * dim and len(both) >= fewest(dim):
            effect = smooth_effect(both, posterior, level, scatter=scatter, typical=typical)
            if within(effect, tolerances):
                return replace(ended((), reweight(both.x, both.values)), left_out=len(left_out))
            so_far.append((effect, len(both)))
    if found is None or len(kept) < fewest(dim):
        if last:
            return ended((f"only {len(kept)} of {number} runs of the check succeeded",))
    elif excluded:
        return ended(objections(found, tolerances) or ("the true model excludes draws of the posterior",))
    else:
        effect = smooth_effect(kept, posterior, level, scatter=scatter, typical=typical)
        if within(effect, tolerances):
            return ended(())
        if surely := _beyond(smooth_effect(alike, posterior, level, scatter=scatter), tolerances):
            return ended(surely)
        so_far.append((effect, len(kept)))
    if not last:
        if most is None or _may_settle(so_far, most - number, dim, tolerances):
            return "open"
        reason = f"{number} draws leave the check open, and {most} would hardly settle it"
        return replace(ended((reason,)), early=False, given_up=True)
    assert found is not None  # fewer draws have ended it
    equal = draws[good & (np.arange(number) >= probing)]
    if len(equal) < FEWEST_WHOLE:
        return ended((*objections(found, tolerances), f"{number} runs at draws of the posterior do not settle it"))
    whole, likely = reweight(equal.x, equal.values), smooth_effect(alike, posterior, LIKELY, scatter=scatter)
    return ended(objections(whole, tolerances) or _beyond(likely, tolerances), whole)


def within(effect: Effect, tolerances: Tolerances) -> bool:
    """Return whether all upper bounds are within the tolerances."""
    return (
        effect.shift_bounds[1] <= tolerances.shift
        and effect.width_bounds[1] <= tolerances.width
        and effect.effective_bounds[0] >= tolerances.effective
    )


def _may_settle(so_far: Sequence[tuple[Effect, int]], more: int, dim: int, tolerances: Tolerances) -> bool:
    """Return whether one of some effects, each of so many draws, may be within the tolerances after more draws.

    Bounds shrink with the root of the degrees of freedom, and as quantiles of Student's t distribution do.
    """
    for effect, number in so_far:
        free = number - (fewest(dim) - FREEDOM)
        before, after = t.ppf(LEVEL, [free, free + more])
        shrinks = math.sqrt(free / (free + more)) * after / before
        bounds = shrinks * effect.shift_bounds[1], shrinks * effect.width_bounds[1]
        if bounds[0] <= tolerances.shift and bounds[1] <= tolerances.width:
            return True
    return not so_far


def _beyond(effect: Effect, tolerances: Tolerances) -> tuple[str, ...]:
    """Return which lower bounds are beyond the tolerances, in words."""
    out = []
    if effect.shift_bounds[0] > tolerances.shift:
        out.append(
            f"the true model moves a mean by {effect.shift:.2g} standard deviations, more than {tolerances.shift:g}"
        )
    if effect.width_bounds[0] > tolerances.width:
        out.append(f"the true model changes a standard deviation by {math.expm1(effect.width):.0%}")
    if effect.effective_bounds[1] < tolerances.effective:
        out.append(
            f"at most {effect.effective_bounds[1]:.0%} of the draws are effective, not {tolerances.effective:.0%}"
        )
    return tuple(out)


def objections(found: Reweighting, tolerances: Tolerances) -> tuple[str, ...]:
    """Return what the weights of all draws object to, in words."""
    number = len(found.smoothed.log_weights)
    share, beyond = found.smoothed.ess / number, np.abs(found.shift) - found.shift_error
    width, out = np.abs(np.log(np.maximum(found.sd_ratio, 1e-300))), []
    heavy = found.smoothed.k_hat >= tolerances.k_hat and share < NEARLY_EQUAL
    if heavy and found.smoothed.k_hat > largest_usual_k_hat(found.smoothed.log_weights):
        out.append(f"Pareto k̂ is {found.smoothed.k_hat:.2f}, not below {tolerances.k_hat:g}")
    if beyond.max() >= tolerances.shift:
        worst = float(np.abs(found.shift[beyond.argmax()]))
        out.append(f"importance weights move a mean by {worst:.2f} standard deviations, more than {tolerances.shift:g}")
    if width.max() >= tolerances.width:
        ratio = float(found.sd_ratio[width.argmax()])
        out.append(
            f"importance weights multiply a standard deviation by {ratio:.2f}, more than {tolerances.width:g} in its "
            "logarithm"
        )
    if share < tolerances.effective:
        out.append(
            f"the effective sample size of the weights is {share:.0%} of the draws, not {tolerances.effective:.0%}"
        )
    return tuple(out)
