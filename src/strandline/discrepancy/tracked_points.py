"""Distance between corresponding nodes, for experiments that track material points."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from strandline.discrepancy.protocol import ManyPoints, Values
from strandline.foundations import InvalidInterface, require
from strandline.interface import Interface, PointErrors


@dataclass(frozen=True)
class TrackedPoints:
    """d² = Σ over the nodes of |simulated node - observed node of the same number|², mm²; Eq. (6) for tracked points.

    For coordinates with independent errors of sd s, the noise variance σ_N² is s²; for errors that are correlated over
    a length ℓ along the interface and points h apart, s² coth(h/2ℓ). A study with
    ``noise: {sd: s, length: ℓ, unit: mm}`` takes this.

    Raises:
        InvalidInterface: on evaluation, interfaces with different numbers of nodes or coordinates.
    """

    unit: ClassVar[str] = "mm²"

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        """Return d², mm²."""
        alike, found = simulated.points.shape == observed.points.shape, f"shape {simulated.points.shape}"
        what = "nodes of the simulated interface do not correspond to the tracked points"
        expected = f"shape {observed.points.shape}, node by node the same material points"
        remedy = "Track the simulator's own nodes, or use a measure that needs no correspondence."
        require(alike, what, found, expected, remedy, InvalidInterface)
        return float(np.sum((simulated.points - observed.points) ** 2))

    def terms(self, observed: Interface) -> int:
        """Return the number of independent residuals: one per coordinate of every node."""
        return int(observed.points.size)

    def noise_variance(self, errors: PointErrors, observed: Interface) -> float:
        """Return σ_N² = s² coth(h/2ℓ), mm²: a point errs along its normal and across as much."""
        return float(errors.local_variances(observed).mean())

    def many(self, points: ManyPoints, template: Interface, observed: Interface) -> Values | None:
        """Return d² of interfaces with the same cells, mm²; None if the nodes do not correspond, which is refused."""
        if points.shape[1:] != observed.points.shape:
            return None
        return np.asarray(np.sum((points - observed.points) ** 2, axis=(1, 2)))
