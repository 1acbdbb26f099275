"""Signed distances from the observed points to the simulated interface, whitened by their errors if these are known."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from strandline.discrepancy.memo import Snapshot
from strandline.discrepancy.protocol import require_alike, require_same_direction
from strandline.discrepancy.registration import ROUGH, Rows, Sums, linear_sums
from strandline.discrepancy.search.local_means import LocalMeans, local_means
from strandline.discrepancy.search.many_distances import FEWEST
from strandline.discrepancy.search.nearest import closest_points
from strandline.discrepancy.search.signed_sums import signed_sums
from strandline.interface import ErrorModel, Interface, PointErrors, as_complex

__all__ = ["NormalOffset", "WhitenedOffset", "extended", "signed_distances", "weighted_sums"]


BEYOND = 0.05
"""Share of its length by which an open polyline goes on straight at each end."""
PLACES = 200
"""Places along an observed polyline whose distances stand for those of all its points, about."""


@dataclass(frozen=True)
class NormalOffset:
    """d² = Σ r_i², mm², with r_i the signed distance from observed point i to the simulated interface.

    With stated errors of the observed points, `WhitenedOffset` takes its place. Parts of the simulated interface that
    were not observed cost nothing; an open one goes on straight beyond its ends by a twentieth of its length.
    """

    unit: ClassVar[str] = "mm²"

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        """Return d²."""
        require_alike(simulated, observed)
        return float((signed_distances(observed.points, simulated) ** 2).sum())

    def many(
        self, points: Float[np.ndarray, "run point xyz"], template: Interface, observed: Interface
    ) -> Float[np.ndarray, " run"]:
        """Return d² of interfaces of the same cells."""
        require_alike(template, observed)
        seen = observed.points
        return weighted_sums(seen, points, template, np.ones(len(seen)), np.empty((len(seen), 0)))[0]

    def of_offsets(
        self, offsets: Float[np.ndarray, "run seen"], observed: Interface, nodes: int
    ) -> Float[np.ndarray, " run"]:
        """Return their sum of squares."""
        return np.asarray((offsets**2).sum(axis=1))

    def terms(self, observed: Interface) -> int:
        """Return the number of observed points."""
        return len(observed.points)

    def whitened(self, errors: PointErrors) -> "WhitenedOffset":
        """Return the measure for observed points with these errors."""
        return WhitenedOffset(errors)


@dataclass(frozen=True)
class WhitenedOffset:
    """d² = rᵀ C⁻¹ r, without a unit: r_i is the signed distance from observed point i to the simulated interface.

    C is the covariance of the errors of the observed points, local and global, so that σ_N² = 1 and d² is a sum of as
    many independent squares as there are observed points. Errors of position, rotation and scale of the whole interface
    are integrated out, around their most probable values for the simulated interface at hand.

    Args:
        errors: Errors of the observed points.

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
        return _model(self.errors, Snapshot.of(observed))

    def many(
        self, points: Float[np.ndarray, "run point xyz"], template: Interface, observed: Interface
    ) -> Float[np.ndarray, " run"]:
        """Return d² of interfaces of the same cells."""
        require_alike(template, observed)
        return self.model(observed).square_of(*self.sums(points, template, observed))

    def global_errors(
        self, points: Float[np.ndarray, "run point xyz"], template: Interface, observed: Interface
    ) -> Float[np.ndarray, "run error"]:
        """Return the most probable global errors of the observation for each simulated interface, in their sds."""
        return self.model(observed).shared_errors(self.sums(points, template, observed)[1])

    def sums(self, points: Float[np.ndarray, "run point xyz"], template: Interface, observed: Interface) -> Sums:
        """Return rᵀ D⁻¹ r and Bᵀ D⁻¹ r of each run, of residuals that are linear in the global errors."""
        model, seen = self.model(observed), observed.points
        moves, middle = self.errors.moves(observed.dim), seen.mean(axis=0)
        longer = extended(points, template)

        def of(some: Rows, rough: bool) -> Sums:
            return weighted_sums(seen, some[""], template, 1 / model.local, model.features, rough=rough, longer=True)

        return linear_sums(
            {"": longer},
            of,
            lambda products: model.shared_errors(products) * moves,
            lambda some, g: {"": self.errors.followed(some[""], template, g, middle=middle)},
            model.gram,
        )

    def terms(self, observed: Interface) -> int:
        """Return the number of observed points."""
        return len(observed.points)


