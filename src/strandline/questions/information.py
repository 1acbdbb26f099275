"""What an experiment can be expected to teach: the information in its observation, and what inputs it determines.

The observation of a candidate is s = z(x) + ε with standard normal ε: `signals_of` brings predicted interfaces
into this form. Its expected information gain (Lindley 1956) is

    E[log p(s | x) - log p(s)],   p(s) = ∫ p(s | x) p(x) dx,

over draws of the present distribution p(x) of the inputs, which is a posterior or the prior. Nested Monte Carlo takes
the same draws for both expectations (Ryan 2003); Laplace's approximation takes the Fisher information at each draw
(Long et al. 2013), which is right where the experiment teaches so much that few draws are near each other in s.

Which model is right: under model m with inputs x, the observation is s = z_m(x) + ε, in the same coordinates for all
models. What it tells about the model is the mutual information of m and s,

    Σ_m P(m) E[log p(s | m) - log Σ_k P(k) p(s | k)],   p(s | m) = ∫ p(s | x, m) p(x | m) dx,

(Box and Hill 1967; Cavagnaro et al. 2010), by nested Monte Carlo over draws of the models' present posteriors.

Which combinations of the inputs it determines: inputs u are scaled by their prior standard deviations. Positive ones
enter by their logarithms, since a common factor of stiffness and load changes no shape, whatever their size. An
experiment of Fisher information F leaves the covariance (I + F)⁻¹ of u for a normal prior and an interface that is
linear in u. Its eigenvectors are the combinations that are learnt independently; the root of an eigenvalue is what is
left of the prior's standard deviation there.

Combinations about which hardly anything is learnt are equally unknown, so any rotation of them is as good. The one with
the fewest inputs in each is chosen (varimax; Kaiser 1958).
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import logsumexp

from strandline.calibration import Errors
from strandline.design import Candidate
from strandline.parameters import ParameterSpace
from strandline.posterior import Weighted

FEWEST = 30.0  # median number of draws that an observation must leave with weight; else no nested Monte Carlo
LEAST_LOG_DET = -1e3  # logarithm of the smallest determinant of a covariance; that of equal draws is 0
Matrix = Float[np.ndarray, "dim dim"]
Informations = Sequence[Matrix]
Signals = Float[np.ndarray, "draw signal"]
BLOCK = 256  # observations that are weighed at the same time


@dataclass(frozen=True, eq=False)
class Gain:
    """What an experiment is expected to teach.

    `nats` is the expected information gain, `error` its standard error by the number of draws, `sd` the expected
    posterior standard deviation of each input. `of_interest` is the gain about the inputs of interest alone, by the
    determinants of their covariances: exact for normal distributions; observations that leave too few draws for a
    determinant do not count. `left` is the median number of draws that a possible observation leaves with weight.
    """

    nats: float
    error: float
    sd: Float[np.ndarray, " dim"]
    of_interest: float
    left: float

    @property
    def reliable(self) -> bool:
        return self.left >= FEWEST


def expected_gain(
    now: Weighted, signals: Signals, random: np.random.Generator, *, interest: Sequence[int] | None = None
) -> Gain:
    """Return the expected information gain of an experiment, by nested Monte Carlo.

    Each draw in turn is the truth; all others, with their weights, are the distribution of the inputs; `signals` are
    what the experiment shows for each, in standard deviations of independent errors. What the finite number of draws
    adds to the gain is removed to first order: half the variance of the estimated log p(s). The same state of `random`,
    which draws the errors, makes differences of candidates more certain. `interest` are columns; all by default.
    """
    noise = random.standard_normal(signals.shape)
    columns = np.arange(now.draws.shape[1]) if interest is None else np.asarray(interest)
    parts = [*_weighed(now, signals, noise, columns)]
    logs, left, sds, log_dets = (np.concatenate(one) for one in zip(*parts, strict=True))
    # The squared errors have a known mean, so they serve as the control of their own sampling error.
    squares = 0.5 * (noise**2).sum(axis=1)
    gains = -squares - logs - 0.5 * (1.0 / left - float(np.sum(now.weights**2)))
    mean, error = _controlled(gains, squares - 0.5 * signals.shape[1], now.weights)
    before = np.linalg.slogdet(now.covariance[np.ix_(columns, columns)])[1]
    counted = now.weights * (left > len(columns) + 1)  # fewer draws have no covariance: its determinant is near 0
    after = counted @ np.maximum(log_dets, LEAST_LOG_DET) / max(float(counted.sum()), 1e-300)
    return Gain(
        nats=mean,
        error=error,
        sd=np.asarray(now.weights @ sds),
        of_interest=float(0.5 * (before - after)),
        left=float(np.median(left)),
    )


def _controlled(
    values: Float[np.ndarray, " draw"], control: Float[np.ndarray, " draw"], weights: Float[np.ndarray, " draw"]
) -> tuple[float, float]:
    """Return the mean of `values` and its standard error, given a control of known mean 0."""
    both = Weighted(np.column_stack([values, control]), weights)
    covariance = both.covariance
    slope = covariance[0, 1] / covariance[1, 1] if covariance[1, 1] > 0 else 0.0
    variance = max(float(covariance[0, 0] - slope * covariance[0, 1]), 0.0)
    return float(both.mean[0] - slope * both.mean[1]), math.sqrt(variance * float(np.sum(weights**2)))


_Weighed = tuple[Float[np.ndarray, " _"], Float[np.ndarray, " _"], Float[np.ndarray, "_ dim"], Float[np.ndarray, " _"]]


def _weighed(
    now: Weighted, signals: Signals, noise: Signals, columns: Int[np.ndarray, " interest"]
) -> Iterator[_Weighed]:
    """Yield log p(s), the effective number of draws, the sds, and log det of the covariance of `columns`, by blocks."""
    squares, log_weights, dim = 0.5 * (signals**2).sum(axis=1), np.log(now.weights), now.draws.shape[1]
    scaled = (now.draws - now.mean) / np.maximum(now.sd, 1e-300)
    moments = np.hstack([scaled, (scaled[:, :, None] * scaled[:, None, :]).reshape(len(scaled), -1)])
    scale = 2 * np.log(np.maximum(now.sd, 1e-300))[columns].sum()
    for first in range(0, len(signals), BLOCK):
        rows = np.arange(first, min(first + BLOCK, len(signals)))
        seen = signals[rows] + noise[rows]
        logs = log_weights + seen @ signals.T - squares - 0.5 * (seen**2).sum(axis=1)[:, None]
        logs[np.arange(len(rows)), rows] = -np.inf  # the truth itself would count as a draw that fits perfectly
        total = logsumexp(logs, axis=1)
        weights = np.exp(logs - total[:, None])
        found = weights @ moments
        means = found[:, :dim]
        covariances = found[:, dim:].reshape(-1, dim, dim) - means[:, :, None] * means[:, None, :]
        sds = now.sd * np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
        log_dets = np.linalg.slogdet(covariances[:, columns[:, None], columns])[1] + scale
        yield total - np.log1p(-now.weights[rows]), 1.0 / (weights**2).sum(axis=1), sds, log_dets


def _left(covariance: Matrix, information: Matrix) -> Matrix:
    """Return (Σ⁻¹ + F)⁻¹, in inputs scaled by their standard deviations."""
    sd = np.sqrt(np.diag(covariance))
    before = np.linalg.inv(covariance / np.outer(sd, sd))
    return np.asarray(np.linalg.inv(before + information * np.outer(sd, sd)) * np.outer(sd, sd))


By = Literal["nested Monte Carlo", "linearised"]


@dataclass(frozen=True, eq=False)
class Outlook:
    """What an experiment can be expected to teach: the gain about the inputs of interest in nats, its standard error by
    the number of draws (0 if linearised), the expected posterior sd of each input, and how they were computed.
    """

    gain: float
    error: float
    sd: Float[np.ndarray, " dim"]
    by: By


def expected_outlook(
    now: Weighted, signals: Signals, informations: Callable[[], Informations], *, interest: Sequence[int], seed: int
) -> Outlook:
    """Return the outlook by nested Monte Carlo; linearised if too few draws are left for that.

    `informations` returns the Fisher information at some of the draws; the other arguments are those of
    `expected_gain`. If there are inputs that are not of interest, gains are those of normal distributions.
    """
    found = expected_gain(now, signals, np.random.default_rng(seed), interest=interest)
    if not found.reliable:
        return linear_outlook(now.covariance, informations(), interest=interest)
    everything = len(interest) == now.draws.shape[1]
    return Outlook(found.nats if everything else found.of_interest, found.error, found.sd, "nested Monte Carlo")


def linear_outlook(covariance: Matrix, informations: Informations, *, interest: Sequence[int]) -> Outlook:
    """Return the outlook from Fisher informations F at draws of the inputs; `interest` are columns of the inputs.

    The gain is the mean of ½ log |Σ| / |(Σ⁻¹ + F)⁻¹|, or of its parts of interest: exact for a normal distribution of
    the inputs and an interface that is linear in them. The standard deviations are means, too.
    """
    part, left = np.ix_(interest, interest), np.array([_left(covariance, one) for one in informations])
    after = [np.linalg.slogdet(one[part])[1] for one in left]
    gain = float(0.5 * np.mean(np.linalg.slogdet(covariance[part])[1] - np.array(after)))
    return Outlook(gain, 0.0, np.asarray(np.mean([np.sqrt(np.diag(one)) for one in left], axis=0)), "linearised")


CLEAR = 3.0  # ln of the posterior odds from which a model is clearly better, strong evidence
FEWEST_OF_MODEL = 10.0  # median number of draws of the right model that an observation must leave with weight


@dataclass(frozen=True)
class Discrimination:
    """What an experiment is expected to tell about which model is right.

    `nats` is the expected information about the model, from 0 to ln of the number of models, `error` its standard error
    by the number of draws. `clear` is the probability that the right model will lead every other one by `CLEAR` nats of
    posterior odds, `wrong` that another one will. `left` is the median number of draws of the right model that a
    possible observation leaves with weight.
    """

    nats: float
    error: float
    clear: float
    wrong: float
    left: float

    def __repr__(self) -> str:
        return f"<Discrimination: {self.nats:.3g} ± {self.error:.2g} nats, clear in {self.clear:.0%}>"

    @property
    def reliable(self) -> bool:
        return self.left >= FEWEST_OF_MODEL


def expected_discrimination(
    signals: Sequence[Float[np.ndarray, "_ signal"]], probabilities: Sequence[float], random: np.random.Generator
) -> Discrimination:
    """Return what an experiment is expected to tell about which model is right.

    Each draw of each model in turn is the truth; it is left out where the density of its own observation is computed.
    `signals` of each model are those of equally likely draws; `probabilities` of the models sum to 1. The same state of
    `random`, which draws the errors, makes differences of candidates more certain.
    """
    log_prior, nats, variance, clear, wrong = np.log(probabilities), 0.0, 0.0, 0.0, 0.0
    left: list[Float[np.ndarray, " truth"]] = []
    for k, (truths, share) in enumerate(zip(signals, probabilities, strict=True)):
        seen = truths + random.standard_normal(truths.shape)
        columns, effective = zip(
            *(_log_densities(seen, draws, own=k == m) for m, draws in enumerate(signals)), strict=True
        )
        odds = log_prior + np.stack(columns, axis=1)
        posterior = odds - logsumexp(odds, axis=1, keepdims=True)
        told = posterior[:, k] - log_prior[k]
        nats, variance = nats + share * float(told.mean()), variance + share**2 * float(told.var()) / len(told)
        best_other = np.delete(odds, k, axis=1).max(axis=1)
        clear += share * float(np.mean(odds[:, k] - best_other >= CLEAR))
        wrong += share * float(np.mean(_lead(odds, k) >= CLEAR))
        left.append(effective[k])
    return Discrimination(max(nats, 0.0), math.sqrt(variance), clear, wrong, float(np.median(np.concatenate(left))))


def _lead(odds: Float[np.ndarray, "truth model"], right: int) -> Float[np.ndarray, " truth"]:
    """Return by how much the best wrong model leads every other one; negative if it does not lead."""
    out = np.full(len(odds), -np.inf)
    for m in range(odds.shape[1]):
        if m != right:
            out = np.maximum(out, odds[:, m] - np.delete(odds, m, axis=1).max(axis=1))
    return out


def _log_densities(
    seen: Float[np.ndarray, "truth signal"], draws: Signals, *, own: bool
) -> tuple[Float[np.ndarray, " truth"], Float[np.ndarray, " truth"]]:
    """Return log p(s | model), without the constant of the errors, and the effective number of draws behind it.

    Where the observations `seen` are `own`, number i comes from draw i, which is then left out.
    """
    squares, logs, left = 0.5 * (draws**2).sum(axis=1), np.empty(len(seen)), np.empty(len(seen))
    for first in range(0, len(seen), BLOCK):
        rows = np.arange(first, min(first + BLOCK, len(seen)))
        some = seen[rows]
        values = some @ draws.T - squares - 0.5 * (some**2).sum(axis=1)[:, None]
        if own:
            values[np.arange(len(rows)), rows] = -np.inf
        total = logsumexp(values, axis=1)
        left[rows] = np.exp(2 * total - logsumexp(2 * values, axis=1))
        # The logarithm of a mean of few draws is too low: by half its relative variance, to first order.
        number = len(draws) - own
        logs[rows] = total - math.log(number) + 0.5 * (1.0 / left[rows] - 1.0 / number)
    return logs, left


HARDLY = 0.85  # share of the prior's standard deviation above which hardly anything was learnt about a combination
NAMED = 0.3  # inputs with a smaller share of a combination than this, relative to the largest, are not named
ROTATIONS = 200
QUANTILES = 1000


@dataclass(frozen=True, eq=False)
class Scale:
    """How inputs are scaled: which enter by their logarithm, and the prior sd of each as it enters."""

    logarithmic: Bool[np.ndarray, " dim"]
    sd: Float[np.ndarray, " dim"]

    def of(self, x: Float[np.ndarray, "draw dim"]) -> Float[np.ndarray, "draw dim"]:
        """Return u at physical inputs."""
        return np.asarray(np.where(self.logarithmic, np.log(np.where(self.logarithmic, x, 1.0)), x) / self.sd)

    def factors(self, x: Float[np.ndarray, " dim"]) -> Float[np.ndarray, " dim"]:
        """Return dx/du at physical inputs."""
        return np.asarray(np.where(self.logarithmic, x, 1.0) * self.sd)


def scale_of(space: ParameterSpace) -> Scale:
    """Return the scale of the inputs of a study; those whose box has no negative values enter by their logarithms."""
    logarithmic = space.low >= 0
    p = (np.arange(QUANTILES) + 0.5) / QUANTILES
    draws = Scale(logarithmic, np.ones(space.dim)).of(space.marginal_quantiles(p))
    return Scale(logarithmic, np.asarray(draws.std(axis=0)))


@dataclass(frozen=True, eq=False)
class Direction:
    """A combination of the inputs, a unit vector in scaled inputs, and the share of the prior's sd left in it."""

    weights: Float[np.ndarray, " dim"]
    left: float


