"""Sums of squares of residuals, of the observation and of drawn errors: overall, by condition and by part of the arc.

The statistics are computed from what is left when inputs, errors of the surrogate and global errors of the observation
are fitted, for drawn residuals as for the observed ones. So they do not depend on the inputs, and those of a right
model have the distribution of those drawn, as far as the prediction is linear in the inputs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.cluster.vq import kmeans2
from scipy.linalg import block_diag

from strandline.calibration.misfit.best_fit import BestFit, Residuals
from strandline.calibration.misfit.verdict import Effort
from strandline.interface import ErrorModel, Observation, arc_lengths, steady_lengths

PATCHES, FEWEST_IN_PATCH = 8, 4
"""Patches of a surface, and the fewest points of a patch on average."""
ROUNDS = 20
"""Rounds in which the middles of the patches move."""
WAVES, FEWEST_FOR_WAVE = 6, 4
"""Waves along an arc, the first one constant, and the fewest points for each."""
TOGETHER = 0.01
"""Squared change of all residuals, in their standard deviations, by a combination of inputs over its prior, below which
these inputs only act together: differences cannot tell such a change, and it hardly moves a wave."""
EXPLAINED = 1e-6
"""Variance of a combination of waves, relative to the largest one, below which inputs or global errors explain it."""
BLOCK = 500
"""Draws processed together; this bounds the memory."""
PARTS, FEWEST_POINTS = 6, 4
"""Parts of the arc of an interface, and the fewest points of a part on average."""


def patches_of(points: Float[np.ndarray, "point 3"]) -> Int[np.ndarray, " point"]:
    """Return the number of the patch to which each point belongs.

    The middles begin with the point farthest from the centre and the points farthest from those before; then each moves
    to the mean of the points nearest to it (k-means).
    """
    count = max(min(PATCHES, len(points) // FEWEST_IN_PATCH), 1)
    away = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen = [int(np.argmax(away))]
    apart = np.full(len(points), np.inf)
    for _ in range(count - 1):
        apart = np.minimum(apart, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(apart)))
    which = kmeans2(points, points[chosen], iter=ROUNDS, minit="matrix")[1]
    return np.unique(which, return_inverse=True)[1].astype(int)


def waves_of(observations: Sequence[Observation]) -> Float[np.ndarray, "seen wave"]:
    """Return cos(kπ s/L) at the points of each observed polyline, zero at those of the others; none for surfaces."""
    blocks = []
    for interface in (seen.interface for seen in observations):
        number, count, places = len(interface.points), 0, np.zeros(0)
        if interface.dim == 2:
            places = np.pi * arc_lengths(interface) / float(steady_lengths(interface).sum())
            count = min(WAVES, number // FEWEST_FOR_WAVE)
        blocks.append(np.reshape([np.cos(k * places) for k in range(count)], (count, number)).T)
    return np.asarray(block_diag(*blocks))


def beyond(
    waves: Float[np.ndarray, "seen wave"], by_inputs: Float[np.ndarray, "seen dim"], model: ErrorModel
) -> Float[np.ndarray, "seen wave"]:
    """Return the part Φ' of the waves Φ that no input can cause: Φ'ᵀ C⁻¹ J = 0, but for what inputs hardly cause."""
    if not by_inputs.size:
        return waves
    weighed = model.solved(by_inputs.T)
    values, vectors = np.linalg.eigh(weighed @ by_inputs)
    kept = values > TOGETHER
    told = vectors[:, kept]
    return np.asarray(waves - by_inputs @ (told / values[kept]) @ (told.T @ (weighed @ waves)))


def waves_p(drawn: Float[np.ndarray, "row wave"], observed: Float[np.ndarray, "1 wave"]) -> float | None:
    """Return the probability that a right model leaves waves as large; None without waves.

    A sum of squares over all points spreads its power over as many directions as there are points, this one over a few:
    it is Neyman's smooth test (1937) for residuals. The waves are first made independent, with the covariance of the
    drawn ones.
    """
    values, vectors = np.linalg.eigh(drawn.T @ drawn / len(drawn))
    kept = values > EXPLAINED * values.max(initial=0.0)
    if not kept.any():
        return None
    white = vectors[:, kept] / np.sqrt(values[kept])
    squares, own = ((drawn @ white) ** 2).sum(axis=1), float(((observed @ white) ** 2).sum())
    return float((1 + (squares >= own).sum()) / (1 + len(drawn)))


@dataclass(frozen=True)
class Span:
    """A part of the arc of an observed interface from `begin` to `end`, mm, or a patch of a surface with this mean
    point.
    """

    observation: int
    begin: float
    end: float
    centre: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class ArcParts:
    """Parts of the arcs of all observed interfaces, or patches of surfaces: membership of each residual, 1 or 0; and
    waves along these arcs, see `waves_of`.
    """

    spans: tuple[Span, ...]
    members: Float[np.ndarray, "seen part"]
    waves: Float[np.ndarray, "seen wave"]


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of residuals, one row for each draw: rᵀ C⁻¹ r over all observations and over each, sums of r²/D and
    means of r, mm, over each part without global errors, and components of C⁻¹ r along the waves.
    """

    whole: Float[np.ndarray, " row"]
    conditions: Float[np.ndarray, "row condition"]
    squares: Float[np.ndarray, "row part"]
    means: Float[np.ndarray, "row part"]
    waves: Float[np.ndarray, "row wave"]


