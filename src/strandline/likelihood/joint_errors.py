"""The errors of several observations together: their covariance, and what the global ones do to an interface."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import block_diag

from strandline.interface import ErrorModel, Interface, Observation, PointErrors

__all__ = ["JointErrors", "Points", "error_model"]

Points = Mapping[str, Float[np.ndarray, "_ _ _"]]
"""Points of interfaces by condition, one interface a row, mm."""


@dataclass(frozen=True, eq=False)
class JointErrors:
    """Errors of the points of several observations.

    Args:
        observations: The observations.
        errors: Errors of the points of each.
        common: Whether all have the same shift, rotation and scale, about the middle of all their points.
    """

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

    def followed(
        self, points: Points, templates: Mapping[str, Interface], by: Float[np.ndarray, "run error"]
    ) -> dict[str, Float[np.ndarray, "_ _ _"]]:
        """Return simulated interfaces as `PointErrors.followed` does; further columns of `by` are left out."""
        found = {}
        for one, seen, part in zip(self._own, self.observations, self._parts(), strict=True):
            name, middle = seen.condition, seen.interface.points.mean(axis=0)
            found[name] = one.followed(points[name], templates[name], by[:, part], middle=middle)
        if self.common:
            rest = by[:, sum(part.stop - part.start for part in self._parts()) :]
            for one, seen in zip(self._ours, self.observations, strict=True):
                name = seen.condition
                found[name] = one.followed(found[name], templates[name], rest, middle=self._middle)
        return found

    def sizes(self, by: Float[np.ndarray, " error"]) -> tuple[dict[str, tuple[float, ...]], ...]:
        """Return the global errors of each observation as `PointErrors.sizes` does; further ones are left out."""
        dims = [one.interface.dim for one in self.observations]
        found = [one.sizes(by[part], dim) for one, dim, part in zip(self._own, dims, self._parts(), strict=True)]
        if self.common:
            rest = by[sum(part.stop - part.start for part in self._parts()) :]
            ours = (one.sizes(rest, dim) for one, dim in zip(self._ours, dims, strict=True))
            found = [mine | more for mine, more in zip(found, ours, strict=True)]
        return tuple(found)

    @property
    def conditions(self) -> frozenset[str]:
        """Names of the observed conditions."""
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

    def _parts(self) -> Iterator[slice]:
        """Yield the places of each observation's own global errors."""
        first = 0
        for one, seen in zip(self._own, self.observations, strict=True):
            number = one.global_errors(seen.interface.dim)
            yield slice(first, first + number)
            first += number


def error_model(observations: Sequence[Observation], errors: Sequence[PointErrors]) -> ErrorModel:
    """Return the covariance of all residuals, each observation with its own errors."""
    return JointErrors(tuple(observations), tuple(errors)).model