def directions_left(
    scale: Scale, x: Float[np.ndarray, "draw dim"], informations: Informations, columns: Sequence[int] | None = None
) -> tuple[Direction, ...]:
    """Return the combinations of the inputs, or of those in `columns`, from the least to the best known afterwards.

    The covariance is averaged over draws `x` of the prior, with the Fisher information of the physical inputs at each.
    """
    factors = [scale.factors(row) for row in x]
    unit = np.eye(x.shape[1])
    left = [np.linalg.inv(unit + np.outer(f, f) * one) for f, one in zip(factors, informations, strict=True)]
    return directions_of(np.asarray(np.mean(left, axis=0)), columns)


def shown_columns(space: ParameterSpace) -> list[int]:
    """Return the columns of the inputs that are no coefficients of a field."""
    return [k for k, one in enumerate(space) if one.of_field is None]


def directions_of(covariance: Matrix, columns: Sequence[int] | None = None) -> tuple[Direction, ...]:
    """Return the principal axes of a covariance of scaled inputs, the widest first; the unknown ones rotated.

    With `columns`, they are those of these inputs, whatever the others are, whose weights are 0.
    """
    if columns is not None and len(columns) < len(covariance):
        some = directions_of(covariance[np.ix_(columns, columns)]) if len(columns) else ()
        places = np.eye(len(covariance))[:, columns]
        return tuple(replace(one, weights=places @ one.weights) for one in some)
    values, vectors = np.linalg.eigh(covariance)
    unknown = values > HARDLY**2
    axes = np.hstack([_varimax(vectors[:, unknown]), vectors[:, ~unknown]])
    left = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", axes, covariance, axes), 0.0))
    return tuple(Direction(_signed(axes[:, k]), float(left[k])) for k in np.argsort(-left))


