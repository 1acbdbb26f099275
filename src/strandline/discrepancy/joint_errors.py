"""The errors of several observations together: their covariance, the residuals that they cause, and a joint measure.

Each prediction follows the observations by their most probable shift, rotation, scale and offset first, and the linear
effect of these is added again: see `strandline.discrepancy.normal_offset`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import block_diag

from strandline.discrepancy.normal_offset import NormalOffset, Sums, extended, signed_distances, weighted_sums
from strandline.discrepancy.protocol import (
    Discrepancy,
    ManyPoints,
    Snapshot,
    Values,
    require_alike,
    require_same_direction,
)
from strandline.interface import ErrorModel, Interface, Observation, PointErrors

Points = Mapping[str, Float[np.ndarray, "_ _ _"]]  # points of interfaces by condition, one interface a row, mm
Templates = Mapping[str, Interface]
Errors = Float[np.ndarray, "run error"]  # global errors of the observations for each interface, in standard deviations


@dataclass(frozen=True, eq=False)
class JointErrors:
    """Errors of several observations' points; with `common`, one shift, rotation and scale about the middle of all."""

    observations: tuple[Observation, ...]
    errors: tuple[PointErrors, ...]
    common: bool = False

    @cached_property
    def model(self) -> ErrorModel:
        """Covariance of all residuals, one observation after the other; with common errors, these are the last."""
        seen = [o.interface for o in self.observations]
        own = [each.model(one) for each, one in zip(self._own, seen, strict=True)]
        columns = [block_diag(*[one.shared for one in own])]
        if self.common:
            ours = zip(self._ours, seen, strict=True)
            columns.append(np.concatenate([each.model(one, middle=self._middle).shared for each, one in ours]))
        return ErrorModel(np.concatenate([one.local for one in own]), np.hstack(columns))

    def followed(self, points: Points, templates: Templates, by: Errors) -> dict[str, Float[np.ndarray, "_ _ _"]]:
        """Return simulated interfaces as `PointErrors.followed` does; further columns of `by` are left out."""
        found = {}
        for one, seen, part in zip(self._own, self.observations, self._parts, strict=True):
            name, middle = seen.condition, seen.interface.points.mean(axis=0)
            found[name] = one.followed(points[name], templates[name], by[:, part], middle=middle)
        if self.common:
            rest = by[:, self._parts[-1].stop :]
            for one, seen in zip(self._ours, self.observations, strict=True):
                name = seen.condition
                found[name] = one.followed(found[name], templates[name], rest, middle=self._middle)
        return found

    def sizes(self, by: Float[np.ndarray, " error"]) -> tuple[dict[str, tuple[float, ...]], ...]:
        """Return the global errors of each observation as `PointErrors.sizes` does; further ones are left out."""
        dims = [one.interface.dim for one in self.observations]
        found = [one.sizes(by[part], dim) for one, dim, part in zip(self._own, dims, self._parts, strict=True)]
        if self.common:
            rest = by[self._parts[-1].stop :]
            ours = (one.sizes(rest, dim) for one, dim in zip(self._ours, dims, strict=True))
            found = [mine | more for mine, more in zip(found, ours, strict=True)]
        return tuple(found)

    def square(self, interfaces: Mapping[str, Interface]) -> float:
        """Return d² = rᵀ C⁻¹ r of the residuals of simulated interfaces by condition.

        Raises:
            InvalidInterface: One runs against its observation.
        """
        for seen in self.observations:
            require_same_direction(interfaces[seen.condition], seen.interface)
        points = {seen.condition: interfaces[seen.condition].points[None] for seen in self.observations}
        return float(self.many(points, interfaces)[0])

    def many(self, points: Points, templates: Templates) -> Float[np.ndarray, " run"]:
        """Return d² of each run, given its points by condition."""
        return self.model.square_of(*sums_of(self, points, templates))

    @property
    def conditions(self) -> frozenset[str]:
        return frozenset(one.condition for one in self.observations)

    @cached_property
    def moves(self) -> Bool[np.ndarray, " error"]:
        """Which global errors move an interface as a whole: all but the offsets along its normals."""
        dims = [one.interface.dim for one in self.observations]
        parts = [one.moves(dim) for one, dim in zip(self._own, dims, strict=True)]
        return np.concatenate([*parts, self._ours[0].moves(dims[0])] if self.common else parts)

    @cached_property
    def _own(self) -> tuple[PointErrors, ...]:
        return tuple(replace(e, shift=0.0, rotation=0.0, scale=0.0) if self.common else e for e in self.errors)

    @cached_property
    def _ours(self) -> tuple[PointErrors, ...]:
        return tuple(replace(e, offset=0.0) for e in self.errors)

    @cached_property
    def _middle(self) -> Float[np.ndarray, " xyz"]:
        return np.asarray(np.concatenate([o.interface.points for o in self.observations]).mean(axis=0))

    @property
    def _parts(self) -> list[slice]:
        """Places of each observation's own global errors."""
        pairs = zip(self._own, self.observations, strict=True)
        return places_of(one.global_errors(seen.interface.dim) for one, seen in pairs)


def places_of(numbers: Iterable[int]) -> list[slice]:
    """Return the places of so many entries each, one after the other."""
    return [slice(begin, end) for begin, end in pairwise(np.cumsum([0, *numbers]).tolist())]


