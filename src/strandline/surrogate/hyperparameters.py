"""Hyperparameters by maximum evidence, in coordinates that suit its flat ridge.

On a log-likelihood the evidence rises along σ0²/l³ = const, so the coordinates are (log σ0²/l³, log l) and l is
bounded; the nugget is given. With a length for each input there is a log l for each, and l³ is that of their geometric
mean: the ridge, on which all lengths grow together, is straight again. (All this holds for Matérn 3/2; the ridge of a
smoother kernel runs at another angle to these coordinates.) The evidence can have several maxima with flat slopes
between them, so there are two starts, and every stop is checked, even if the optimiser reports success.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np
from jaxtyping import Float
from scipy.optimize import OptimizeResult, minimize

from strandline.foundations import NumericsError, TooFewRuns, require
from strandline.surrogate.covariance import factorise, invert, solve
from strandline.surrogate.kernels import Kernel, LengthScale, as_length_scale, as_lengths

SHORTEST_LENGTH = 0.01
STARTING_LENGTHS = (0.5, 3.0)
_WINDOW = 40.0  # half-width of the box of log σ0²/l³ around its first guess
_FLAT = 1e-3  # nats: a smaller change of the log evidence decides nothing
_VARIANCE_STEPS, _SMALLEST_SHARE = 3, 1e-3  # limits of the search for a starting variance
_STEP = 0.01  # perturbation of the coordinates when a stop is checked
_TRIES = 4  # runs of the optimiser from one start, each from where the last stopped short of a maximum


@dataclass(frozen=True)
class LogEvidence:
    """Log evidence and its derivatives with respect to (log σ0²/l³, log l), with a log l for each length."""

    value: float
    gradient: Float[np.ndarray, " coordinate"]


@dataclass(frozen=True)
class EvidenceSearch:
    """One start of the optimiser, at the same length scale for every input, and how it ended.

    `evaluations` are those of the evidence, `message` is the optimiser's own on its last stop, `verdict` is
    ``converged``, or what the check of another stop found. It is `accepted` if the end is a maximum within tolerance.
    """

    start: float
    length_scale: LengthScale
    signal_variance: float
    log_evidence: float
    evaluations: int
    message: str
    verdict: str
    accepted: bool


@dataclass(frozen=True)
class FittedHyperparameters:
    """The best accepted attempt, and all attempts.

    The length scale l is in standard deviations of the inputs, one for each input if the kernel has several; the nugget
    σ_n² is as given, the log evidence log p(y | l, σ0², σ_n²). `at_bound` tells whether a length lies at its upper
    bound: the usual end on a log-likelihood. Message and verdict are those of the best attempt.
    """

    length_scale: LengthScale
    signal_variance: float
    nugget: float
    log_evidence: float
    at_bound: bool
    message: str
    verdict: str
    attempts: tuple[EvidenceSearch, ...]


class Objective:
    """Evidence of fixed data with its n×n work arrays kept between evaluations."""

    def __init__(
        self, x: Float[np.ndarray, "run dim"], y: Float[np.ndarray, " run"], kernel: Kernel, nugget: float
    ) -> None:
        self.y, self.kernel, self.nugget = y, kernel, nugget
        self.lengths = x.shape[1] if kernel.per_input else 1
        self.pairs = kernel.pairs(x, unit=np.ones(self.lengths))
        self.K = np.zeros((len(y), len(y)), order="F")
        self.worst = math.inf

    def evidence(self, log_ratio: float, log_lengths: Sequence[float]) -> LogEvidence:
        """Return the log evidence and its gradient by the log ratio of variances and the log lengths."""
        inverse, variance = self._covariance(log_ratio, log_lengths)
        alpha = solve(self.K, self.y)
        value = -0.5 * self.y @ alpha - np.log(np.diagonal(self.K)).sum() - 0.5 * len(alpha) * math.log(2 * math.pi)
        invert(self.K)
        # ∂/∂log σ0² = ½ (αᵀ σ0²C α - tr K⁻¹ σ0²C) with σ0²C = K - σ_n² I; `K` holds K⁻¹
        fit = self.y @ alpha - self.nugget * alpha @ alpha
        by_variance = float(0.5 * (fit - (len(alpha) - self.nugget * np.trace(self.K))))
        by_lengths = variance * self.pairs.by_log_lengths(alpha, self.K, inverse_lengths=inverse)
        by_lengths += 3 / self.lengths * by_variance
        return LogEvidence(float(value), np.array([by_variance, *by_lengths]))

    def starting_ratio(self, length: float) -> float:
        """Return log σ0²/l³ to start from with equal lengths; with a single length, σ0² is the targets' variance.

        With several lengths this is far too small if they are long, and the optimiser's first step then leads to a
        local maximum where all lengths vanish. So σ0² is made to fit the targets, αᵀ σ0²C α = n, as far as the nugget
        and a covariance that can be factorised allow.
        """
        ratio = sound = math.log(float(np.var(self.y))) - 3 * math.log(length)
        for _ in range(_VARIANCE_STEPS + 1 if self.lengths > 1 else 0):
            try:
                self._covariance(ratio, [math.log(length)] * self.lengths)
            except NumericsError:
                break
            sound, alpha = ratio, solve(self.K, self.y)
            share = (self.y @ alpha - self.nugget * alpha @ alpha) / len(alpha)
            ratio += math.log(max(share, _SMALLEST_SHARE))
        return sound

    def _covariance(self, log_ratio: float, log_lengths: Sequence[float]) -> tuple[Float[np.ndarray, " length"], float]:
        """Factorise the covariance into `K`; return the inverse lengths and σ0²."""
        inverse = np.array([math.exp(-log_length) for log_length in log_lengths])
        variance = math.exp(log_ratio + 3 * fmean(log_lengths))
        self.pairs.fill(self.K, inverse_lengths=inverse, variance=variance, diagonal=self.nugget)
        factorise(self.K)
        return inverse, variance

    def descent(self, z: Float[np.ndarray, " coordinate"]) -> tuple[float, Float[np.ndarray, " coordinate"]]:
        """Return minus the evidence for the optimiser; if K breaks down, a wall above all values seen."""
        try:
            found = self.evidence(float(z[0]), z[1:].tolist())
        except NumericsError:
            return (self.worst + 1e3 if math.isfinite(self.worst) else 1e30), np.zeros(len(z))
        self.worst = -found.value if math.isinf(self.worst) else max(self.worst, -found.value)
        return -found.value, -found.gradient


def evidence(
    x_std: Float[np.ndarray, "run dim"],
    y_centred: Float[np.ndarray, " run"],
    *,
    kernel: Kernel,
    length_scale: LengthScale,
    signal_variance: float,
    nugget: float,
) -> LogEvidence:
    """Return log p(y | X, l, σ0², σ_n²) and its gradient with respect to (log σ0²/l³, log l).

    Raises:
        NumericsError: the covariance is not positive definite.
    """
    objective = Objective(x_std, y_centred, kernel, nugget)
    log_lengths = [math.log(length) for length in as_lengths(kernel, length_scale, x_std.shape[1])]
    return objective.evidence(math.log(signal_variance) - 3 * fmean(log_lengths), log_lengths)


def fit_hyperparameters(
    x_std: Float[np.ndarray, "run dim"],
    y_centred: Float[np.ndarray, " run"],
    *,
    kernel: Kernel,
    nugget: float,
    length_scale_bound: float = 10.0,
    starting_lengths: tuple[float, ...] = STARTING_LENGTHS,
) -> FittedHyperparameters:
    """Maximise the evidence by L-BFGS-B from several length scales, with standardised inputs and centred targets.

    The nugget σ_n² is kept fixed. Lengths, in standard deviations of the inputs, have an upper bound; starting ones,
    the same for every input, that are above it start at it.

    Raises:
        TooFewRuns: fewer than dim + 2 runs.
        InvalidInput: a value that is not finite.
        NumericsError: constant targets, or no start that ended at a maximum.
    """
    require_runs(x_std, y_centred)
    objective = Objective(x_std, y_centred, kernel, nugget)
    starts = [min(s, length_scale_bound) for s in starting_lengths]
    attempts = tuple(_attempt(objective, start, length_scale_bound) for start in starts)
    best = max(attempts, key=lambda a: (a.accepted, a.log_evidence))
    if not best.accepted:
        shown = [(", ".join(f"{length:.3g}" for length in np.atleast_1d(a.length_scale)), a) for a in attempts]
        ends = "; ".join(f"from l = {a.start:g} to {length}: {a.message} ({a.verdict})" for length, a in shown)
        raise NumericsError(
            f"no start of the evidence optimiser ended at a maximum: {ends}. "
            "Raise the nugget, clip extreme log-likelihoods or bound the length scale lower."
        )
    length, at_bound = best.length_scale, bool(np.max(best.length_scale) >= length_scale_bound * (1 - 1e-6))
    how = best.message, best.verdict, attempts
    return FittedHyperparameters(length, best.signal_variance, nugget, best.log_evidence, at_bound, *how)


def require_runs(x: Float[np.ndarray, "run dim"], y: Float[np.ndarray, " target"]) -> None:
    """Refuse training data that no surrogate can be fitted to.

    Raises:
        TooFewRuns: fewer than dim + 2 runs.
        InvalidInput: a value that is not finite, or other numbers of inputs and of targets.
        NumericsError: constant targets.
    """
    found = f"{len(x)} inputs and {len(y)} log-likelihoods"
    words = "one log-likelihood for each run", "Pass the successful runs only, in the same order."
    require(len(x) == len(y), "training data of the surrogate", found, *words)
    require_enough(len(y), x.shape[1] + 2, x.shape[1])
    finite = np.isfinite(x).all(axis=1) & np.isfinite(y)
    where, words = int(np.argmin(finite)), ("finite numbers", "Leave failed runs out of the training.")
    require(finite.all(), f"training run {where}", f"inputs {x[where].tolist()}, target {y[where]}", *words)
    if np.ptp(y) == 0:
        raise NumericsError(
            f"all {len(y)} training targets equal {y[0]:g}: there is nothing to learn. "
            "Check the discrepancy measure and that the inputs move the interface."
        )


def require_enough(runs: int, needed: int, dim: int) -> None:
    """Refuse to train a surrogate with fewer successful runs than it needs."""
    expected, remedy = f"at least {needed} for {dim} input(s)", "Add runs to the design, or look at why runs failed."
    require(runs >= needed, "training of the surrogate", f"{runs} successful run(s)", expected, remedy, TooFewRuns)


def _attempt(objective: Objective, start: float, bound: float) -> EvidenceSearch:
    """Run the optimiser from one length scale, judge its stop, and continue from there if that is no maximum."""
    ratio = objective.starting_ratio(start)
    box = [(ratio - _WINDOW, ratio + _WINDOW)] + [(math.log(SHORTEST_LENGTH), math.log(bound))] * objective.lengths
    z, evaluations = np.array([ratio] + [math.log(start)] * objective.lengths), 0
    for _ in range(_TRIES):
        found = minimize(objective.descent, z, jac=True, method="L-BFGS-B", bounds=box, options={"maxiter": 200})
        verdict, accepted = _judge(objective, found, box)
        z, evaluations = found.x, evaluations + int(found.nfev)
        if accepted:
            break
    lengths = [min(math.exp(log_length), bound) for log_length in found.x[1:]]
    return EvidenceSearch(
        start=start,
        length_scale=as_length_scale(objective.kernel, np.array(lengths)),
        signal_variance=math.exp(found.x[0]) * math.prod(lengths) ** (3 / objective.lengths),
        log_evidence=-float(found.fun),
        evaluations=evaluations,
        message=str(found.message),
        verdict=verdict,
        accepted=accepted,
    )


def _judge(objective: Objective, found: OptimizeResult, box: list[tuple[float, float]]) -> tuple[str, bool]:
    """Return a verdict on the optimiser's stop and whether to accept it. The optimiser's own success counts only if the
    projected gradient is small as well: it also calls a step that gains little a success, and has done so hundreds of
    nats below the maximum. Any other stop (line search "ABNORMAL", limit of iterations) is accepted only if small steps
    along all coordinates and along the gradient, inside the box, gain less than `_FLAT`.
    """
    if found.fun > objective.worst or math.isinf(objective.worst):  # the wall, including that of another start
        return "the covariance was never positive definite", False
    low, high = np.array(box).T
    slope = np.clip(found.x - np.asarray(found.jac), low, high) - found.x
    norm = float(np.linalg.norm(slope))
    if found.success and norm * _STEP < _FLAT:
        return "converged", True
    axes = _STEP * np.eye(len(box))
    steps = [*axes, *-axes, _STEP * slope / max(norm, 1e-300)]
    gain = max(float(found.fun) - objective.descent(np.clip(found.x + step, low, high))[0] for step in steps)
    figures = f"projected gradient {norm:.2g}, best gain of a step of {_STEP:g} is {gain:.2g} nats"
    return (f"accepted: {figures}", True) if gain < _FLAT else (f"not a maximum: {figures}", False)
