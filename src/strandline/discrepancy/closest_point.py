"""Distance by closest point projection, Eq. (7) of the study."""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from strandline.discrepancy.many_distances import signed_sums
from strandline.discrepancy.nearest import squared_distances
from strandline.discrepancy.protocol import ManyPoints, Offsets, Values, require_alike
from strandline.foundations import require
from strandline.interface import Interface, PointErrors, spacings, steady_lengths

DIRECTIONS = ("to_observed", "to_simulated", "symmetric")
WEIGHTINGS = ("sum", "length")


@dataclass(frozen=True)
class ClosestPoint:
    """d² from the distances between the nodes of one interface and the closest points of the other, mm²; Eq. (7).

    δ_i is the distance from node i to the closest point of the other polyline or surface (anywhere on its segments or
    triangles, not only at its nodes):

    - weighting ``sum``: d² = Σ_i δ_i², mm². As in the study; d² grows with the number of nodes.
    - weighting ``length``: d² = Σ_i w_i δ_i² / Σ_i w_i, mm². w_i is half the length of the segments at node i (the
      trapezoidal rule); on a surface, a third of the area of the triangles there. This is the mean of the squared
      distance over the length (area); it does not depend on the number of nodes as the mesh is refined. Relative to
      the noise variance σ_N² it counts as *one* distance; to make it count as n, set σ_N²/n.

    For points with sd s and correlation length ℓ (at least half their spacing h) along an outline of length L, the
    noise variance σ_N² that fits ``to_simulated`` is s² coth(h/2ℓ) with ``sum`` and 2s²ℓ/L with ``length``, far less
    than s². A study with ``noise: {sd: s, length: ℓ, unit: mm}`` takes it, and for the other directions computes one.

    Args:
        direction: Which nodes are projected: ``to_observed`` projects the simulated nodes onto the observed interface,
            ``to_simulated`` the observed nodes onto the simulated one; ``symmetric`` averages the two d². By default
            ``to_observed``, as in the study; ``to_simulated`` if the errors of the observed points are stated. Where
            only a part of the interface was observed, take ``to_simulated``: the others also charge the simulated nodes
            beyond the end of that part.
        weighting: ``sum`` or ``length``.

    Raises:
        InvalidInput: an unknown direction or weighting.
    """

    direction: str | None = field(default=None, kw_only=True)
    weighting: str = field(default="sum", kw_only=True)
    unit: ClassVar[str] = "mm²"

    def __post_init__(self) -> None:
        for name, value, known in (("direction", self._way, DIRECTIONS), ("weighting", self.weighting, WEIGHTINGS)):
            words = f"one of {', '.join(known)}", f"Correct the {name}."
            require(value in known, f"{name} of the closest point projection", value, *words)

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        """Return d², mm²."""
        require_alike(simulated, observed)
        if self._way == "to_observed":
            return self._one_way(simulated, observed)
        if self._way == "to_simulated":
            return self._one_way(observed, simulated)
        return 0.5 * (self._one_way(simulated, observed) + self._one_way(observed, simulated))

    def many(self, points: ManyPoints, template: Interface, observed: Interface) -> Values | None:
        """Return d² of interfaces with the same cells; None if observed nodes go to surfaces, or to few polylines."""
        require_alike(template, observed)
        if self._way == "to_observed":
            return self._to_observed(points, template, observed)
        if self._way == "to_simulated":
            return self._to_simulated(points, template, observed)
        there, back = (way(points, template, observed) for way in (self._to_observed, self._to_simulated))
        return None if there is None or back is None else 0.5 * (there + back)

    def of_offsets(self, offsets: Offsets, observed: Interface, nodes: int) -> Values:
        """Return the weighted sum of squares, for simulated nodes of the mean square along the observed interface."""
        lengths = node_weights(observed)
        mean = offsets**2 @ (lengths / lengths.sum())
        if self.weighting == "length":
            return np.asarray(mean)
        there, back = nodes * mean, (offsets**2).sum(axis=1)
        shares = {"to_observed": there, "to_simulated": back}
        return np.asarray(shares.get(self._way, 0.5 * (there + back)))

    def adapted(self, errors: PointErrors | None) -> "ClosestPoint":
        """Return the measure with a direction: if none is set, that from points whose errors are stated."""
        return self if self.direction is not None else replace(self, direction="to_simulated" if errors else self._way)

    def noise_variance(self, errors: PointErrors, observed: Interface) -> float | None:
        """Return σ_N², mm², for the distances of observed points: s² coth(h/2ℓ), or 2s²ℓ/L of a mean over the length.

        h is the spacing of the points, L the length of the outline; the second ℓ is `PointErrors.effective_length`. On
        a surface, it is s² max(1, 2πℓ²/a), with the area a of a point. None for simulated nodes, whose spacing the
        observation does not know.
        """
        if self._way != "to_simulated":
            return None
        variances = errors.local_variances(observed)
        if self.weighting == "sum":
            return float(variances.mean())
        if observed.dim == 3:
            areas = spacings(observed)
            return float((variances * areas**2).sum() / areas.sum() ** 2)
        return 2 * errors.sd**2 * errors.effective_length(observed) / float(steady_lengths(observed).sum())

    @property
    def _way(self) -> str:
        return "to_observed" if self.direction is None else self.direction

    def _to_observed(self, points: ManyPoints, template: Interface, observed: Interface) -> Values | None:
        weights = self._weights(points, template)
        if observed.dim == 2:
            found = signed_sums(points, observed.points[None], observed.cells, weights)
            if found is not None:
                return found[0]
        squares = squared_distances(np.ascontiguousarray(points.reshape(-1, template.dim)), observed)
        return np.asarray((weights * squares.reshape(points.shape[:2])).sum(axis=1))

    def _to_simulated(self, points: ManyPoints, template: Interface, observed: Interface) -> Values | None:
        if observed.dim != 2:
            return None
        seen = observed.points[None]
        found = signed_sums(seen, points, template.cells, self._weights(seen, observed))
        return None if found is None else found[0]

    def _weights(self, points: ManyPoints, template: Interface) -> Float[np.ndarray, "#run point"]:
        """Return the weight of each node's squared distance; one row if it is the same in all runs."""
        if self.weighting == "sum":
            return np.ones((1, points.shape[1]))
        weights = _weights_of_many(points, template)
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))

    def terms(self, observed: Interface) -> int | None:
        """Return the number of observed nodes if each contributes one distance.

        None for the other directions, whose number of distances depends on the simulation, and for a mean.
        """
        return len(observed.points) if (self._way, self.weighting) == ("to_simulated", "sum") else None

    def distances(self, simulated: Interface, observed: Interface) -> float:
        """Return how many distances d² sums: one for a mean, half of all nodes if both directions are averaged."""
        if self.weighting == "length":
            return 1.0
        nodes = {"to_observed": len(simulated.points), "to_simulated": len(observed.points)}
        return float(nodes.get(self._way, 0.5 * sum(nodes.values())))

    def _one_way(self, source: Interface, target: Interface) -> float:
        squares = squared_distances(source.points, target)
        if self.weighting == "sum":
            return float(squares.sum())
        weights = node_weights(source)
        return float(weights @ squares / weights.sum())


def node_weights(interface: Interface) -> Float[np.ndarray, " point"]:
    """Return the length (area) of the cells at each node, shared equally among their corners; mm (mm²)."""
    shares = np.repeat(interface.sizes / interface.dim, interface.dim)
    return np.bincount(interface.cells.ravel(), weights=shares, minlength=len(interface.points))


def _weights_of_many(points: ManyPoints, template: Interface) -> Float[np.ndarray, "run point"]:
    """Return `node_weights` of each interface with these points and the cells of `template`."""
    if template.dim == 3:
        return np.stack([node_weights(Interface(row, template.cells)) for row in points])
    i, j = template.cells.T
    steps = points[:, j] - points[:, i]
    halves, weights = 0.5 * np.hypot(steps[..., 0], steps[..., 1]), np.zeros(points.shape[:2])
    weights[:, i] += halves
    weights[:, j] += halves  # a polyline is a chain: a node begins at most one segment and ends at most one
    return weights
