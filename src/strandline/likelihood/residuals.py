"""Signed distances of all observed points from predicted interfaces: themselves, and sums over them for many runs.

Each prediction follows the observations by their most probable shift, rotation, scale and offset first, and the linear
effect of these is added again: see `strandline.discrepancy.registration`.
"""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import signed_distances
from strandline.discrepancy.normal_offset import Rows, Sums, extended, linear_sums, weighted_sums
from strandline.interface import ErrorModel, Interface
from strandline.likelihood.joint_errors import JointErrors, Points

__all__ = ["residuals_of", "sums_of"]


def residuals_of(
    joint: JointErrors, points: Points, templates: Mapping[str, Interface]
) -> Float[np.ndarray, "run seen"]:
    """Return the signed distances of all observed points, mm, a row for each predicted interface."""
    model, found = joint.model, _distances(joint, points, templates)
    if not model.shared.any():
        return found
    g = model.shared_errors(found @ model.features)
    return np.asarray(_distances(joint, joint.followed(points, templates, g), templates) + g @ model.shared.T)


def sums_of(
    joint: JointErrors,
    points: Points,
    templates: Mapping[str, Interface],
    model: ErrorModel | None = None,
    estimate: Callable[[Float[np.ndarray, "run error"]], Float[np.ndarray, "run error"]] | None = None,
) -> Sums:
    """Return rᵀ D⁻¹ r and Bᵀ D⁻¹ r over the signed distances r of all observed points, for each predicted interface.

    Args:
        joint: Errors of the observations.
        points: Points of the predicted interfaces.
        templates: An interface of each condition, for its cells.
        model: D and B, which may have columns after those of the global errors.
        estimate: Function that returns the global errors, in units of B, from Bᵀ D⁻¹ r.
    """
    model = joint.model if model is None else model
    estimate = model.shared_errors if estimate is None else estimate
    moves = np.append(joint.moves, np.ones(model.shared.shape[1] - len(joint.moves), bool))
    longer = {name: extended(rows, templates[name]) for name, rows in points.items() if name in joint.conditions}
    return linear_sums(
        longer,
        partial(_sums, joint, templates, model),
        lambda products: estimate(products) * moves,
        lambda some, g: joint.followed(some, templates, g),
        model.gram,
    )


def _sums(joint: JointErrors, templates: Mapping[str, Interface], model: ErrorModel, points: Rows, rough: bool) -> Sums:
    squares, products, first = [], [], 0
    for seen in joint.observations:
        part = slice(first, first + len(seen.interface.points))
        weights, features = 1 / model.local[part], model.features[part]
        rows, template = points[seen.condition], templates[seen.condition]
        found = weighted_sums(seen.interface.points, rows, template, weights, features, rough=rough, longer=True)
        squares.append(found[0])
        products.append(found[1])
        first = part.stop
    return np.sum(squares, axis=0), np.sum(products, axis=0)


def _distances(joint: JointErrors, points: Points, templates: Mapping[str, Interface]) -> Float[np.ndarray, "run seen"]:
    found = []
    for seen in joint.observations:
        rows, cells = points[seen.condition], templates[seen.condition].cells
        each = [signed_distances(seen.interface.points, Interface(row, cells)) for row in rows]
        found.append(np.array(each, float).reshape(len(rows), len(seen.interface.points)))
    return np.concatenate(found, axis=1)
