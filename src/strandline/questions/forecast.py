"""The interface in an experiment to be made, from one run of it and the surrogate of the present experiment.

What an input does to the interface there is nearly what it does here, times a factor. With the slopes J of the present
field in the inputs at x₀, and J' of the other one,

    y'(x) = y'(x₀) + A P Δ + a (I - P) Δ + (J' - A J) (u(x) - u(x₀)),   Δ = c(x) - c(x₀),

where c are the coefficients of the present modes, A = J' J⁺ takes slopes to slopes, P = J J⁺ projects onto what the
inputs do at x₀, a is the mean ratio of the slopes, and u are the inputs as the surrogate warps them. The
curvature of the present field is thus carried over. If the experiment is the present one, y' is its own surrogate.

Runs fail where the interface moves too far: those of the present experiment and of other candidates show up to which
displacement they succeed. Failed runs count with the displacement that the surrogate predicts at their inputs.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize
from scipy.special import expit, log_expit, logit

from strandline.errors import InvalidInterface
from strandline.interface import Interface
from strandline.questions.observing import Nodes
from strandline.surrogate.field import FieldSurrogate
from strandline.surrogate.field.correspondence import fields_of

STEP = 1e-3
"""Step of the differences of the present field, in widths of the box."""
WEAK = 1e-3
"""Directions of the inputs that move the present field by less than this share of the strongest are carried over by
their slopes alone."""


Fields = Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, "point value"]]
"""A field as a function of the inputs, mm."""
Fails = Callable[[Float[np.ndarray, "draw value"]], Float[np.ndarray, " draw"]]
"""The probability that the run of a field fails."""


def transfer(
    surrogate: FieldSurrogate,
    at: Float[np.ndarray, " dim"],
    field: Float[np.ndarray, " value"],
    slopes: Float[np.ndarray, "value dim"],
    covariance: Float[np.ndarray, "dim dim"],
) -> Fields:
    """Return the field of another experiment as a function of the inputs, from a run of it `at` one point.

    `field` has the run's values at the points of the surrogate of the present field, mm, `slopes` their derivatives in
    the physical inputs. `covariance` is that of the inputs where the field will be used.
    """
    here = _slopes(surrogate.mean, at, surrogate).T
    root = np.linalg.cholesky(covariance)
    inverse = root @ np.linalg.pinv(here @ root, rcond=WEAK)
    carried = slopes @ inverse
    shapes = surrogate.modes.basis / surrogate.modes.roots
    typical = (here @ root).T @ shapes
    ratio = float(np.sum((slopes @ root).T * typical) / np.sum(typical**2))
    rest = ratio * (np.eye(len(here)) - here @ inverse)
    besides = slopes - carried @ here
    by_modes, by_inputs = carried.T + rest.T @ shapes, surrogate.warping.gradients(at[None], besides[None])[0].T

    def fields(x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point value"]:
        both = np.concatenate([at[None], x])
        coefficients, warped = surrogate.mean(both), surrogate.warping.standardise(both)
        moved = (coefficients[1:] - coefficients[0]) @ by_modes
        return np.asarray(field + moved + (warped[1:] - warped[0]) @ by_inputs)

    return fields


def _slopes(values: Fields, x: Float[np.ndarray, " dim"], surrogate: FieldSurrogate) -> Float[np.ndarray, "dim value"]:
    """Return derivatives at x by central differences, inside the box."""
    low, high = surrogate.warping.low, surrogate.warping.high
    steps = np.diag(STEP * (high - low))
    ahead, behind = np.clip(x + steps, low, high), np.clip(x - steps, low, high)
    both = values(np.concatenate([ahead, behind]))
    return np.asarray((both[: len(x)] - both[len(x) :]) / np.diag(ahead - behind)[:, None])


def slopes_of_points(
    fields: Fields, x: Float[np.ndarray, " dim"], surrogate: FieldSurrogate
) -> dict[str, Float[np.ndarray, "_ xyz dim"]]:
    """Return the derivatives of the points in the inputs at x by condition, mm per unit of the input."""
    rows = _slopes(fields, x, surrogate)
    return {name: np.moveaxis(one, 0, -1) for name, one in surrogate.by_condition(rows).items()}


def with_known(x: Float[np.ndarray, "point dim"], known: Mapping[int, float]) -> Float[np.ndarray, "point dim"]:
    """Return inputs of which an experiment sets some, by column."""
    out = x.copy()
    out[:, list(known)] = list(known.values())
    return out


def field_of(surrogate: FieldSurrogate, interfaces: Mapping[str, Interface]) -> Float[np.ndarray, " value"]:
    """Return interfaces by condition as a field of the surrogate, mm.

    Raises:
        NoCommonPoints: They have no points in common with it.
    """
    return np.asarray(fields_of([interfaces], surrogate.layouts)[0][0])


def slopes_of_field(
    surrogate: FieldSurrogate, sensitivities: Mapping[str, Mapping[str, Float[np.ndarray, "_ _"]]], names: Sequence[str]
) -> Float[np.ndarray, "value dim"] | None:
    """Return a run's sensitivities as derivatives of the field; None if it has other points or lacks an input."""
    if any(layout.way != "nodes" for layout in surrogate.layouts.values()):
        return None
    if any(name not in sensitivities.get(condition, {}) for condition in surrogate.layouts for name in names):
        return None
    rows = [np.stack([sensitivities[one][name].ravel() for name in names], axis=1) for one in surrogate.layouts]
    return np.concatenate(rows)


