"""Sums of squares of residuals, of the observation and of drawn errors: overall, by condition and by part of the arc.

The statistics are computed from what is left when inputs, errors of the surrogate and global errors of the observation
are fitted, for drawn residuals as for the observed ones. So they do not depend on the inputs, and those of a right
model have the distribution of those drawn, as far as the prediction is linear in the inputs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.calibration.misfit.best_fit import BestFit
from strandline.calibration.misfit.effort import Effort
from strandline.calibration.misfit.patches import patches_of
from strandline.calibration.misfit.residuals import Residuals
from strandline.calibration.misfit.waves import waves_of
from strandline.interface import Observation, arc_lengths, steady_lengths

__all__ = ["Parts", "Span", "Statistics", "corrected", "drawn_statistics", "observed_statistics", "parts_of", "tail"]

BLOCK = 500
"""Draws processed together; this bounds the memory."""
PARTS, FEWEST_POINTS = 6, 4
"""Parts of the arc of an interface, and the fewest points of a part on average."""


@dataclass(frozen=True)
class Span:
    """A part of the arc of an observed interface, or a patch of a surface.

    Args:
        observation: Number of the observation.
        begin: Arc length at which it begins, mm; 0 for a patch.
        end: Arc length at which it ends, mm; 0 for a patch.
        centre: Mean point of a patch, mm; None for a part of an arc.
    """

    observation: int
    begin: float
    end: float
    centre: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of the arcs of all observed interfaces, or patches of surfaces, and waves along these arcs.

    Args:
        spans: The parts.
        members: Membership of each residual in each part, 1 or 0.
        waves: The waves at the points, see `waves_of`.
    """

    spans: tuple[Span, ...]
    members: Float[np.ndarray, "seen part"]
    waves: Float[np.ndarray, "seen wave"]


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of residuals, one row for each draw.

    Args:
        whole: Sum rᵀ C⁻¹ r over all observations.
        conditions: The same for each observation.
        squares: Sum of r²/D over each part of an arc, global errors removed.
        means: Mean of r over each part, mm, global errors removed.
        waves: Components of C⁻¹ r along the waves.
    """

    whole: Float[np.ndarray, " row"]
    conditions: Float[np.ndarray, "row condition"]
    squares: Float[np.ndarray, "row part"]
    means: Float[np.ndarray, "row part"]
    waves: Float[np.ndarray, "row wave"]


def parts_of(observations: Sequence[Observation]) -> Parts:
    """Return equal parts of the arc of each observed polyline, those with points, and patches of each surface."""
    spans, columns, first = [], [], 0
    total = sum(len(seen.interface.points) for seen in observations)
    for k, interface in enumerate(seen.interface for seen in observations):
        number = len(interface.points)
        if interface.dim == 2:
            whole, count = float(steady_lengths(interface).sum()), max(min(PARTS, number // FEWEST_POINTS), 1)
            which = np.minimum((count * arc_lengths(interface) / whole).astype(int), count - 1)
            for part in np.unique(which).tolist():
                column = np.zeros(total)
                column[first : first + number] = which == part
                columns.append(column)
                spans.append(Span(k, whole * part / count, whole * (part + 1) / count))
        else:
            which = patches_of(interface.points)
            for part in np.unique(which).tolist():
                column = np.zeros(total)
                column[first : first + number] = which == part
                columns.append(column)
                x, y, z = interface.points[which == part].mean(axis=0).tolist()
                spans.append(Span(k, 0.0, 0.0, (x, y, z)))
        first += number
    members = np.stack(columns, axis=1) if columns else np.zeros((total, 0))
    return Parts(tuple(spans), members, waves_of(observations))


def observed_statistics(residuals: Residuals, fit: BestFit, parts: Parts) -> Statistics:
    """Return the statistics of the observation, in one row."""
    return _statistics(residuals, fit.with_modes(residuals.model).solved(fit.residuals[None]), parts)


def drawn_statistics(
    residuals: Residuals, fit: BestFit, parts: Parts, random: np.random.Generator, effort: Effort
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


def _statistics(residuals: Residuals, weighted: Float[np.ndarray, "row seen"], parts: Parts) -> Statistics:
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
    drawn: Float[np.ndarray, "row *statistic"], observed: Float[np.ndarray, "1 *statistic"]
) -> Float[np.ndarray, "*statistic"]:
    """Return the share of draws that reach what was observed, the observation counted as one of them."""
    return np.asarray((1 + (drawn >= observed).sum(axis=0)) / (1 + len(drawn)))


def corrected(p: Float[np.ndarray, " test"]) -> Float[np.ndarray, " test"]:
    """Return p-values corrected for their number (Holm 1979)."""
    order, factors = np.argsort(p), len(p) - np.arange(len(p))
    out = np.empty(len(p))
    out[order] = np.minimum(np.maximum.accumulate(factors * p[order]), 1.0)
    return out