def residuals_of(joint: JointErrors, points: Points, templates: Templates) -> Float[np.ndarray, "run seen"]:
    """Return the signed distances of all observed points, mm, a row for each predicted interface."""
    model, found = joint.model, _distances(joint, points, templates)
    if not model.shared.any():
        return found
    g = model.shared_errors(found @ model.features)
    return np.asarray(_distances(joint, joint.followed(points, templates, g), templates) + g @ model.shared.T)


def sums_of(
    joint: JointErrors,
    points: Points,
    templates: Templates,
    model: ErrorModel | None = None,
    estimate: Callable[[Errors], Errors] | None = None,
) -> Sums:
    """Return qᵀ D⁻¹ q and Bᵀ D⁻¹ q over the residuals q of all observed points, for each predicted interface.

    They are linear in the global errors g, which are estimated from some of the points, see
    `strandline.discrepancy.normal_offset`. D and B are those of `joint`, or of a model that may have columns after
    those of the global errors; `estimate` returns g, in units of B, from Bᵀ D⁻¹ r of signed distances r.
    """
    model = joint.model if model is None else model
    estimate = model.shared_errors if estimate is None else estimate
    moves = np.append(joint.moves, np.ones(model.shared.shape[1] - len(joint.moves), bool))
    longer = {name: extended(rows, templates[name]) for name, rows in points.items() if name in joint.conditions}

    def sums(some: Points, *, rough: bool) -> Sums:
        """Return rᵀ D⁻¹ r and Bᵀ D⁻¹ r; roughly, from some of the observed points."""
        squares, products = [], []
        places = places_of(len(seen.interface.points) for seen in joint.observations)
        for seen, part in zip(joint.observations, places, strict=True):
            rows, template = some[seen.condition], templates[seen.condition]
            factors = 1 / model.local[part], model.features[part]
            found = weighted_sums(seen.interface.points, rows, template, *factors, rough=rough, longer=True)
            squares.append(found[0])
            products.append(found[1])
        return np.sum(squares, axis=0), np.sum(products, axis=0)

    if not model.gram.any():
        return sums(longer, rough=False)
    g = estimate(sums(longer, rough=True)[1]) * moves
    g = estimate(sums(joint.followed(longer, templates, g), rough=True)[1] + g @ model.gram) * moves
    squares, products = sums(joint.followed(longer, templates, g), rough=False)
    more = g @ model.gram
    return squares + 2 * (products * g).sum(axis=1) + (more * g).sum(axis=1), products + more


def _distances(joint: JointErrors, points: Points, templates: Templates) -> Float[np.ndarray, "run seen"]:
    found = []
    for seen in joint.observations:
        rows, cells = points[seen.condition], templates[seen.condition].cells
        each = [signed_distances(seen.interface.points, Interface(row, cells)) for row in rows]
        found.append(np.array(each, float).reshape(len(rows), len(seen.interface.points)))
    return np.concatenate(found, axis=1)


def shared_errors(observations: Sequence[Observation], measure: Discrepancy) -> JointErrors | None:
    """Return the errors of several observations that are compared together; None if they are compared one by one."""
    if len(observations) < 2 or not isinstance(measure, NormalOffset):
        return None
    known = [one.known for one in observations if one.known and one.known.shared]
    if len(known) < len(observations) or len({(one.shift, one.rotation, one.scale) for one in known}) > 1:
        return None
    return JointErrors(tuple(observations), tuple(known), common=True)


@dataclass(frozen=True)
class WhitenedOffset:
    """d² = rᵀ C⁻¹ r, without a unit: r_i is the signed distance from observed point i to the simulated interface.

    C is the covariance of the errors of the observed points, local and global, so that σ_N² = 1 and d² is a sum of as
    many independent squares as there are observed points. Errors of position, rotation and scale of the whole interface
    are integrated out, around their most probable values for the simulated interface at hand.

    Raises:
        InvalidInput: On evaluation, a correlation length above half the length of the observed interface.
    """

    errors: PointErrors
    unit: ClassVar[str] = "1"

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        """Return d².

        Raises:
            InvalidInterface: With global errors, interfaces that run in opposite directions.
        """
        require_alike(simulated, observed)
        if self.errors.global_errors(observed.dim):
            require_same_direction(simulated, observed)
        return float(self.many(simulated.points[None], simulated, observed)[0])

    def model(self, observed: Interface) -> ErrorModel:
        """Return the covariance of the residuals; kept for the interfaces used last."""
        return _joint(self.errors, Snapshot.of(observed)).model

    def many(self, points: ManyPoints, template: Interface, observed: Interface) -> Values:
        """Return d² of interfaces of the same cells."""
        require_alike(template, observed)
        return self.model(observed).square_of(*self.sums(points, template, observed))

    def global_errors(self, points: ManyPoints, template: Interface, observed: Interface) -> Errors:
        """Return the most probable global errors of the observation for each simulated interface, in their sds."""
        return self.model(observed).shared_errors(self.sums(points, template, observed)[1])

    def sums(self, points: ManyPoints, template: Interface, observed: Interface) -> Sums:
        """Return rᵀ D⁻¹ r and Bᵀ D⁻¹ r of each run, of residuals that are linear in the global errors."""
        return sums_of(_joint(self.errors, Snapshot.of(observed)), {"": points}, {"": template})

    def terms(self, observed: Interface) -> int:
        """Return the number of observed points."""
        return len(observed.points)


@lru_cache(maxsize=64)
def _joint(errors: PointErrors, snapshot: Snapshot) -> JointErrors:
    return JointErrors((Observation(snapshot.interface, errors),), (errors,))
