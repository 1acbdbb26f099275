"""The inputs that explain the observed points best, and what is left of the residuals when all causes are fitted.

Around these inputs the residuals are linear in the inputs u, scaled by mean and standard deviation of their priors, and
in the errors c of the surrogate's modes, in their standard deviations: r = e + J u + F c with errors e of covariance C.
The most probable u and c are those of a linear Gaussian model with the covariance S = C + JJᵀ + FFᵀ of r.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from strandline.calibration.misfit.verdict import Effort
from strandline.design import learn
from strandline.discrepancy import Discrepancy, JointErrors, Points, places_of, residuals_of, shared_errors
from strandline.foundations import StrandlineError
from strandline.interface import ErrorModel, Interface, Observation
from strandline.likelihood import StatedErrors, stated_errors
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior, Weighted
from strandline.runs import RunRecord
from strandline.surrogate import FieldSurrogate

RUNS_PER_INPUT = 8
"""Runs from which a field is learnt for this purpose: so many for each input and for the mean."""
STEPS = 4
"""Largest number of Gauss–Newton steps from the MAP."""
LEVELS = 400
"""Quantiles of the priors from which their moments are computed."""
NEGLIGIBLE = 0.02
"""Standard deviation of a mode of the surrogate, in that of a point, below which it counts as exact."""


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
    space, prior = posterior.space, _prior(posterior.space)
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


def _prior(space: ParameterSpace) -> Weighted:
    """Return quantiles of the priors, for their means and standard deviations."""
    p = (np.arange(LEVELS) + 0.5) / LEVELS
    return Weighted(space.prior_quantiles(np.tile(p[:, None], (1, space.dim))), np.full(LEVELS, 1 / LEVELS))


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