def signed_distances(points: Float[np.ndarray, "point xyz"], interface: Interface) -> Float[np.ndarray, " point"]:
    """Return the distances to the closest points of `interface`, mm; negative on the side away from its normals.

    An open polyline goes on straight beyond its ends, by a twentieth of its length: a point that is off along the
    polyline, not across it, is not charged there.
    """
    return _signed(points, Interface(extended(interface.points[None], interface)[0], interface.cells))


def _signed(points: Float[np.ndarray, "point xyz"], interface: Interface) -> Float[np.ndarray, " point"]:
    found = closest_points(points, interface, once=True)
    corners = interface.points[interface.cells[found.cells, 0]]
    side = ((points - corners) * interface.normals[found.cells]).sum(axis=1)
    return np.asarray(np.copysign(np.sqrt(found.squares), side))


def weighted_sums(
    seen: Float[np.ndarray, "seen xyz"],
    points: Float[np.ndarray, "run point xyz"],
    template: Interface,
    weights: Float[np.ndarray, " seen"],
    features: Float[np.ndarray, "seen feature"],
    *,
    rough: bool = False,
    longer: bool = False,
) -> Sums:
    """Return Σ w r² and Σ f r over the signed distances r of the observed points, for each simulated interface.

    Means of neighbouring points stand for many points of a polyline, see `strandline.discrepancy.search.local_means`.

    Args:
        seen: Observed points, mm.
        points: Nodes of the simulated interfaces, mm.
        template: A simulated interface, for its cells.
        weights: Weights w.
        features: Factors f.
        rough: Whether very few places along a polyline stand for all points.
        longer: Whether the interfaces are longer by `extended` already.
    """
    points = points if longer else extended(points, template)
    if template.dim == 2 and len(points) >= FEWEST:
        found = _by_places(seen, points, template, weights, features, ROUGH if rough else PLACES)
        if found is None:
            found = signed_sums(seen, points, template.cells, weights, features)
        if found is not None:
            return found
    each = [_signed(seen, Interface(row, template.cells)) for row in points]
    r = np.array(each, float).reshape(len(points), len(seen))
    return r**2 @ weights, r @ features


def _by_places(
    seen: Float[np.ndarray, "seen 2"],
    points: Float[np.ndarray, "run point 2"],
    template: Interface,
    weights: Float[np.ndarray, " seen"],
    features: Float[np.ndarray, "seen feature"],
    number: int,
) -> Sums | None:
    """Return the sums over many points from the distances of a few places, as r_i = r of its place + e_i."""
    means = local_means(seen, number)
    if means is None:
        return None
    off = _side(means, Snapshot.of(template)) * means.off
    cross = means.of_places(weights * off)
    columns = np.column_stack([means.of_places(features), cross])
    found = signed_sums(means.places, points, template.cells, means.of_places(weights), columns)
    if found is None:
        return None
    squares, products = found
    return squares + 2 * products[:, -1] + float(weights @ off**2), products[:, :-1] + off @ features


def extended(points: Float[np.ndarray, "run node xyz"], template: Interface) -> Float[np.ndarray, "run node xyz"]:
    """Return interfaces with the cells of `template`; the end segments of open polylines are a twentieth longer."""
    if template.dim == 3 or template.closed:
        return points
    cells, places = template.cells, as_complex(points)
    whole = np.abs(places[:, cells[:, 1]] - places[:, cells[:, 0]]).sum(axis=1)
    out = points.copy()
    for end, inner in (cells[0], cells[-1, ::-1]):
        step = points[:, end] - points[:, inner]
        out[:, end] += (BEYOND * whole / np.linalg.norm(step, axis=1))[:, None] * step
    return out


@lru_cache(maxsize=64)
def _side(means: LocalMeans, snapshot: Snapshot) -> float:
    return means.side(snapshot.interface)


@lru_cache(maxsize=64)
def _model(errors: PointErrors, snapshot: Snapshot) -> ErrorModel:
    return errors.model(snapshot.interface)
