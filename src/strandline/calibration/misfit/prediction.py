"""The interfaces that the model predicts at any inputs: by a surrogate of the field, or by the best run alone."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from strandline.calibration.misfit.effort import Effort
from strandline.design.active import learn
from strandline.discrepancy import Discrepancy
from strandline.errors import StrandlineError
from strandline.interface import Interface, Observation
from strandline.likelihood.joint_errors import Points
from strandline.parameters import ParameterSpace
from strandline.runs import RunRecord
from strandline.surrogate.field import FieldSurrogate

__all__ = ["Prediction", "by_field", "by_runs"]

RUNS_PER_INPUT = 8
"""Runs from which a field is learnt for this purpose: so many for each input and for the mean."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """The interface of each condition as a function of the inputs.

    Args:
        templates: An interface of each condition, for its cells.
        points: Function that returns the points of the interfaces at inputs, shape (point, dim).
        uncertain: Function that returns the points at one input, shape (dim,), with one mode of the surrogate after the
            other off by its standard deviation; modes whose standard deviation, mm, is below the second argument are
            left out.
        source: What predicts, in words.
        run_alone: Whether a single run stands for all inputs.
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

    templates = {name: layout.template for name, layout in surrogate.layouts.items()}
    return Prediction(templates, points, uncertain, source)


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

    Args:
        x: Inputs of the successful runs.
        records: Their outcomes.
        log_likelihood: Their log-likelihoods.
        space: The inputs with their priors.
        observations: The observed interfaces.
        measure: The measure d².
        most: Most runs to learn from.
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
    """Return the prediction of one run, whatever the inputs."""
    templates = {name: record.interfaces[name] for name in conditions}

    def points(x: Float[np.ndarray, "point dim"]) -> Points:
        return {name: interface.points[None] for name, interface in templates.items()}

    def uncertain(x: Float[np.ndarray, " dim"], least: float) -> Points:
        return {name: interface.points[None][:0] for name, interface in templates.items()}

    return Prediction(templates, points, uncertain, "the best run alone", run_alone=True)
