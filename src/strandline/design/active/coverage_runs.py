"""Regions that no run has looked at: how large they may be, where to look next, and what runs there say.

A posterior that was checked at its own draws can still miss a mode elsewhere: the surrogate rules out what it has not
seen. So runs are placed over the prior, blind to the surrogate, until a region of a given share x of the prior's mass
holds one with 95 % probability. A region is a ball in the prior's quantiles, with its middle anywhere.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.distance import cdist
from scipy.special import logsumexp
from scipy.stats import norm

from strandline.design.active.state import State
from strandline.design.refinement import sobol
from strandline.discrepancy import apart
from strandline.interface import Interface
from strandline.parameters import ParameterSpace
from strandline.runs import RunRecord

SURE = 0.95  # probability with which a region is found
MIDDLES, POOL = 512, 2048
"""Balls tried; points of the Sobol sequence that measure their mass, and are the places to look at."""
SHARES = (0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5)
"""Shares of the prior's mass that the certificate distinguishes."""
MOST_SEEN = 10
"""Most inputs of which runs say anything about other regions: one run at the medians lies in 95 % of the balls with 2 %
of the prior's mass if there are 30, with 7 % if there are 14; of ten, with 15 %."""
LEFT_OUT_SDS, LEFT_OUT_NOISE = 2.0, 1.0
"""The same, at least, for a run that is predicted from the others, which have learnt to expect errors like its own."""
LEFT_OUT_SHARE, AROUND_SHARE = 0.05, 0.1
"""Least error of such a run, and of runs around it or elsewhere, as a share of the distance between its interface and
that of the posterior: below, truth and prediction agree that nothing fits there. Errors at the corners of a smooth
drop's box were 2 to 3 sds, but .002 to .098 of it; those that led to pockets and kinks of hard models .076 to 1."""
FEW = 4  # largest number of inputs for which balls, not cubes, are filled
WEIGHTY = 0.01  # share of the evidence from which a region matters that the surrogate had ruled out
UNLIKELY = 2.0  # log-likelihood by which a run exceeds what was expected there
STANDARD_DEVIATIONS, NOISE_LENGTHS = 5.0, 5.0
"""A run is odd whose interface is farther from the predicted one than so many predicted sds and noise lengths, and than
`AROUND_SHARE` of its distance from the posterior's."""


def farthest_first(points: Float[np.ndarray, "point dim"], nearest: Float[np.ndarray, " point"]) -> Iterator[int]:
    """Yield the indices of points, each the farthest from those before and from others.

    `nearest` is the distance of each to the nearest of the others; below 0 for a point that is not wanted.
    """
    while nearest.max(initial=-1.0) >= 0:
        farthest = int(np.argmax(nearest))
        yield farthest
        nearest = np.minimum(nearest, cdist(points, points[farthest : farthest + 1])[:, 0])
        nearest[farthest] = -1.0


def least_found(x: Float[np.ndarray, "run dim"], space: ParameterSpace) -> float:
    """Return the smallest share of the prior's mass such that a region of it holds a run with 95 % probability.

    Runs count whether they succeeded or failed.
    """
    middles, radii = _balls(space.dim)
    nearest = cdist(middles, space.prior_shares(x)).min(axis=1)
    for share, radius in zip(SHARES, radii, strict=True):
        if (nearest <= radius).mean() >= SURE:
            return share
    return 1.0


def points_elsewhere(
    x: Float[np.ndarray, "run dim"],
    space: ParameterSpace,
    share: float,
    most: int,
    likely: Callable[[Float[np.ndarray, "point dim"]], Bool[np.ndarray, " point"]] | None = None,
) -> Float[np.ndarray, "new dim"]:
    """Return the inputs to run so that regions of this share of the prior's mass are found, at most `most`.

    Each is the point that is farthest from all runs, in the prior's quantiles. With `likely`, which tells where runs
    may succeed, no point lies where they fail, nor need a region be found whose middle does.
    """
    if share >= 1:
        return np.empty((0, space.dim))
    middles, radii = _balls(space.dim)
    radius = np.array([np.interp(share, SHARES, row) for row in radii.T]) if share < SHARES[-1] else radii[-1]
    pool, known = sobol(POOL, space.dim, scramble=0), space.prior_shares(x)
    if likely is not None:
        here = likely(space.prior_quantiles(middles))
        pool, middles, radius = pool[likely(space.prior_quantiles(pool))], middles[here], radius[here]
        if not len(pool) or not len(middles):
            return np.empty((0, space.dim))
    to_pool, nearest = cdist(pool, known).min(axis=1), cdist(middles, known).min(axis=1)
    chosen: list[int] = []
    for farthest in farthest_first(pool, np.where(to_pool > 0, to_pool, -1.0)):
        if len(chosen) >= most or (nearest <= radius).mean() >= SURE:
            break
        chosen.append(farthest)
        nearest = np.minimum(nearest, cdist(middles, pool[farthest : farthest + 1])[:, 0])
    return space.prior_quantiles(pool[chosen]) if chosen else np.empty((0, space.dim))