def _varimax(axes: Float[np.ndarray, "dim axis"]) -> Float[np.ndarray, "dim axis"]:
    """Return the rotation of orthonormal axes whose squared elements vary most, so that each has few large ones."""
    turn = np.eye(axes.shape[1])
    for _ in range(ROTATIONS if axes.shape[1] > 1 else 0):
        turned = axes @ turn
        u, _, vt = np.linalg.svd(axes.T @ (turned**3 - turned * (turned**2).mean(axis=0)))
        turn = u @ vt
    return np.asarray(axes @ turn)


def _signed(vector: Float[np.ndarray, " dim"]) -> Float[np.ndarray, " dim"]:
    return np.asarray(vector * np.sign(vector[np.argmax(np.abs(vector))]))


def in_words(direction: Direction, names: Sequence[str]) -> str:
    """Return a direction in words, e.g. ``E2 up and nu2 down (1 : 0.6)``, in prior standard deviations."""
    largest = float(np.abs(direction.weights).max())
    sizes = np.round(np.abs(direction.weights), 6)
    order = [k for k in np.argsort(-sizes, kind="stable") if sizes[k] >= NAMED * largest]
    if len(order) == 1:
        return str(names[order[0]])
    moves = [f"{names[k]} {'up' if direction.weights[k] > 0 else 'down'}" for k in order]
    ratio = " : ".join(f"{abs(direction.weights[k]) / largest:.2g}" for k in order)
    return f"{', '.join(moves[:-1])} and {moves[-1]} ({ratio})"


