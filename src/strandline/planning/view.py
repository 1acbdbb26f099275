"""Where on the interface an experiment looks, how finely, and with which errors."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from strandline.calibration.experiment import CoordinateErrors, Errors
from strandline.calibration.footprint import Footprint
from strandline.errors import InvalidInput
from strandline.interface import Interface, PointErrors, steady_normals

__all__ = ["View", "focused"]

FEWEST_POINTS = 3
"""Smallest number of points of a view."""
WHOLE = (0.0, 1.0)
"""The whole interface, as shares of its arc length."""


@dataclass(frozen=True, eq=False)
class View:
    """Observed places on a simulated interface, with the errors of the points.

    Args:
        footprint: The places.
        errors: Errors of the observed points.
    """

    footprint: Footprint
    errors: Errors

    def seen(self, nodes: Float[np.ndarray, "node xyz"]) -> Interface:
        """Return what would be observed of a simulated interface without errors."""
        return Interface(self.footprint.on(nodes), self.footprint.cells)

    def points(self, nodes: Float[np.ndarray, "move node xyz"]) -> Float[np.ndarray, "move point xyz"]:
        """Return the observed points of simulated interfaces, or displacements of the points given those of nodes."""
        return np.asarray(np.einsum("pc,mpcx->mpx", self.footprint.weights, nodes[:, self.footprint.corners]))

    def along(self, seen: Interface, moves: Float[np.ndarray, "move point xyz"]) -> Float[np.ndarray, "move row"]:
        """Return displacements of the observed points as rows whose errors are known.

        With errors along the normals there is one row for each point, else one for each of its coordinates.

        Args:
            seen: The observed interface whose normals count.
            moves: Displacements of its points, mm, or slopes.
        """
        if isinstance(self.errors, CoordinateErrors):
            return np.asarray(moves.reshape(len(moves), -1))
        return np.asarray(np.einsum("mpx,px->mp", moves, steady_normals(seen)))

    def rows(
        self, reference: Float[np.ndarray, "node xyz"], moves: Float[np.ndarray, "move node xyz"]
    ) -> Float[np.ndarray, "move row"]:
        """Return displacements of the nodes, or slopes, as rows in the same way.

        Args:
            reference: Nodes of the simulated interface whose normals count.
            moves: Displacements of the nodes from there, mm, or slopes.
        """
        return self.along(self.seen(reference), self.points(moves))


def focused(
    view: View,
    nodes: Float[np.ndarray, "node xyz"],
    *,
    part: tuple[float, float] = WHOLE,
    points: int | None = None,
    sd: float | None = None,
    along: Interface | None = None,
) -> View:
    """Return the view of a part of the interface, with another number of points, or with another error of each.

    Args:
        view: The view of the whole interface.
        nodes: Nodes of a simulated interface, whose arc length counts.
        part: Where the part begins and ends, as shares of the observed arc length.
        points: Number of points, at equal distances along the part; by default those of the view that lie in it.
        sd: Standard deviation of each point, mm; that of the view by default.
        along: Interface with the points of the view whose arc length counts instead, for views that must correspond.

    Raises:
        InvalidInput: Fewer than 3 points in the part, or a part or a number of points on a surface.
    """
    if sd is not None:
        view = View(view.footprint, _with_sd(view.errors, sd))
    if part == WHOLE and points is None:
        return view
    seen = view.seen(nodes) if along is None else along
    if seen.dim == 3:
        raise InvalidInput(
            "part, or number of points, of a surface",
            value=f"part {list(part)}, points {points}",
            expected="the whole surface, with its points",
            remedy="Remove `part` and `points`.",
        )
    if points is not None:
        return _resampled(view, seen, part, points)
    return _cut(view, seen, part)


def _with_sd(errors: Errors, sd: float) -> Errors:
    return CoordinateErrors(sd) if isinstance(errors, CoordinateErrors) else replace(errors, sd=sd)


def _cut(view: View, seen: Interface, part: tuple[float, float]) -> View:
    """Return the view of those points that lie in a part."""
    chain, shares = _along(seen)
    chain = chain[(shares >= part[0] - 1e-9) & (shares <= part[1] + 1e-9)]
    if len(chain) < FEWEST_POINTS:
        raise InvalidInput(
            "part of the interface to look at",
            value=f"{list(part)}, which has {len(chain)} of the {len(seen.points)} observed points",
            expected=f"at least {FEWEST_POINTS} points",
            remedy="Make it longer, or add `points`.",
        )
    here = view.footprint
    errors = view.errors
    if isinstance(errors, PointErrors) and errors.shares:
        errors = replace(errors, shares=tuple(errors.shares[number] for number in chain))
    return View(Footprint(here.corners[chain], here.weights[chain], _chained(len(chain))), errors)


def _resampled(view: View, seen: Interface, part: tuple[float, float], points: int) -> View:
    """Return the view with points at equal distances along a part, each between two points of the present view."""
    chain, shares = _along(seen)
    end = part[0] == 0 and part[1] == 1 and seen.closed
    places = np.linspace(*part, points, endpoint=not end)
    after = np.clip(np.searchsorted(shares, places, side="right"), 1, len(chain) - 1)
    share = np.clip((places - shares[after - 1]) / (shares[after] - shares[after - 1]), 0.0, 1.0)[:, None]
    here, first, second = view.footprint, chain[after - 1], chain[after]
    corners = np.hstack([here.corners[first], here.corners[second]])
    weights = np.hstack([(1 - share) * here.weights[first], share * here.weights[second]])
    errors = view.errors
    if isinstance(errors, PointErrors):
        errors = replace(errors, shares=())
    return View(Footprint(corners, weights, _chained(points, closed=end)), errors)


def _along(seen: Interface) -> tuple[np.ndarray, Float[np.ndarray, " corner"]]:
    """Return the numbers of the points along a polyline, and the share of its length before each of them."""
    chain = np.append(seen.cells[:, 0], seen.cells[-1, 1])
    lengths = np.concatenate([[0.0], np.cumsum(seen.lengths)])
    return chain, np.asarray(lengths / lengths[-1])


def _chained(number: int, *, closed: bool = False) -> np.ndarray:
    first = np.arange(number if closed else number - 1)
    return np.stack([first, (first + 1) % number], axis=1)