def points_around(
    odd: Float[np.ndarray, "odd dim"], x: Float[np.ndarray, "run dim"], space: ParameterSpace, share: float, number: int
) -> Float[np.ndarray, "new dim"]:
    """Return inputs near runs that the surrogate did not expect, each as far as possible from all runs.

    They lie in a ball with this share of the prior's mass around each.
    """
    row = min(int(np.searchsorted(SHARES, share)), len(SHARES) - 1)
    radius = float(np.median(_balls(space.dim)[1][row]))
    cube = 2 * sobol(POOL, space.dim, scramble=3) - 1
    ball = radius * cube[(cube**2).sum(axis=1) <= 1][: POOL // 4] if space.dim <= FEW else radius * cube[: POOL // 4]
    pool = np.concatenate([one + ball for one in space.prior_shares(odd)])
    pool = pool[((pool > 0) & (pool < 1)).all(axis=1)]
    nearest = cdist(pool, space.prior_shares(x)).min(axis=1)
    return space.prior_quantiles(pool[[*islice(farthest_first(pool, nearest), number)]])


def _balls(dim: int) -> tuple[Float[np.ndarray, "ball dim"], Float[np.ndarray, "share ball"]]:
    """Return middles, and the radii at which the part of the ball inside the cube has each of the shares."""
    middles, pool = sobol(MIDDLES, dim, scramble=1), sobol(POOL, dim, scramble=2)
    return middles, np.quantile(cdist(middles, pool), SHARES, axis=1)


@dataclass(frozen=True, eq=False)
class Surprise:
    """A run away from the posterior that the surrogate did not expect.

    It `fits` if it fits the observation so well that its region may hold a share of the posterior; `errors` is the
    distance of the predicted interface, in predicted standard deviations.
    """

    x: Float[np.ndarray, " dim"]
    fits: bool
    errors: float

    def words(self, space: ParameterSpace) -> str:
        """Return what is wrong, in words."""
        where = ", ".join(f"{name} {value:.3g}" for name, value in space.as_mapping(self.x).items())
        if self.fits:
            return f"a run at {where} fits the observation, which the surrogate had ruled out"
        sds = f"{self.errors:.0f} predicted standard deviations"
        return f"the interface of a run at {where} is {sds} from the prediction"


def surprises(
    state: State,
    x: Float[np.ndarray, "run dim"],
    records: Sequence[RunRecord],
    log_likelihoods: Float[np.ndarray, " run"],
    share: float,
    noise: float,
    *,
    limits: tuple[float, float, float] = (STANDARD_DEVIATIONS, NOISE_LENGTHS, AROUND_SHARE),
) -> tuple[Surprise, ...]:
    """Return which runs the surrogate did not expect, given the posterior before them.

    All of them succeeded; each has a log-likelihood by the true model, and may stand for this `share` of the prior's
    mass. An interface is not expected beyond the `limits`, in predicted standard deviations, in `noise`, the shift of
    the interface that the noise hides, mm, and as a share of the distance from the posterior's.
    """
    if not len(x):
        return ()
    surrogate = state.knowledge.surrogate
    expected = state.knowledge.expected(x)
    log_ratio = logsumexp(state.log_weights_tempered + state.log_expected - 0.5 * state.log_plug_in)
    log_evidence = state.log_evidence_tempered + float(log_ratio)
    weight = math.log(share) + log_likelihoods - log_evidence
    fits = (log_likelihoods - expected > UNLIKELY) & ~(weight < math.log(WEIGHTY))
    errors = np.array([_distance(surrogate.interfaces(x[i]), record.interfaces) for i, record in enumerate(records)])
    beyond = errors / np.maximum(surrogate.predicted_error(x), np.finfo(float).tiny)
    least = np.maximum(limits[1] * noise, limits[2] * _distances(state, x) / math.sqrt(len(surrogate.layouts)))
    odd = fits | ((beyond > limits[0]) & (errors > least))
    return tuple(Surprise(x[i], bool(fits[i]), float(beyond[i])) for i in np.flatnonzero(odd))


def left_out_surprise(
    state: State, noise: float, before: Collection[bytes], known: Collection[bytes]
) -> Surprise | None:
    """Return the run that the others predict worst, if that is much worse than they should and matters; else None.

    Runs do not count around which others were made `before`, nor those `known` to be draws of the posterior, which are
    checked otherwise: inputs as bytes. `noise` is the shift of the interface that the noise hides, mm.
    """
    surrogate, x = state.knowledge.surrogate, state.knowledge.x[state.knowledge.ok]
    found = [process.left_out() for process in surrogate.processes]
    errors = np.sqrt(sum(one.errors**2 for one in found))
    sds = np.sqrt(sum(one.variances for one in found) + surrogate.modes.remainder**2)
    beyond = errors / np.maximum(sds, np.finfo(float).tiny)
    beyond[errors / math.sqrt(len(surrogate.layouts)) < LEFT_OUT_NOISE * noise] = 0.0
    beyond[errors < LEFT_OUT_SHARE * _distances(state, x)] = 0.0
    beyond[[row.tobytes() in before or row.tobytes() in known for row in x]] = 0.0
    worst = int(np.argmax(beyond))
    usual = max(LEFT_OUT_SDS, float(norm.isf(1.0 / len(x))))  # one of so many normal errors is larger on average
    return Surprise(x[worst], False, float(beyond[worst])) if beyond[worst] > usual else None


def _distances(state: State, x: Float[np.ndarray, "run dim"]) -> Float[np.ndarray, " run"]:
    """Return how far the predicted interfaces are from that at the posterior's mean, in all conditions together, mm."""
    mean = state.knowledge.surrogate.mean
    return np.asarray(np.linalg.norm(mean(x) - mean(state.mean[None]), axis=1))


def _distance(predicted: Mapping[str, Interface], found: Mapping[str, Interface]) -> float:
    """Return the root mean square distance between interfaces, over all conditions, mm."""
    return math.sqrt(float(np.mean([apart(one, found[name])[0] ** 2 for name, one in predicted.items()])))
