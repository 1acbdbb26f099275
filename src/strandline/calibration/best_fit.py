"""The inputs that explain the observed points best, and statistics of residuals: of the observation, and drawn ones.

Around these inputs the residuals are linear in the inputs u, scaled by mean and standard deviation of their priors, and
in the errors c of the surrogate's modes, in their standard deviations: r = e + J u + F c with errors e of covariance C.
The most probable u and c are those of a linear Gaussian model with the covariance S = C + JJᵀ + FFᵀ of r.

Sums of squares, overall, by condition and by part of the arc, are computed from what is left when inputs, errors of the
surrogate and global errors of the observation are fitted, for drawn residuals as for the observed ones. So they do not
depend on the inputs, and those of a right model have the distribution of those drawn, as far as the prediction is
linear in the inputs.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.cluster.vq import kmeans2
from scipy.linalg import block_diag

from strandline.calibration.misfit import Effort
from strandline.design import learn
from strandline.discrepancy import Discrepancy, JointErrors, Points, places_of, residuals_of, shared_errors
from strandline.foundations import StrandlineError
from strandline.interface import ErrorModel, Interface, Observation, arc_lengths, steady_lengths
from strandline.likelihood import StatedErrors, stated_errors
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior, Weighted
from strandline.runs import RunRecord
from strandline.surrogate import FieldSurrogate

RUNS_PER_INPUT = 8  # runs from which a field is learnt for this purpose: so many for each input and for the mean
STEPS = 4  # largest number of Gauss–Newton steps from the MAP
LEVELS = 400  # quantiles of the priors from which their moments are computed
NEGLIGIBLE = 0.02  # standard deviation of a mode of the surrogate, in that of a point, below which it counts as exact


@dataclass(frozen=True, eq=False)
class Prediction:
    """The points of each condition's interface as a function of inputs; `templates` have its cells.

    `uncertain` returns the points at one input with one mode of the surrogate after the other off by its standard
    deviation, mm, if that is above the second argument. With `run_alone`, a single run stands for all inputs.
    """

    templates: Mapping[str, Interface]
    points: Callable[[Float[np.ndarray, "point dim"]], Points]
    uncertain: Callable[[Float[np.ndarray, " dim"], float], Points]
    source: str
    run_alone: bool = False


def by_field(surrogate: FieldSurrogate, source: str = "the surrogate of the interface") -> Prediction:
    """Return the prediction of a surrogate of the field."""

    def points(x: Float[np.ndarray, "point dim"]) -> Points:
        return surrogate.points(surrogate.mean(x))

    def uncertain(x: Float[np.ndarray, " dim"], least: float) -> Points:
        found = surrogate.predict(x[None])
        sd = np.sqrt(found.variance[0])
        return surrogate.points(found.mean + np.diag(sd)[sd > least])

    return Prediction(surrogate.templates, points, uncertain, source)


def by_runs(
    x: Float[np.ndarray, "run dim"],
    records: Sequence[RunRecord],
    log_likelihood: Float[np.ndarray, " run"],
    space: ParameterSpace,
    observations: tuple[Observation, ...],
    measure: Discrepancy,
    *,
    most: int = Effort.runs,
) -> Prediction:
    """Return the prediction of a field learnt from the best runs; if there can be none, that of the best run alone.

    Sensitivities are left out: they would make many runs expensive to learn from.
    """
    ranked = np.argsort(-log_likelihood, kind="stable")
    best = np.sort(ranked[: min(RUNS_PER_INPUT * (space.dim + 1), most)])
    plain = [replace(records[i], sensitivities={}) for i in best.tolist()]
    try:
        known = learn(x[best], plain, space, observations, measure)
    except (StrandlineError, ArithmeticError, ValueError):
        return _by_run(records[int(ranked[0])], [seen.condition for seen in observations])
    return by_field(known.surrogate, f"a surrogate of the interface learnt from the {len(best)} best runs")


def _by_run(record: RunRecord, conditions: Sequence[str]) -> Prediction:
    templates = {name: record.interfaces[name] for name in conditions}

    def points(x: Float[np.ndarray, "point dim"]) -> Points:
        return {name: interface.points[None] for name, interface in templates.items()}

    def uncertain(x: Float[np.ndarray, " dim"], least: float) -> Points:
        return {name: interface.points[None][:0] for name, interface in templates.items()}

    return Prediction(templates, points, uncertain, "the best run alone", run_alone=True)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Signed distances of all observed points, mm, with their covariance C = D + BBᵀ."""

    observations: tuple[Observation, ...]
    measure: Discrepancy
    stated: tuple[StatedErrors, ...]
    joint: JointErrors
    model: ErrorModel

    @classmethod
    def of(
        cls,
        observations: Sequence[Observation],
        measure: Discrepancy,
        templates: Mapping[str, Interface],
        explained: Float[np.ndarray, "seen cause"] | None = None,
    ) -> "Residuals":
        """Return the residuals of observations; global errors are shared where the likelihood shares them.

        `explained` is what errors of the model that were allowed for do to the residuals, mm.

        Raises:
            InvalidInput: A noise variance that no errors of points have.
        """
        stated = [stated_errors(seen, measure, len(templates[seen.condition].points)) for seen in observations]
        shared = shared_errors(observations, measure)
        joint = shared or JointErrors(tuple(observations), tuple(one.errors for one in stated))
        model = joint.model
        if shared is None and explained is not None:
            model = ErrorModel(model.local, np.hstack([model.shared, explained]))
        return cls(tuple(observations), measure, tuple(stated), joint, model)

    @cached_property
    def parts(self) -> list[slice]:
        """Places of the residuals of each observation."""
        return places_of(len(seen.interface.points) for seen in self.observations)

    def at(self, points: Points, templates: Mapping[str, Interface]) -> Float[np.ndarray, "row seen"]:
        """Return the residuals of predicted interfaces with these points, one row each."""
        return residuals_of(self.joint, points, templates)

    def drawn(self, number: int, random: np.random.Generator) -> Float[np.ndarray, "draw seen"]:
        """Return residuals that the errors of the points alone cause, as the observations state them."""
        local = [
            one.errors.local_draws(seen.interface, number, random)
            for one, seen in zip(self.stated, self.observations, strict=True)
        ]
        common = random.standard_normal((number, self.model.shared.shape[1])) @ self.model.shared.T
        return np.asarray(np.concatenate(local, axis=1) + common)


