"""The posterior of one specimen through the surrogate of the interface that all specimens share.

Adaptive importance sampling begins with draws of the prior whose predicted interfaces are kept, so that no specimen
costs a forward run. The last draws come from a shifted Sobol sequence (Cranley and Patterson 1976), whose mean is more
accurate than that of independent draws. If importance sampling fails, tempering takes over.

Is the surrogate good enough for one? Let e be the error of the predicted modes near the posterior, with variances V. It
multiplies the likelihood by exp(∂log L/∂c·e). If it is small and changes little over the posterior, the mean of input d
thus moves by cov(x_d, ∂log L/∂c)·e. The standard deviation of this shift, in posterior standard deviations, is the
error that counts. V is enlarged if the runs nearest to the posterior, each predicted from all others, have larger
errors than expected.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from hashlib import sha256
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.special import gammaincinv, ndtri

from strandline import calibration
from strandline.design import Knowledge, sobol
from strandline.discrepancy import Discrepancy
from strandline.foundations import require, with_sd
from strandline.interface import Observation
from strandline.likelihood import FieldLikelihood, Nearby, log_gain
from strandline.parameters import ParameterSpace
from strandline.posterior import Weighted, systematic_indices
from strandline.surrogate import FieldPrediction, FieldSurrogate

__all__ = ["SpecimenPosterior", "posterior_of"]

DRAWS, MANY_INPUTS_DRAWS = 1024, 4096  # draws of the prior for up to three unknown inputs and for more
FEW_INPUTS = 3
SCRAMBLE = 0  # seed that scrambles their Sobol sequence


@dataclass(frozen=True, eq=False)
class Start:
    """The surrogate of the interface with draws of the prior, whose predicted interfaces are kept, for the inputs of a
    study of which some are `given`: known for a specimen.
    """

    knowledge: Knowledge
    space: ParameterSpace
    given: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def columns(self) -> Int[np.ndarray, " unknown"]:
        return np.array([i for i, name in enumerate(self.space.names) if name not in self.given])

    @cached_property
    def unknown(self) -> ParameterSpace:
        return self.space.subspace(self.columns.tolist())

    @cached_property
    def points(self) -> Float[np.ndarray, "draw unknown"]:
        number = DRAWS if self.unknown.dim <= FEW_INPUTS else MANY_INPUTS_DRAWS
        return self.unknown.prior_quantiles(sobol(number, self.unknown.dim, scramble=SCRAMBLE))

    @cached_property
    def predicted(self) -> FieldPrediction:
        return self.predict(self.points)

    @cached_property
    def log_densities(self) -> Float[np.ndarray, " draw"]:
        """Log prior density of these draws, as far as runs succeed there."""
        return self.log_density(self.points)

    def whole(self, x: Float[np.ndarray, "point unknown"]) -> Float[np.ndarray, "point dim"]:
        """Return the values of all inputs, for values of the unknown ones."""
        out = np.tile([self.given.get(name, 0.0) for name in self.space.names], (len(x), 1))
        out[:, self.columns] = x
        return out

    def predict(self, x: Float[np.ndarray, "point unknown"]) -> FieldPrediction:
        return self.knowledge.surrogate.predict(self.whole(x))

    def mean(self, x: Float[np.ndarray, "point unknown"]) -> Float[np.ndarray, "point mode"]:
        return self.knowledge.surrogate.mean(self.whole(x))

    def log_density(self, x: Float[np.ndarray, "point unknown"]) -> Float[np.ndarray, " point"]:
        """Return the log prior density of unknown inputs plus the log probability that a run succeeds there."""
        return np.asarray(self.unknown.log_prior(x) + self.knowledge.log_feasibility(self.whole(x)))

    def with_given(self, given: Mapping[str, float]) -> "Start":
        """Return the start of a specimen with other known inputs, inside their boxes; at least one is unknown."""
        if dict(given) == dict(self.given):
            return self
        for name, value in given.items():
            low, high = self.space[name].interval
            expected = f"a number from {low:g} to {high:g}, where the runs were made"
            remedy = "Correct it, or widen the prior of this input in study.yaml and run the study again."
            require(low <= value <= high, f"known value of {name}", value, expected, remedy)
        words = "at least one input left to infer", "Remove a column of the table."
        require(len(given) < self.space.dim, "known inputs of a specimen", ", ".join(given), *words)
        return replace(self, given=dict(given))


TOLERATED_SHIFT = 0.1  # shift of a posterior mean that is tolerated, in posterior standard deviations
NEAREST = 3  # number of left-out runs near the posterior that are considered, per number of inputs + 1
PRIOR_RUNS = 2.0  # runs with errors as expected that count beside them


@dataclass(frozen=True)
class Certified:
    """What the surrogate's error may do to a posterior.

    `shift` is the standard deviation of the shift of a posterior mean, in posterior standard deviations, the largest of
    all inputs; `surprise` the root mean square error of the nearest left-out runs over the expected one, at least 1.
    """

    shift: float
    surprise: float

    @property
    def good(self) -> bool:
        return self.shift <= TOLERATED_SHIFT

    @property
    def verdict(self) -> str:
        return "good" if self.good else "refine"


def certify(begin: Start, likelihood: FieldLikelihood, draws: Float[np.ndarray, "draw unknown"]) -> Certified:
    """Return what the error of the surrogate may do to a posterior of which these are equally weighted draws."""
    predicted = begin.predict(draws)
    slopes = likelihood.parabola.parabolas(predicted.mean).slopes
    off, sds = draws - draws.mean(axis=0), np.maximum(draws.std(axis=0), 1e-300)
    moved = (off / sds).T @ (slopes - slopes.mean(axis=0)) / len(draws)
    surprise = _surprise(begin.knowledge.surrogate, begin.whole(draws))
    shift = surprise * np.sqrt(moved**2 @ predicted.variance.mean(axis=0))
    return Certified(float(shift.max()), surprise)


def _surprise(surrogate: FieldSurrogate, x: Float[np.ndarray, "draw dim"]) -> float:
    """Return how much larger than expected the errors at the nearest left-out runs are."""
    z, ratios = _left_out(surrogate)
    middle = surrogate.warping.standardise(x).mean(axis=0)
    nearest = np.argsort(((z - middle) ** 2).sum(axis=1), kind="stable")[: NEAREST * (z.shape[1] + 1)]
    squares = float(ratios[nearest].sum()) + PRIOR_RUNS
    return float(np.sqrt(max(squares / (len(nearest) + PRIOR_RUNS), 1.0)))


@lru_cache(maxsize=2)
def _left_out(surrogate: FieldSurrogate) -> tuple[Float[np.ndarray, "run dim"], Float[np.ndarray, " run"]]:
    """Return the inputs of all runs, and their squared errors when left out over the expected ones."""
    left_out = [process.left_out() for process in surrogate.processes]
    found = sum(one.errors**2 for one in left_out)
    expected = sum(one.variances for one in left_out)
    return surrogate.processes[0].observed.z, np.asarray(found / np.maximum(expected, 1e-300))


TINY = 1e-300


def matched(of: Float[np.ndarray, "dim dim"], wanted: Float[np.ndarray, "dim dim"]) -> Float[np.ndarray, "dim dim"]:
    """Return the matrix that gives row vectors of covariance `of` the covariance `wanted`; the unit one if singular."""
    scale = np.sqrt(np.maximum(np.diag(wanted), TINY))
    try:
        first = np.linalg.cholesky(of / np.outer(scale, scale))
        second = np.linalg.cholesky(wanted / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return np.eye(len(scale))
    return np.asarray(np.linalg.solve(first.T, second.T) * scale / scale[:, None])


LAST = 2048  # draws of the last round, whose mean is the most accurate
LED = 150.0  # effective sample size to reach with the likelihood nearby: enough to fit a mixture for the last round
SPECIMEN_DRAWS = 64  # equally weighted draws that are kept of each posterior

By = Literal["importance", "smc"]
Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]


@dataclass(frozen=True, eq=False)
class SpecimenPosterior:
    """What is known about one specimen, from its own outline alone.

    `given` are its known inputs, `space` its unknown ones. Quantiles are those of 5, 50 and 95 %; draws are equally
    weighted, with this mean and covariance. `effective` is the effective sample size, `by` how it was sampled;
    `certified` says whether the surrogate is good enough for it.
    """

    name: str
    given: Mapping[str, float]
    space: ParameterSpace
    mean: Float[np.ndarray, " dim"]
    covariance: Float[np.ndarray, "dim dim"]
    quantiles: Float[np.ndarray, "three dim"]
    draws: Float[np.ndarray, "draw dim"]
    effective: float
    by: By
    certified: Certified

    def __repr__(self) -> str:
        rows = zip(self.space, self.mean, self.sd, strict=True)
        shown = ", ".join(f"{one.name} = {with_sd(mean, sd)}" for one, mean, sd in rows if one.of_field is None)
        return f"<SpecimenPosterior of {self.name}: {shown}; {self.certified.verdict}>"

    @property
    def sd(self) -> Float[np.ndarray, " dim"]:
        """Posterior standard deviations, shape (dim,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def posterior_of(
    begin: Start, observations: tuple[Observation, ...], measure: Discrepancy, *, name: str = "", seed: int = 1
) -> SpecimenPosterior:
    """Return the posterior of one specimen from its outline with its noise, one for each condition, without any run.

    The name of the specimen, with the seed, 0 or above, decides all random numbers.
    """
    random = np.random.default_rng([seed, *sha256(name.encode()).digest()])
    likelihood = FieldLikelihood(begin.knowledge.surrogate, observations, measure)
    found, by = _sampled(_Target(begin, likelihood), random)
    draws = _few_draws(found, random, begin.unknown)
    return SpecimenPosterior(
        name=name,
        given=dict(begin.given),
        space=begin.unknown,
        mean=found.mean,
        covariance=found.covariance,
        quantiles=_quantiles(found),
        draws=draws,
        effective=found.ess,
        by=by,
        certified=certify(begin, likelihood, draws),
    )


@dataclass(frozen=True, eq=False)
class _Target:
    """The posterior density of a specimen; `near` is a quick likelihood at the mean field that leads to it."""

    begin: Start
    likelihood: FieldLikelihood
    near: Nearby | None = None

    def at_first(self) -> Values:
        predicted = self.begin.predicted
        return self._of(predicted) if self.near is None else self.near.log_likelihood(predicted.mean)

    def at(self, x: Points) -> Values:
        return self._of(self.begin.predict(x)) if self.near is None else self.near.log_likelihood(self.begin.mean(x))

    def _of(self, predicted: FieldPrediction) -> Values:
        """Return log E[L] over the fields that the surrogate considers possible."""
        plain = self.likelihood.at(predicted.mean)
        around = self.likelihood.parabola.parabolas(predicted.mean)
        return np.asarray(plain + log_gain(around, predicted.variance, plain))

    def log_densities(self, x: Points) -> tuple[Values, Values]:
        return calibration.only_inside(self.begin.unknown.inside, self._inside)(x)

    def _inside(self, x: Points) -> tuple[Values, Values]:
        return np.asarray(self.begin.unknown.log_prior(x)), self.begin.log_density(x) + self.at(x)


def _sampled(target: _Target, random: np.random.Generator) -> tuple[Weighted, By]:
    near = target.likelihood.nearby
    if near is not None:
        led = calibration.followed(*_begun(replace(target, near=near)), random, enough=LED)
        if led is not None:
            found = _last_round(target, calibration.fitted(led.x, led.log_weights, random), random)
            if calibration.effective_size(found.log_weights) >= calibration.ENOUGH:
                return found.weighted, "importance"
    pool = calibration.followed(*_begun(target), random)
    if pool is None:
        return _by_smc(target, random), "smc"
    found = _last_round(target, calibration.fitted(pool.x, pool.log_weights, random), random, pool)
    return found.weighted, "importance"


def _begun(target: _Target) -> tuple[calibration.Pool, calibration.Densities]:
    """Return the kept draws of the prior with their posterior density, and the densities of others."""
    begin = target.begin
    pool = calibration.Pool(
        x=begin.points,
        log_counts=np.zeros(len(begin.points)),
        log_first=np.asarray(begin.unknown.log_prior(begin.points)),
        log_target=begin.log_densities + target.at_first(),
        number=len(begin.points),
    )
    return pool, target.log_densities


def _last_round(
    target: _Target,
    mixture: calibration.StudentMixture,
    random: np.random.Generator,
    pool: calibration.Pool | None = None,
) -> calibration.Pool:
    """Return draws of a mixture with their weights, beside those of a pool if there is one."""
    x = _spread_draws(mixture, random)
    first, log_target = target.log_densities(x)
    if pool is not None:
        return pool.extended(mixture, x, first, log_target)
    return calibration.Pool(x, np.zeros(len(x)), mixture.log_density(x), log_target, len(x))


def _spread_draws(mixture: calibration.StudentMixture, random: np.random.Generator) -> Float[np.ndarray, "draw dim"]:
    """Return draws of a mixture from a Sobol sequence with a random shift."""
    dim = mixture.means.shape[1]
    u = (_sequence(dim + 2) + random.random(dim + 2)) % 1.0
    u = np.clip(u, 1e-12, 1 - 1e-12)
    which = np.minimum(np.searchsorted(np.cumsum(mixture.shares), u[:, 0]), len(mixture.shares) - 1)
    stretch = np.sqrt(0.5 * calibration.FREEDOM / gammaincinv(0.5 * calibration.FREEDOM, u[:, 1]))
    steps = np.einsum("dij,dj->di", mixture.factors[which], ndtri(u[:, 2:]))
    return np.asarray(mixture.means[which] + stretch[:, None] * steps)


@lru_cache(maxsize=8)
def _sequence(dim: int) -> Float[np.ndarray, "draw dim"]:
    return sobol(LAST, dim, scramble=0)


def _by_smc(target: _Target, random: np.random.Generator) -> Weighted:
    space = target.begin.unknown

    def log_likelihood(x: Points) -> Values:
        feasible = target.begin.log_density(x) - np.asarray(space.log_prior(x))
        return np.asarray(feasible + target.at(x))

    found = calibration.tempered(log_likelihood, space, random)
    return Weighted(found.positions, np.exp(found.log_weights))


def _quantiles(found: Weighted) -> Float[np.ndarray, "three dim"]:
    columns = []
    for x in found.draws.T:
        order = np.argsort(x, kind="stable")
        below = np.cumsum(found.weights[order]) - 0.5 * found.weights[order]
        columns.append(np.interp([0.05, 0.5, 0.95], below, x[order]))
    return np.stack(columns, axis=1)


def _few_draws(found: Weighted, random: np.random.Generator, space: ParameterSpace) -> Float[np.ndarray, "draw dim"]:
    """Return a few draws, spread along the longest axis, moved to the posterior's moments unless they leave the box."""
    scale = np.maximum(found.sd, 1e-300)
    vectors = np.linalg.eigh(found.covariance / np.outer(scale, scale))[1]
    order = np.argsort((found.draws / scale) @ vectors[:, -1], kind="stable")
    draws = found.draws[order][systematic_indices(found.weights[order], SPECIMEN_DRAWS, random)]
    of = np.atleast_2d(np.cov(draws.T, bias=True))
    moved = found.mean + (draws - draws.mean(axis=0)) @ matched(of, found.covariance)
    inside = (moved >= space.low) & (moved <= space.high)
    return np.asarray(np.where(inside, moved, draws))


OF_EACH, MOST = 8, 400  # largest number of draws of each posterior, and of all together, that are considered
LEAST_FEASIBLE = 0.5  # least probability that a run succeeds, relative to the safest one


def runs_for(begin: Start, specimens: Sequence[SpecimenPosterior], number: int) -> Float[np.ndarray, "run dim"]:
    """Return inputs of at most `number` runs at posterior draws, which most reduce the variance of the field there."""
    of_each = max(min(OF_EACH, MOST // max(len(specimens), 1)), 1)
    step = max(len(specimens) * of_each // MOST, 1)
    few = [(one, one.draws[:: max(len(one.draws) // of_each, 1)][:of_each]) for one in specimens[::step]]
    places = [begin.with_given(one.given).whole(draws) for one, draws in few]
    x = np.concatenate(places) if places else np.empty((0, begin.space.dim))
    x = x[np.exp(begin.knowledge.log_feasibility(x)) >= LEAST_FEASIBLE] if len(x) else x
    if not len(x):
        return x
    surrogate = begin.knowledge.surrogate
    z = surrogate.warping.standardise(x)
    covariances = np.array([process.covariance(z, z) for process in surrogate.processes])
    nuggets = surrogate.scatter_variances
    chosen: list[int] = []
    while len(chosen) < min(number, len(x)):
        variances = np.einsum("mpp->mp", covariances) + nuggets[:, None] + 1e-15
        gains = (covariances**2).sum(axis=1) / variances
        total = gains.sum(axis=0)
        total[chosen] = -1.0
        best = int(np.argmax(total))
        chosen.append(best)
        row = covariances[:, best]
        covariances = covariances - row[:, :, None] * row[:, None, :] / variances[:, best, None, None]
    return np.asarray(x[chosen])
