"""Settings of an active design, and which inputs it runs next.

Runs are chosen among particles of the tempered posterior, and a share explores. The classifier of failures only weighs
the posterior and the choice of runs. If the observation is best explained by inputs that fail, the likelihood outweighs
it and batch after batch would go there. So once a tenth of the runs allowed has failed where that was likely, the
others are placed where runs are expected to succeed.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from strandline.design.active.checking import FEWEST_DRAWS, MOST_FAILED, Tolerances
from strandline.design.active.state import Knowledge, State
from strandline.design.refinement import over_prior, sobol
from strandline.foundations import lookup, require, require_types
from strandline.parameters import ParameterSpace
from strandline.posterior import subset
from strandline.runs import RunRecord

MOST = 0.1  # largest share of the runs allowed that may be lost where runs are known to fail
UNLIKELY, SAFE = 0.5, 0.95
"""Probability of success, relative to the safest run, below which a region is known to fail; from which it is safe."""
POOL = 2048  # points of the Sobol sequence from which runs are taken if hardly a particle is safe
FEWEST = 30  # fewest safe particles to choose from
CANDIDATES, TARGETS = 300, 200
"""Particles of π_γ to choose runs from; particles at which runs are to help, half of them from the posterior."""
EXPLORATION = 64  # points of the Sobol sequence considered for an exploring run
_LEADING = 6  # modes whose variances count
Candidates = Float[np.ndarray, "candidate dim"]
Others = Float[np.ndarray, "other dim"]
Targets = Float[np.ndarray, "target dim"]
Point = Float[np.ndarray, " dim"]
Points = Float[np.ndarray, "point dim"]
Criterion = Callable[[State, Candidates, Others, Targets], Callable[[bool], Point]]
"""(state, candidates, points to explore, targets) → a function that picks a point, given whether to explore."""


@dataclass(frozen=True, eq=False)
class Losses:
    """Runs lost where runs are known to fail, and how many more may be, of the `runs` that were allowed.

    `first` are inputs of the first runs, as bytes: these were placed before anything was known. `price` is the time
    that a lost run takes, in those of a good one, at least 1: a hang costs as much as many runs.
    """

    knowledge: Knowledge
    runs: int
    first: Collection[bytes]
    price: float = 1.0

    @property
    def lost(self) -> int:
        """Number of runs after the first ones that failed where the classifier expects it."""
        failed = [row for row in self.knowledge.x[~self.knowledge.ok] if row.tobytes() not in self.first]
        return int((~self.likely(np.array(failed))).sum()) if failed else 0

    @property
    def left(self) -> float:
        return MOST * self.runs / self.price - self.lost

    def chance(self, x: Points) -> Float[np.ndarray, " point"]:
        """Return the probability that a run succeeds, relative to the safest run."""
        return np.asarray(np.exp(self.knowledge.log_feasibility(x)))

    def likely(self, x: Points) -> Bool[np.ndarray, " point"]:
        """Return which points do not lie where runs are known to fail."""
        return np.asarray(self.chance(x) >= UNLIKELY)

    def bears(self, x: Float[np.ndarray, "run dim"]) -> bool:
        """Return whether runs at these points may be made: all of them are safe, or the losses to expect are few."""
        chance = self.chance(x)
        return bool((1 - chance[chance < SAFE]).sum() <= max(self.left, 0.0))

    def safest(self, x: Points, fewest: int) -> Float[np.ndarray, "safe dim"]:
        """Return the safe ones of these points, at least the `fewest` safest."""
        chance = self.chance(x)
        return x[chance >= min(SAFE, float(np.sort(chance)[-min(fewest, len(x))]))]

    def bearable(self, x: Float[np.ndarray, "run dim"]) -> Float[np.ndarray, "kept dim"]:
        """Return the points, without those where runs are known to fail if no more may be lost."""
        return x if self.bears(x) else x[self.likely(x)]

    def bears_check(self, state: State, draws: int) -> bool:
        """Return whether a check with this number of draws of the posterior may be made.

        It cannot pass if more of them fail than a check tolerates, and these would be lost.
        """
        risk = self._risk(state)
        return risk <= MOST_FAILED or draws <= self.left

    def words(self, state: State) -> tuple[str, ...]:
        """Return how much of the posterior lies where runs fail if this kept it from being checked."""
        risk = self._risk(state)
        if risk <= MOST_FAILED or not self.lost:
            return ()
        return (f"{risk:.0%} of the posterior lies where runs are likely to fail; {self.lost} runs were lost there",)

    def _risk(self, state: State) -> float:
        """Return the share of draws of the posterior whose run is expected to fail."""
        return float(np.exp(state.log_weights) @ (1 - self.chance(state.positions)))


def price_of_a_hang(records: Sequence[RunRecord]) -> float:
    """Return the mean time of the runs that ended at their time limit over the median of good ones, at least 1."""
    good, hung = ([one.seconds for one in records if one.state == state] for state in ("ok", "timeout"))
    return max(1.0, float(np.mean(hung) / max(np.median(good), 1e-9))) if good and hung else 1.0


def safe_candidates(
    losses: Losses, state: State, particles: Float[np.ndarray, "particle dim"], space: ParameterSpace, seed: int
) -> Candidates:
    """Return the safe particles; if these are few, points of the box that are safe too, the likeliest by π_γ."""
    safe = particles[losses.chance(particles) >= SAFE]
    if len(safe) >= FEWEST:
        return safe
    pool = losses.safest(space.prior_quantiles(sobol(POOL, space.dim, scramble=4)), FEWEST)
    value = 0.5 * state.knowledge.plug_in(pool)
    weights = np.exp(value - value.max())
    drawn = pool[subset(weights / weights.sum(), 10 * FEWEST, seed)]
    best = pool[np.argsort(-value)[:FEWEST]]
    return np.unique(np.concatenate([safe, drawn, best]), axis=0)


def choose(
    state: State,
    space: ParameterSpace,
    number: int,
    *,
    explore: float,
    first: int,
    criterion: str,
    seed: int,
    losses: Losses | None = None,
    near: bool = False,
) -> Float[np.ndarray, "run dim"]:
    """Return the inputs of the next runs, each chosen as if the ones before it had been made.

    A share `explore` of all runs, of which `first` were made before, explores where least is known. With `losses`, only
    safe inputs are chosen; with `near`, draws of the posterior, not of π_γ.
    """
    weights = np.exp(state.log_weights if near else state.log_weights_tempered)
    candidates = state.positions[subset(weights, CANDIDATES, seed)]
    candidates = np.unique(candidates, axis=0)
    unknown = over_prior(space, first + EXPLORATION)[first:]
    if losses is not None:
        candidates = safe_candidates(losses, state, candidates, space, seed)
        unknown = losses.safest(unknown, number)
    half = [subset(w, TARGETS // 2, seed + 1) for w in (np.exp(state.log_weights), weights)]
    targets = np.unique(state.positions[np.concatenate(half)], axis=0)
    pools = {False: _new(candidates, state), True: _new(unknown, state)}
    picking = criterion_named(criterion)(state, pools[False], pools[True], targets)
    picked: list[Point] = []
    for k in range(number):
        exploring = int((first + k + 1) * explore) > int((first + k) * explore)
        picked.append(_accepted(picking(exploring), pools, picked, criterion))
    return np.array(picked)


def _accepted(found: object, pools: Mapping[bool, Points], before: Sequence[Point], criterion: str) -> Point:
    """Return the point that a criterion picked; it must be a given one, and not one of `before` if others are left."""
    point = np.asarray(found)
    given = any(point.shape == pool.shape[1:] and (pool == point).all(axis=1).any() for pool in pools.values())
    used_up = len(before) >= min(len(pool) for pool in pools.values())
    right = given and (used_up or not any(np.array_equal(point, one) for one in before))
    words = "one of the points that it was given, each once", "Check it with strandline.testing.criteria."
    require(right, f"what the criterion {criterion} picks", point.tolist(), *words)
    return point


def _new(points: Points, state: State) -> Float[np.ndarray, "new dim"]:
    """Return the points that have not been run."""
    known = {row.tobytes() for row in state.knowledge.x}
    return points[[row.tobytes() not in known for row in points]]


def expected_variance(
    state: State, candidates: Candidates, unknown: Others, targets: Targets
) -> Callable[[bool], Point]:
    """Pick the run with the largest variance reduction at the targets, times its probability of success.

    The posterior variance of a Gaussian process does not depend on what the runs will return, so several can be chosen
    one after the other: Sacks et al. (1989), Section 5; Cohn (1996). Failed runs count as if they had yielded
    information: a run near them would fail as well.
    """
    failed = state.knowledge.x[~state.knowledge.ok]
    z = [state.knowledge.surrogate.warping.standardise(x) for x in (candidates, unknown, targets, failed)]
    a, b = len(candidates), len(candidates) + len(unknown)
    end = b + len(targets)
    everything = np.concatenate([candidates, unknown])
    processes = state.knowledge.surrogate.processes[:_LEADING]
    covariances = [p.covariance(np.concatenate(z), np.concatenate(z)) for p in processes]
    noise = [p.nugget * p.scale for p in processes]
    chance = np.exp(state.knowledge.log_feasibility(everything))
    taken = np.zeros(b, bool)

    def run(point: int) -> None:
        """Condition the covariances on a run at this point."""
        for C, tau in zip(covariances, noise, strict=True):
            C -= np.outer(C[:, point], C[point]) / (C[point, point] + tau + _tiny(C))

    for point in range(end, end + len(failed)):
        run(point)

    def pick(exploring: bool) -> Point:
        """Return the inputs of the best run left, shape (dim,), and count it as made."""
        if exploring:
            gain = sum(np.diagonal(C)[:b] for C in covariances) * chance
        else:
            parts = zip(covariances, noise, strict=True)
            gain = sum((C[b:end, :b] ** 2).sum(axis=0) / (np.diagonal(C)[:b] + tau + _tiny(C)) for C, tau in parts)
            gain = gain * chance
        allowed = ~taken & ((np.arange(b) >= a) == exploring)
        best = int(np.argmax(np.where(allowed, gain, -np.inf)))
        taken[best] = True
        run(best)
        return np.asarray(everything[best])

    return pick


def repulsion(state: State, candidates: Candidates, unknown: Others, targets: Targets) -> Callable[[bool], Point]:
    """Pick the draw of the tempered posterior that is farthest from all runs, in standard deviations of the targets."""
    standardise = state.knowledge.surrogate.warping.standardise
    spread = np.maximum(standardise(targets).std(axis=0), 1e-6)
    known = [standardise(state.knowledge.x) / spread]
    pools = {False: candidates, True: unknown}

    def pick(exploring: bool) -> Point:
        """Return the point farthest from all runs, shape (dim,), and count it as a run."""
        pool = pools[exploring]
        z = standardise(pool) / spread
        distances = np.min(np.linalg.norm(z[:, None] - np.concatenate(known), axis=2), axis=1)
        best = int(np.argmax(distances))
        known.append(z[best : best + 1])
        return np.asarray(pool[best])

    return pick


def _tiny(C: Float[np.ndarray, "all all"]) -> float:
    return 1e-12 * float(np.diagonal(C).max()) + 1e-300


CRITERIA: dict[str, Criterion] = {"expected_variance": expected_variance, "repulsion": repulsion}


def criterion_named(name: str) -> Criterion:
    """Return the criterion of that name in `CRITERIA`, or the function ``module:name``.

    Raises:
        InvalidInput: There is no such criterion, or it is not a function.
    """
    found: Criterion = lookup(CRITERIA, name, "criterion")
    expected = "a function as strandline.design.active.Criterion describes it"
    require(callable(found), "criterion", name, expected, "Check it with strandline.testing.criteria.")
    return found


FEWEST_CHECKED = 20  # smallest number of draws of a whole check
LARGEST_BATCH = 16  # largest number of runs that are chosen together if none is stated


@dataclass(frozen=True)
class Active:
    """How an active design goes on and when it stops.

    Args:
        runs: Maximum number of runs, those of the checks included; at least `initial` + 6. With fewer than `initial` +
            `check`, a check is smaller and settles less. Runs from an earlier ``study.yaml`` or a reused study do not
            count.
        initial: First runs, from the Sobol sequence in the prior's quantiles, at least 3; default: 4 + 2 × number of
            inputs, but 3 with sensitivities, and 3 besides a step along each input with `differences`.
        batch: Runs chosen together; default: number of workers, or 5 % of the runs so far if that is more; within
            2 to 16.
        explore: Share of runs placed where least is known, whatever the posterior, 0 to 0.5.
        criterion: How to choose the others: ``expected_variance`` most reduces the variance of the predicted interface
            over the posterior; ``repulsion`` takes the farthest from all runs; or ``module:name`` of a criterion of
            your own.
        check: Most posterior draws, besides 6 to 10 that reach into the tails, at which to run the true model before
            stopping, at least 20; fewer if they leave no doubt.
        unseen: Share of the prior's mass, 0.02 to 1: before it stops, the design looks for modes elsewhere until a
            region of this share holds a run with 95 % probability. Half the share costs about twice the runs; with
            1 it does not look. With six inputs or more and sensitivities or `differences`, it looks only for shares
            below 0.1.
        change: Largest change over the last batch for a check to begin: of a mean in standard deviations, of a standard
            deviation in natural logarithms; batches with fewer runs than inputs count together, with sensitivities
            those with fewer than half as many.
        shift: Largest shift of a mean by the check's importance weights, in standard deviations beyond its standard
            error.
        width: Largest change of a standard deviation by these weights, in natural logarithms.
        k_hat: Upper limit for the Pareto shape of these weights, unless 98 % of draws are effective, or 1 % of as many
            weights without a heavy tail have a larger one.
        effective: Share of draws that must be effective, between 0 and 1.
        exact: With six inputs or more and sensitivities or `differences`, whether to draw from the true posterior in
            the end, by some thousand runs beyond `runs`: yes, no, or by default only if the design has not settled
            after 40 draws or all of its runs, and these take a minute at most.
        differences: With six inputs or more and a model without sensitivities, whether to begin with a step along each
            input, go a step along each informed direction from each best fit, and draw then, as with sensitivities.
        patience: Once half a batch is done, the next does not wait for a run longer than this many times the longest
            before it; at least 1.

    Raises:
        InvalidInput: a number out of its range.
    """

    runs: int
    initial: int | None = None
    batch: int | None = None
    explore: float = 0.1
    criterion: str = "expected_variance"
    check: int = 25
    unseen: float = 0.1
    change: float = 0.3
    shift: float = 0.1
    width: float = 0.15
    k_hat: float = 0.5
    effective: float = 0.8
    exact: bool | None = None
    differences: bool = False
    patience: float = 3.0

    def __post_init__(self) -> None:
        require_types(self)
        first = self.initial or 3
        left, least = max(self.runs - first, 1), first + FEWEST_DRAWS
        most = f"at most {left}, the runs that are left of {self.runs} after the first {first}"
        criterion_named(self.criterion)
        for name, right, expected in (
            ("check", self.check >= FEWEST_CHECKED, f"at least {FEWEST_CHECKED} draws"),
            ("initial", self.initial is None or self.initial >= 3, "at least 3 runs"),
            ("batch", self.batch is None or self.batch >= 1, "at least 1 run"),
            ("explore", 0 <= self.explore <= 0.5, "a share from 0 to 0.5"),
            ("effective", 0 < self.effective < 1, "a share between 0 and 1"),
            ("unseen", 0.02 <= self.unseen <= 1, "a share from 0.02 to 1"),
            *((name, getattr(self, name) > 0, "a number above 0") for name in ("change", "shift", "width", "k_hat")),
            ("patience", self.patience >= 1, "at least 1"),
            ("runs", self.runs >= least, f"at least {least}: {first} first ones and a check of {FEWEST_DRAWS}"),
            ("batch", self.batch is None or self.batch <= left, most),
        ):
            require(right, name, getattr(self, name), expected, "Change it.")

    @property
    def kept_for_check(self) -> int:
        """Return the number of runs kept for a check: half of those after the first ones if these are few."""
        left = self.runs - (self.initial or 3)
        return self.check if left >= self.check else max(FEWEST_DRAWS, left // 2)

    @property
    def tolerances(self) -> Tolerances:
        return Tolerances(self.shift, self.width, self.k_hat, self.effective)