@dataclass(frozen=True, eq=False)
class CandidateAnswer:
    """What one candidate can be expected to teach.

    `outlook` is None if its run failed, and `problem` then says why. `failing` is the probability that the specimen
    folds or the run fails, None if nothing is known about it; `displacement` that of the interface from its undeformed
    state, in standard deviations of the points' errors, None if the model does not know that state.
    """

    candidate: Candidate
    outlook: Outlook | None
    failing: float | None
    displacement: float | None
    problem: str = ""

    @property
    def worth(self) -> float:
        """Expected information gain, nats, with nothing learnt where the experiment fails."""
        return -np.inf if self.outlook is None else self.outlook.gain * (1 - (self.failing or 0.0))


@dataclass(frozen=True, eq=False)
class Answers:
    """What the candidates can be expected to teach.

    `source` is what is known before, the ``prior`` or the ``posterior``, and `now` draws of it; `errors` are those of
    the observed points by condition. `directions` are combinations of the inputs in prior standard deviations, from the
    least to the best known: after the present experiment, or before any data after the planned one. `new` runs were
    made now.
    """

    source: str
    now: Weighted
    errors: Mapping[str, Errors]
    answers: tuple[CandidateAnswer, ...]
    directions: tuple[Direction, ...]
    new: int
    reused: int


def ranked(answers: Sequence[CandidateAnswer]) -> tuple[CandidateAnswer, ...]:
    """Return the answers in the order of their worth, single experiments before several together."""
    return tuple(sorted(answers, key=lambda one: (len(one.candidate.settings), -one.worth)))