def parts_of(observations: Sequence[Observation]) -> ArcParts:
    """Return equal parts of the arc of each observed polyline, those with points, and patches of each surface."""
    spans, blocks = [], []
    for k, interface in enumerate(seen.interface for seen in observations):
        number = len(interface.points)
        if interface.dim == 2:
            whole, count = float(steady_lengths(interface).sum()), max(min(PARTS, number // FEWEST_POINTS), 1)
            which = np.minimum((count * arc_lengths(interface) / whole).astype(int), count - 1)
            spans += [Span(k, whole * part / count, whole * (part + 1) / count) for part in np.unique(which).tolist()]
        else:
            which = patches_of(interface.points)
            centres = [interface.points[which == part].mean(axis=0).tolist() for part in np.unique(which)]
            spans += [Span(k, 0.0, 0.0, (x, y, z)) for x, y, z in centres]
        blocks.append((which[:, None] == np.unique(which)).astype(float))
    return ArcParts(tuple(spans), block_diag(*blocks), waves_of(observations))


def observed_statistics(residuals: Residuals, fit: BestFit, parts: ArcParts) -> Statistics:
    """Return the statistics of the observation, in one row."""
    return _statistics(residuals, fit.with_modes(residuals.model).solved(fit.residuals[None]), parts)


def drawn_statistics(
    residuals: Residuals, fit: BestFit, parts: ArcParts, random: np.random.Generator, effort: Effort
) -> Statistics:
    """Return the statistics of drawn observations of the model, with inputs drawn from their priors."""
    whole, causes, found = fit.with_causes(residuals.model), fit.causes, []
    draws = max(effort.draws, effort.per_part * len(parts.spans))
    for first in range(0, draws, BLOCK):
        number = min(BLOCK, draws - first)
        caused = random.standard_normal((number, causes.shape[1])) @ causes.T
        drawn = residuals.drawn(number, random) + caused
        found.append(_statistics(residuals, whole.solved(drawn), parts))
    names = ("whole", "conditions", "squares", "means", "waves")
    return Statistics(*(np.concatenate([getattr(one, name) for one in found]) for name in names))


def _statistics(residuals: Residuals, weighted: Float[np.ndarray, "row seen"], parts: ArcParts) -> Statistics:
    """Return the statistics of C⁻¹ q, q being the residuals that are left: qᵀ C⁻¹ q = Σ D w² + |Bᵀ w|²."""
    local, shared = residuals.model.local, residuals.model.shared
    squares = local * weighted**2
    common = [((weighted[:, part] @ shared[part]) ** 2).sum(axis=1) for part in residuals.parts]
    by_condition = [squares[:, part].sum(axis=1) for part in residuals.parts]
    return Statistics(
        whole=squares.sum(axis=1) + ((weighted @ shared) ** 2).sum(axis=1),
        conditions=np.stack([one + other for one, other in zip(by_condition, common, strict=True)], axis=1),
        squares=squares @ parts.members,
        means=(local * weighted) @ (parts.members / parts.members.sum(axis=0)),
        waves=weighted @ parts.waves,
    )


def tail(
    drawn: Float[np.ndarray, "row *statistic"], observed: Float[np.ndarray, "#row *statistic"]
) -> Float[np.ndarray, "*statistic"]:
    """Return the share of draws that reach what was observed, the observation counted as one of them."""
    return np.asarray((1 + (drawn >= observed).sum(axis=0)) / (1 + len(drawn)))


def corrected(p: Float[np.ndarray, " test"]) -> Float[np.ndarray, " test"]:
    """Return p-values corrected for their number (Holm 1979)."""
    order, factors = np.argsort(p), len(p) - np.arange(len(p))
    out = np.empty(len(p))
    out[order] = np.minimum(np.maximum.accumulate(factors * p[order]), 1.0)
    return out
