"""What a smooth error of the log-likelihood does to a posterior: a parabola through log ratios at some of its draws.

The logarithm δ of true over expected likelihood is taken as a + Σ (b_k y_k + c_k y_k²) along the principal axes y of
the posterior, or along the inputs if that fits better, plus independent errors; in up to three dimensions as a whole
quadratic function. Draws at which the surrogate is less sure may count less. The coefficients have Student's t
distribution around their least-squares estimate. Weights exp(δ) of many draws then show how far each mean and each
standard deviation would move.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

SAMPLES = 400
"""Sets of coefficients drawn."""
FREEDOM = 3
"""Degrees of freedom that must be left."""
WHOLE = 3
"""Largest dimension with products of the axes."""
ROUGH = 0.1
"""Standard deviation added to every expected one, so that no draw counts far more than all others."""
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
    by_fit = float(np.quantile(size[1:], 1 - level / 2)) + max(
        _largest_variance(about, fit.freedom, level) - scatter, 0.0
    )
    total = float(np.sum((log_ratios - log_ratios.mean()) ** 2))
    by_all = max(_largest_variance(total, len(draws) - 1, level) - scatter, 0.0)
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
    """Weighted least squares: the coefficients, R of the weighted A = QR, the weighted sum of squares of the errors and
    its degrees of freedom.
    """

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
    """Return bounds of the largest size of several quantities, from draws of each.

    The largest size of many draws is large by chance alone, so the lower bound is the largest of all quantities' own.
    """
    share = level / drawn.shape[1]
    lowest, highest = np.quantile(drawn, share, axis=0), np.quantile(drawn, 1 - share, axis=0)
    upper = np.quantile(np.abs(drawn).max(axis=1), 1 - level)
    return float(np.maximum(np.maximum(lowest, -highest), 0.0).max()), float(upper)


def _largest_variance(squares: float, freedom: float | int, level: float) -> float:
    """Return the bound of a variance that two of them share a `level` for, given a sum of squares."""
    return squares / float(chi2.ppf(level / 2, freedom))


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
