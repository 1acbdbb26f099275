"""Whether the true model at draws of a posterior confirms it, after as few draws as leave no doubt.

The first draws are probes: of many draws some that reach into all tails, so that these are tried before anything is
settled. The design learns from each batch at once, and the next is drawn from the posterior that has learnt; draws
before it count with their errors when all other runs predict them, which are at least as large. The check passes once
the spread of the logarithms δ of true over expected likelihood, of all draws or of those that are no probes, is surely
within the tolerance of a shift: weights exp(δ) then move no mean by more sds, in however many dimensions. Else a
parabola through δ bounds how far means and standard deviations would move; earlier runs near the posterior join it. The
error probability is shared out over all looks. If the bounds never settle it, the importance weights of all draws but
the probes do.

The parabola is δ = a + Σ (b_k y_k + c_k y_k²) along the principal axes y of the posterior, or along the inputs if that
fits better, plus independent errors; in up to three dimensions a whole quadratic function. Draws at which the surrogate
is less sure may count less. The coefficients have Student's t distribution around their least-squares estimate.
Weights exp(δ) of many draws then show how far each mean and each standard deviation would move.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.distance import cdist
from scipy.stats import chi2

from strandline.posterior import NEARLY_EQUAL, Reweighting, largest_usual_k_hat, reweight

SAMPLES = 400  # sets of coefficients drawn
FREEDOM = 3  # degrees of freedom that must be left
WHOLE = 3  # largest dimension with products of the axes
ROUGH = 0.1  # standard deviation added to every expected one, so that no draw counts far more than all others
_SEED = 5
Particles = Float[np.ndarray, "particle dim"]
Values = Float[np.ndarray, " draw"]
Point = Float[np.ndarray, " dim"]


@dataclass(frozen=True, eq=False)
class LogRatios:
    """Logarithms δ of true over expected likelihood at some inputs, up to a constant; NaN if a run failed.

    `variances` of δ are those that the surrogate expects; a common factor hardly matters.
    """

    x: Float[np.ndarray, "run dim"]
    values: Float[np.ndarray, " run"]
    variances: Float[np.ndarray, " run"]

    def __getitem__(self, some: Bool[np.ndarray, " run"]) -> "LogRatios":
        return LogRatios(self.x[some], self.values[some], self.variances[some])

    def __len__(self) -> int:
        return len(self.x)

    def joined(self, other: "LogRatios") -> "LogRatios":
        parts = ((self.x, other.x), (self.values, other.values), (self.variances, other.variances))
        return LogRatios(*(np.concatenate(part) for part in parts))


@dataclass(frozen=True, eq=False)
class Effect:
    """How far the posterior would move, with lower and upper bounds that hold with a given probability each.

    `shift` is the largest shift of a mean, in standard deviations, `width` the largest change of the logarithm of a
    standard deviation; of the effective share of draws, there are the bounds alone.
    """

    shift: float
    shift_bounds: tuple[float, float]
    width: float
    width_bounds: tuple[float, float]
    effective_bounds: tuple[float, float]


def fewest(dim: int) -> int:
    """Return the fewest draws from which an effect can be found."""
    return 1 + 2 * dim + (dim * (dim - 1) // 2 if dim <= WHOLE else 0) + FREEDOM


def smooth_effect(
    draws: LogRatios, posterior: Particles, level: float, *, scatter: float = 0.0, typical: float = 0.0
) -> Effect:
    """Return the effect of a smooth error, from at least `fewest` finite draws, not necessarily of equal weight.

    `posterior` has many draws of equal weight; each bound is exceeded with the probability `level`. `scatter` is the
    variance of δ by the simulator's own scatter, which is no error of the posterior: it widens the bounds of shifts and
    widths, as all scatter does, but is taken out of those of the effective share. `typical` is the mean variance of δ
    that the surrogate expects over the posterior.

    Errors about the parabola have the expected variances times a scale. This is that of all draws, or of those that
    count most if it is larger: many of the expected variances may be far too large.

    The effective share is about exp(-Var δ). Its lower bound takes the variance of δ as a whole, or that of the
    parabola and of the errors about it, whichever is smaller; its upper bound takes the part of the parabola's spread
    that is more than chance gives (by the triangle inequality), and these errors.
    """
    mean, sd = posterior.mean(axis=0), posterior.std(axis=0)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(((posterior - mean) / sd).T)))
    principal = vectors / np.sqrt(np.maximum(values, 1e-12))
    z, many, log_ratios = (draws.x - mean) / sd, (posterior - mean) / sd, draws.values
    tried = [principal] if len(mean) <= WHOLE else [principal, np.eye(len(mean))]
    level /= len(tried)  # either may be the one that fits better
    others = scatter + ROUGH**2
    roots, typical = 1 / np.sqrt(draws.variances + others), typical + others
    fits = [(_fitted(_terms(z @ axes), log_ratios, roots), axes) for axes in tried]
    fit, axes = min(fits, key=lambda one: one[0].squares / one[0].freedom)
    B, best = _terms(many @ axes), fit.best
    random = np.random.default_rng(_SEED)
    spread = np.linalg.solve(fit.factor, random.standard_normal((len(best), SAMPLES))).T
    scales = np.sqrt(fit.squares / random.chisquare(fit.freedom, SAMPLES))
    drawn = np.vstack([best, best + spread * scales[:, None]])
    means, widths, size = _moved(posterior, (mean, sd), drawn @ B.T)
    shift, width = np.abs(means[0]).max(), np.abs(widths[0]).max()
    about = typical * fit.squares
    rest = max(about / float(chi2.ppf(level / 2, fit.freedom)) - scatter, 0.0)  # two variances share the level
    by_fit = float(np.quantile(size[1:], 1 - level / 2)) + rest
    total = float(np.sum((log_ratios - log_ratios.mean()) ** 2))
    by_all = max(total / float(chi2.ppf(level / 2, len(draws) - 1)) - scatter, 0.0)
    few = max(about / float(chi2.ppf(1 - level, fit.freedom)) - scatter, 0.0)
    *_, by_chance = _moved(posterior, (mean, sd), (drawn[1:] - best) @ B.T)
    least = max(math.sqrt(size[0]) - math.sqrt(np.quantile(by_chance, 1 - level)), 0.0) ** 2
    return Effect(
        float(shift),
        _bounds(means[1:], level),
        float(width),
        _bounds(widths[1:], level),
        (math.exp(-min(by_fit, by_all)), math.exp(-least - few)),
    )


def _terms(y: Float[np.ndarray, "some dim"]) -> Float[np.ndarray, "some term"]:
    products = [y[:, i] * y[:, j] for i in range(y.shape[1]) for j in range(i)] if y.shape[1] <= WHOLE else []
    return np.column_stack([np.ones(len(y)), y, y**2, *products])


@dataclass(frozen=True, eq=False)
class _ParabolaFit:
    """Weighted least squares: coefficients, R of A = QR, sum of squares of the errors, and its degrees of freedom."""

    best: Float[np.ndarray, " term"]
    factor: Float[np.ndarray, "term term"]
    squares: float
    freedom: float


def _fitted(A: Float[np.ndarray, "draw term"], log_ratios: Values, roots: Values) -> _ParabolaFit:
    """Return the fit; its errors are those of the draws that count most, with half of the freedom, if they are larger.
    `roots` are the square roots of the draws' weights.
    """
    q, r = np.linalg.qr(roots[:, None] * A)
    best = np.linalg.solve(r, q.T @ (roots * log_ratios))
    order = np.argsort(-roots, kind="stable")
    squares = np.cumsum(((roots * (log_ratios - A @ best)) ** 2)[order])
    freedom = np.cumsum(1 - (q**2).sum(axis=1)[order])
    part = max(int(np.searchsorted(freedom, freedom[-1] / 2)) - 1, int(np.searchsorted(freedom, 1.0)))
    if roots.max() == roots.min() or squares[part] / freedom[part] <= squares[-1] / freedom[-1]:
        part = len(A) - 1
    return _ParabolaFit(best, r, float(squares[part]), float(freedom[part]))


def _bounds(drawn: Float[np.ndarray, "sample dim"], level: float) -> tuple[float, float]:
    """Return bounds of the largest size of several quantities, from draws of each. The largest size of many draws is
    large by chance alone, so the lower bound is the largest of all quantities' own.
    """
    share = level / drawn.shape[1]
    lowest, highest = np.quantile(drawn, share, axis=0), np.quantile(drawn, 1 - share, axis=0)
    upper = np.quantile(np.abs(drawn).max(axis=1), 1 - level)
    return float(np.maximum(np.maximum(lowest, -highest), 0.0).max()), float(upper)


def _moved(
    posterior: Particles, moments: tuple[Point, Point], log_ratios: Float[np.ndarray, "sample particle"]
) -> tuple[Float[np.ndarray, "sample dim"], Float[np.ndarray, "sample dim"], Float[np.ndarray, " sample"]]:
    """Return the shifts of the means, in sds, the changes of the log sds, and minus the log of the effective share."""
    mean, sd = moments
    weights = np.exp(log_ratios - log_ratios.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    z = (posterior - mean) / sd
    means = weights @ z
    variances = np.maximum(weights @ z**2 - means**2, 1e-12)
    effective = 1.0 / (weights**2).sum(axis=1) / len(z)
    return means, 0.5 * np.log(variances), -np.log(np.minimum(effective, 1.0))


FEWEST_DRAWS = 6  # fewest draws that can settle anything: the bound of their spread is 2.5 times the spread itself
POOL, TAIL = 200, 0.06
"""Draws from which the probes are picked; mass of the tails that they reach. An error beyond 1.28 sds of one input is
then missed once in 200 (7 and 10 inputs, 9 and 10 probes), in any direction once in 10; six that lie farthest apart
miss it in 24 and 29 of 100."""
ERROR_PROBABILITY, FIRST = 0.05, 0.5
"""Probability that an early verdict is wrong, over all looks together; share of it that the first look has."""
LIKELY = 0.05
"""Probability that each objection of the parabola to all draws is wrong: it has seen tails that the others may miss."""
FAR_OFF, FAR_OFF_SDS = 2.0, 5.0
"""Error of a log-likelihood, and the same in predicted standard deviations, that no right surrogate makes; a draw that
was off by 3.9 and 13 sds came before a ridge was missed."""
GROWTH = 0.25  # share by which the draws of a check grow from one look to the next
FEWEST_WHOLE = 18  # fewest draws besides the probes whose importance weights count
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
    the last draws, `left_out` how many earlier runs helped to settle it, each predicted from all others.

    Of many inputs there is no reweighting: `ratio_sd` is the standard deviation of the logarithm of the true over the
    predicted likelihood, `bound` the shift of a mean that the draws leave possible, in standard deviations of it.
    """

    draws: int
    failed: int
    reweighting: Reweighting | None
    passed: bool
    reasons: tuple[str, ...]
    early: bool = False
    left_out: int = 0
    ratio_sd: float | None = None
    bound: float | None = None