SLOPE_SD, OFFSET_SD = 50.0, 50.0
"""Standard deviations of the prior of the logistic function's slope and offset."""
PRIOR_RUNS, RARE = 2.0, 0.05
"""Runs that the base rate of failures begins with, and the share of these that fail."""
MOST_CHECKED = 200
"""Interfaces that are checked for crossing themselves."""


def learn_failure_by_size(
    surrogate: FieldSurrogate,
    x: Float[np.ndarray, "run dim"],
    ok: Bool[np.ndarray, " run"],
    undeformed: Float[np.ndarray, " value"],
    others: Float[np.ndarray, "other value"],
) -> Fails:
    """Return the probability that the run of a field fails, by the size of its displacement, from the runs at hand.

    It is a logistic function of the logarithm of the displacement that never decreases. It maximises the likelihood,
    with a weak normal prior so that a maximum exists even without failures. `x` and `ok` are of all runs; `undeformed`
    and `others`, further runs that succeeded in other experiments, are fields of the surrogate, mm.
    """
    fields = np.vstack([surrogate.modes.fields(surrogate.mean(x)), others])
    ok = np.concatenate([ok, np.ones(len(others), bool)])
    logs = np.log(_sizes(fields, undeformed))
    middle, sign = float(logs.mean()), np.where(ok, -1.0, 1.0)
    base = float(logit((np.sum(~ok) + PRIOR_RUNS * RARE) / (len(ok) + PRIOR_RUNS)))

    def loss(a: Float[np.ndarray, "2"]) -> float:
        fits = log_expit(sign * (a[0] + a[1] * (logs - middle))).sum()
        return float(-fits + 0.5 * ((a[0] - base) / OFFSET_SD) ** 2 + 0.5 * (a[1] / SLOPE_SD) ** 2)

    found = minimize(loss, [base, 1.0], bounds=[(-300.0, 300.0), (0.0, 300.0)])
    offset, slope = (float(one) for one in found.x)

    def failing(fields: Float[np.ndarray, "draw value"]) -> Float[np.ndarray, " draw"]:
        return np.asarray(expit(offset + slope * (np.log(_sizes(fields, undeformed)) - middle)))

    return failing


def _sizes(fields: Float[np.ndarray, "draw value"], undeformed: Float[np.ndarray, " value"]) -> np.ndarray:
    return np.asarray(np.maximum(np.sqrt(np.mean((fields - undeformed) ** 2, axis=1)), 1e-12))


def crossing_share(nodes: Nodes, templates: dict[str, Interface]) -> float:
    """Return the share of predicted polylines that cross or fold onto themselves in some condition."""
    number = min(MOST_CHECKED, min(len(one) for one in nodes.values()))
    bad = [
        any(_crosses(Interface(one[k], templates[name].cells)) for name, one in nodes.items()) for k in range(number)
    ]
    return float(np.mean(bad))


def _crosses(interface: Interface) -> bool:
    if interface.dim == 3:
        return False
    try:
        interface.require_simple()
    except InvalidInterface:
        return True
    return False