@dataclass(frozen=True, eq=False)
class BestFit:
    """The inputs that explain the observed points best, also scaled by mean and standard deviation of their priors.

    `by_inputs` is the change of the residuals with each scaled input, J, and `by_modes` that if a mode of the surrogate
    is off by its standard deviation, F, mm.
    """

    at: Float[np.ndarray, " dim"]
    scaled: Float[np.ndarray, " dim"]
    residuals: Float[np.ndarray, " seen"]
    by_inputs: Float[np.ndarray, "seen scale"]
    by_modes: Float[np.ndarray, "seen mode"]

    @property
    def causes(self) -> Float[np.ndarray, "seen cause"]:
        return np.hstack([self.by_inputs, self.by_modes])

    def with_modes(self, model: ErrorModel) -> ErrorModel:
        """Return the covariance C + FFᵀ of the residuals at known inputs."""
        return ErrorModel(model.local, np.hstack([model.shared, self.by_modes]))

    def with_causes(self, model: ErrorModel) -> ErrorModel:
        """Return the covariance S = C + JJᵀ + FFᵀ of the residuals at the priors' means."""
        return ErrorModel(model.local, np.hstack([model.shared, self.causes]))

    def cost(self, model: ErrorModel) -> float:
        """Return rᵀ (C + FFᵀ)⁻¹ r + |u|², twice the negative log density of these inputs."""
        return float(self.with_modes(model).square(self.residuals)) + float(self.scaled @ self.scaled)

    def next(self, model: ErrorModel) -> Float[np.ndarray, " dim"]:
        """Return the scaled inputs of least cost if the residuals are linear: -Jᵀ S⁻¹ (r - J u)."""
        at_means = self.residuals - self.by_inputs @ self.scaled
        return np.asarray(-self.by_inputs.T @ self.with_causes(model).solved(at_means))


def best_fit(residuals: Residuals, prediction: Prediction, posterior: Posterior) -> BestFit:
    """Return the inputs of least cost near the MAP, inside the box, by Gauss–Newton steps.

    If a single run stands for all inputs, this is the MAP, and no input changes the residuals.
    """
    space, p = posterior.space, (np.arange(LEVELS) + 0.5) / LEVELS
    quantiles = space.marginal_quantiles(p)
    prior = Weighted(quantiles, np.full(LEVELS, 1 / LEVELS))  # for means and standard deviations
    best = _around(posterior.map_estimate, residuals, prediction, posterior, prior)
    if prediction.run_alone:
        return replace(best, by_inputs=best.by_inputs[:, :0])
    for _ in range(STEPS):
        x = np.clip(prior.mean + prior.sd * best.next(residuals.model), space.low, space.high)
        moved = _around(x, residuals, prediction, posterior, prior)
        if not moved.cost(residuals.model) < best.cost(residuals.model):
            break
        best = moved
    return best


def _around(
    x: Float[np.ndarray, " dim"], residuals: Residuals, prediction: Prediction, posterior: Posterior, prior: Weighted
) -> BestFit:
    """Return the residuals at `x` and their derivatives, by central differences inside the box."""
    space, dim = posterior.space, len(x)
    width = space.high - space.low
    step = np.clip(0.5 * posterior.sd, 1e-4 * width, 0.1 * width)
    ahead, behind = np.minimum(x + step, space.high), np.maximum(x - step, space.low)
    rows, each = np.tile(x, (1 + 2 * dim, 1)), np.arange(dim)
    rows[1 + each, each], rows[1 + dim + each, each] = ahead, behind
    found = residuals.at(prediction.points(rows), prediction.templates)
    difference = np.zeros((dim, found.shape[1])) if prediction.run_alone else found[1 : 1 + dim] - found[1 + dim :]
    least = NEGLIGIBLE * min(one.errors.sd for one in residuals.stated)
    disturbed = residuals.at(prediction.uncertain(x, least), prediction.templates)
    return BestFit(
        at=x,
        scaled=(x - prior.mean) / prior.sd,
        residuals=found[0],
        by_inputs=(prior.sd[:, None] * difference / (ahead - behind)[:, None]).T,
        by_modes=(disturbed - found[0]).T,
    )


PATCHES, FEWEST_IN_PATCH = 8, 4  # patches of a surface, and the fewest points of a patch on average
ROUNDS = 20  # rounds in which the middles of the patches move
WAVES, FEWEST_FOR_WAVE = 6, 4  # waves along an arc, the first one constant, and the fewest points for each
TOGETHER = 0.01
"""Squared change of all residuals, in their standard deviations, by a combination of inputs over its prior, below which
these inputs only act together: differences cannot tell such a change, and it hardly moves a wave."""
EXPLAINED = 1e-6  # variance of waves, relative to the largest, below which inputs or global errors explain them
BLOCK = 500  # draws processed together; this bounds the memory
PARTS, FEWEST_POINTS = 6, 4  # parts of the arc of an interface, and the fewest points of a part on average


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
    it is Neyman's smooth test (1937) for residuals. The covariance of drawn waves first makes them independent.
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
    """A part of an observed arc from `begin` to `end`, mm, or a patch of a surface with this mean point."""

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