def probes(draws: Float[np.ndarray, "draw dim"], least: int) -> Int[np.ndarray, " probe"]:
    """Return indices of draws that reach into both tails of each input and each principal axis; at least so many.

    The nearest to the mean comes first, then each that reaches into most tails where none has been, far from others.
    """
    if len(draws) < 2:
        return np.arange(len(draws))
    z = (draws - draws.mean(axis=0)) / np.maximum(draws.std(axis=0), np.finfo(float).tiny)
    y = np.hstack([z, z @ np.linalg.eigh(np.atleast_2d(np.cov(z.T)))[1]])
    low, high = np.quantile(y, (TAIL, 1 - TAIL), axis=0)
    tails, nearest = np.hstack([y < low, y > high]), np.full(len(z), np.inf)
    chosen: list[int] = []
    now = int(np.argmin((z**2).sum(axis=1)))
    while len(chosen) < least or tails.any():
        chosen.append(now)
        nearest, tails = np.minimum(nearest, cdist(z, z[now : now + 1])[:, 0]), tails & ~tails[now]
        if not nearest.any():
            break  # a posterior that has collapsed to fewer draws
        now = int(np.argmax(np.where(nearest > 0, tails.sum(axis=1) + nearest / (2 * nearest.max()), -1.0)))
    return np.array(chosen)


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
    posterior: Particles,
    tolerances: Tolerances,
    *,
    probing: int,
    level: float,
    last: bool,
    left_out: LogRatios | None = None,
    typical: float = 0.0,
    scatter: float = 0.0,
) -> BatchCheck | Literal["open"]:
    """Return the verdict of the draws so far, or that more are needed.

    Draws count by their expected variances for the bounds that confirm a posterior, but equally for those that object:
    the surrogate may expect errors in a tail that it has missed. So nothing confirms it unless enough of all draws, and
    of the probes alone, are effective by their own weights.

    The first `probing` draws are probes, the others have equal weight, as the many draws `posterior` have. Unless it is
    the `last` one, the verdict is wrong with the probability `level`, see `error_probability`. `left_out` are earlier
    runs near the posterior, each predicted from all others: they can confirm it, but not object, since they are
    predicted with fewer runs than the posterior has. `typical` is the mean variance of the log ratios that the
    surrogate expects over the posterior, `scatter` that by the simulator's own scatter, which the bounds allow for. The
    importance weights of all draws do not: they are certain of shifts only if they are nearly equal.
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
    probe = np.arange(number) < probing
    equal, tails = draws[good & ~probe], draws[good & probe]
    agree = not excluded and all(_agree(one.values, tolerances.effective, scatter) for one in (kept, tails))
    if not excluded and (unforeseen := _unforeseen(kept, scatter)):
        return ended(unforeseen)
    for some in (kept, equal):
        if agree and len(some) >= FEWEST_DRAWS and spread_bound(some.values, level) <= tolerances.shift:
            return ended(())
    if left_out is not None and len(left_out):
        level /= 2
        both = left_out.joined(kept)
        if agree and len(kept) > 2 * dim and len(both) >= fewest(dim):
            effect = smooth_effect(both, posterior, level, scatter=scatter, typical=typical)
            if within(effect, tolerances):
                return replace(ended((), reweight(both.x, both.values)), left_out=len(left_out))
    if found is None or len(kept) < fewest(dim):
        if last:
            return ended((f"only {len(kept)} of {number} runs of the check succeeded",))
    elif excluded:
        return ended(objections(found, tolerances) or ("the true model excludes draws of the posterior",))
    else:
        effect = smooth_effect(kept, posterior, level, scatter=scatter, typical=typical)
        if agree and within(effect, tolerances):
            return ended(())
        if surely := _beyond(smooth_effect(alike, posterior, level, scatter=scatter), tolerances):
            return ended(surely)
    if not last:
        return "open"
    assert found is not None  # fewer draws have ended it
    if len(equal) < FEWEST_WHOLE:
        return ended((*objections(found, tolerances), f"{number} runs at draws of the posterior do not settle it"))
    whole, likely = reweight(equal.x, equal.values), smooth_effect(alike, posterior, LIKELY, scatter=scatter)
    return ended(objections(whole, tolerances) or _beyond(likely, tolerances), whole)


def _unforeseen(draws: LogRatios, scatter: float) -> tuple[str, ...]:
    """Return, in words, whether a draw disagrees that the surrogate was sure of."""
    if not len(draws):
        return ()
    off = np.abs(draws.values - np.median(draws.values))
    sds = np.where(off > FAR_OFF, off / np.sqrt(draws.variances + scatter + ROUGH**2), 0.0)
    worst = int(np.argmax(sds))
    by = f"{off[worst]:.2g}, {sds[worst]:.0f} predicted standard deviations"
    return (f"the log-likelihood at a draw is off by {by}",) if sds[worst] > FAR_OFF_SDS else ()


def _agree(log_ratios: Values, effective: float, scatter: float) -> bool:
    """Return whether this share of the draws is effective by their own weights, but for the simulator's scatter."""
    return len(log_ratios) < 2 or float(np.var(log_ratios, ddof=1)) - scatter <= -math.log(effective)


