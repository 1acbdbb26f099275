"""Protocols of discrepancies, how to call them, and keys by which interfaces and measures are recognised."""

from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.foundations import InvalidInterface, require
from strandline.interface import Interface, PointErrors

ManyPoints = Float[np.ndarray, "run point xyz"]  # points of interfaces with the same cells, one interface a row, mm
Offsets = Float[np.ndarray, "run seen"]  # signed distances of the observed points from each interface, mm
Values = Float[np.ndarray, " run"]  # a number for each interface


@runtime_checkable
class Discrepancy(Protocol):
    """A measure of how far a simulated interface is from the observed one: d² ≥ 0, finite.

    A plain function with this signature works. A measure may also state its `unit`, e.g. ``mm²``, and `surface_unit`
    if d² of surfaces has another one; the noise variance σ_N² has the same unit. `HasTerms`, `CountsDistances`,
    `ComparesMany` and `FollowsOffsets` describe what else it may offer.
    """

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        """Return d²."""


@runtime_checkable
class HasTerms(Protocol):
    """A measure that knows whether its d² is a sum of independent Gaussian residuals."""

    def terms(self, observed: Interface) -> int | None:
        """Return the number of residuals; None if d² is not such a sum."""


@runtime_checkable
class CountsDistances(Protocol):
    """A measure whose number of squared distances is not the number of independent residuals."""

    def distances(self, simulated: Interface, observed: Interface) -> float:
        """Return the number of distances."""


@runtime_checkable
class ComparesMany(Protocol):
    """A measure that compares a batch of interfaces faster than one by one."""

    def many(self, points: ManyPoints, template: Interface, observed: Interface) -> Values | None:
        """Return d² of the interfaces with these points and the cells of `template`; None to be called one by one."""


@runtime_checkable
class KnowsPointErrors(Protocol):
    """A measure that knows its noise variance σ_N² for stated errors of the observed points."""

    def noise_variance(self, errors: PointErrors, observed: Interface) -> float | None:
        """Return σ_N² for the local errors, in the unit of d²; None where no closed form holds."""


@runtime_checkable
class AdaptsToErrors(Protocol):
    """A measure with options whose best value follows from the errors of the observed points."""

    def adapted(self, errors: PointErrors | None) -> Discrepancy:
        """Return the measure with these options set, but for those that the user set; None if nothing is stated."""


@runtime_checkable
class FollowsOffsets(Protocol):
    """A measure whose d² nearly follows from signed distances if the two polylines are close to each other."""

    def of_offsets(self, offsets: Offsets, observed: Interface, nodes: int) -> Values | None:
        """Return about d² of simulated interfaces with this number of nodes; None if it does not follow.

        `offsets` are signed distances of the points of the `observed` polyline from each of them, mm.
        """


def unit_of(discrepancy: Discrepancy, observed: Interface | None = None) -> str:
    """Return the unit of d² that a measure states, for polylines if nothing is observed; empty if it states none."""
    unit = str(getattr(discrepancy, "unit", ""))
    if observed is None or observed.dim == 2:
        return unit
    return str(getattr(discrepancy, "surface_unit", unit))


def independent_terms(discrepancy: Discrepancy, observed: Interface) -> int | None:
    """Return how many independent residuals d² sums; None if it is not such a sum or this is unknown."""
    return discrepancy.terms(observed) if isinstance(discrepancy, HasTerms) else None


def require_polylines(*interfaces: Interface) -> None:
    """Refuse interfaces that are not polylines in the plane."""
    what, expected = "interface of a discrepancy measure", "a polyline in the plane"
    remedy = "This measure does not support surfaces; choose closest_point, currents or tracked_points."
    for one in interfaces:
        require(one.dim == 2, what, f"points with {one.dim} coordinates", expected, remedy, InvalidInterface)


def require_alike(simulated: Interface, observed: Interface) -> None:
    """Refuse to compare a polyline with a surface."""
    what = "simulated and observed interface of a discrepancy measure"
    found = f"points with {simulated.dim} and with {observed.dim} coordinates"
    words = "two polylines in the plane or two surfaces in space", "Compare like with like."
    require(simulated.dim == observed.dim, what, found, *words, InvalidInterface)


def require_same_direction(simulated: Interface, observed: Interface) -> None:
    """Refuse interfaces whose normals point to opposite sides."""
    what, found = "the simulated interface runs against the observed one", "normals that point to opposite sides"
    expected = "both run through from the same end, or facing the same side"
    remedy = "Turn the observed interface round: oriented_like(observed, simulated)."
    require(not simulated.runs_against(observed), what, found, expected, remedy, InvalidInterface)


def squared_discrepancies(measure: Discrepancy, points: ManyPoints, template: Interface, observed: Interface) -> Values:
    """Return d² of each interface with these points and the cells of `template`.

    The orientation is that of the template.

    Raises:
        InvalidInterface: as the measure does.
    """
    found = measure.many(points, template, observed) if isinstance(measure, ComparesMany) and len(points) else None
    if found is not None:
        return np.asarray(found)
    return np.array([measure(Interface(row, template.cells), observed) for row in points], float)


@dataclass(frozen=True)
class Snapshot:
    """An interface that equals another with the same points and cells: a key for `functools.lru_cache`.

    A copy in another process is recognised as the same interface; an array that was modified is not.
    """

    content: bytes
    interface: Interface = field(compare=False)

    @classmethod
    def of(cls, interface: Interface) -> "Snapshot":
        """Return the key of `interface` as it is now."""
        return cls(interface.points.tobytes() + interface.cells.tobytes(), interface)


@dataclass(frozen=True)
class MeasureKey:
    """A measure that equals another of the same type that prints the same: a key for `functools.lru_cache`."""

    text: str
    measure: Any = field(compare=False)

    @classmethod
    def of(cls, measure: Any) -> "MeasureKey":
        """Return the key of a measure; one that prints its address equals only itself."""
        return cls(f"{type(measure).__module__}.{measure!r}", measure)