def spread_bound(log_ratios: Values, level: float) -> float:
    """Return the upper bound of the standard deviation of normal log ratios, exceeded with the probability `level`.

    It bounds the shift of each mean, in standard deviations, and a share 1/√2 of it the change of their logarithms.
    """
    free = len(log_ratios) - 1
    return float(np.std(log_ratios, ddof=1)) * math.sqrt(free / float(chi2.ppf(level, free)))


def within(effect: Effect, tolerances: Tolerances) -> bool:
    """Return whether all upper bounds are within the tolerances."""
    return (
        effect.shift_bounds[1] <= tolerances.shift
        and effect.width_bounds[1] <= tolerances.width
        and effect.effective_bounds[0] >= tolerances.effective
    )


def _beyond(effect: Effect, tolerances: Tolerances) -> tuple[str, ...]:
    """Return which lower bounds are beyond the tolerances, in words."""
    out = []
    if effect.shift_bounds[0] > tolerances.shift:
        by = f"{effect.shift:.2g} standard deviations"
        out.append(f"the true model moves a mean by {by}, more than {tolerances.shift:g}")
    if effect.width_bounds[0] > tolerances.width:
        out.append(f"the true model changes a standard deviation by {math.expm1(effect.width):.0%}")
    if effect.effective_bounds[1] < tolerances.effective:
        most = f"{effect.effective_bounds[1]:.0%}"
        out.append(f"at most {most} of the draws are effective, not {tolerances.effective:.0%}")
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
        limit = f"{tolerances.width:g} in its logarithm"
        out.append(f"importance weights multiply a standard deviation by {ratio:.2f}, more than {limit}")
    if share < tolerances.effective:
        wanted = f"{tolerances.effective:.0%}"
        out.append(f"the effective sample size of the weights is {share:.0%} of the draws, not {wanted}")
    return tuple(out)
