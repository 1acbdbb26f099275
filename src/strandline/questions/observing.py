"""Where on the interface an experiment looks, how finely, with which errors, and what it can be expected to show.

The interface in an experiment to be made follows from one run of it and the surrogate of the present one: what an input
does to the interface there is nearly what it does here, times a factor. With the slopes J of the present field in the
inputs at x₀, and J' of the other one,

    y'(x) = y'(x₀) + A P Δ + a (I - P) Δ + (J' - A J) (u(x) - u(x₀)),   Δ = c(x) - c(x₀),

where c are the coefficients of the present modes, A = J' J⁺ takes slopes to slopes, P = J J⁺ projects onto what the
inputs do at x₀, a is the mean ratio of the slopes, and u are the inputs as the surrogate warps them. The
curvature of the present field is thus carried over. If the experiment is the present one, y' is its own surrogate.

Runs fail where the interface moves too far: those of the present experiment and of other candidates show up to which
displacement they succeed. Failed runs count with the displacement that the surrogate predicts at their inputs.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import cholesky
from scipy.optimize import minimize
from scipy.special import expit, log_expit, logit

from strandline.calibration import CoordinateErrors, Errors, Footprint
from strandline.design import FEWEST_POINTS, WHOLE, Look
from strandline.discrepancy import JointErrors, NormalOffset, shared_errors
from strandline.foundations import InvalidInterface, require
from strandline.interface import ErrorModel, Interface, Observation, PointErrors, steady_normals
from strandline.surrogate import FieldSurrogate, fields_of


@dataclass(frozen=True, eq=False)
class View:
    """Observed places on a simulated interface, with the errors of the points."""

    footprint: Footprint
    errors: Errors

    def seen(self, nodes: Float[np.ndarray, "node xyz"]) -> Interface:
        """Return what would be observed of a simulated interface without errors."""
        return Interface(self.footprint.on(nodes), self.footprint.cells)

    def points(self, nodes: Float[np.ndarray, "move node xyz"]) -> Float[np.ndarray, "move point xyz"]:
        """Return the observed points of simulated interfaces, or displacements of the points given those of nodes."""
        return np.asarray(np.einsum("pc,mpcx->mpx", self.footprint.weights, nodes[:, self.footprint.corners]))

    def along(self, seen: Interface, moves: Float[np.ndarray, "move point xyz"]) -> Float[np.ndarray, "move row"]:
        """Return displacements of the points of `seen`, mm, or slopes, as rows whose errors are known.

        With errors along the normals there is one row for each point, else one for each of its coordinates.
        """
        if isinstance(self.errors, CoordinateErrors):
            return np.asarray(moves.reshape(len(moves), -1))
        return np.asarray(np.einsum("mpx,px->mp", moves, steady_normals(seen)))

    def rows(
        self, reference: Float[np.ndarray, "node xyz"], moves: Float[np.ndarray, "move node xyz"]
    ) -> Float[np.ndarray, "move row"]:
        """Return displacements of the nodes from `reference`, mm, whose normals count, or slopes, as such rows."""
        return self.along(self.seen(reference), self.points(moves))


def focused(view: View, nodes: Float[np.ndarray, "node xyz"], look: Look, along: Interface | None = None) -> View:
    """Return the view of a part of the interface, with another number of points, or with another error of each.

    The part begins and ends at shares of the observed arc length, for which the nodes of a simulated interface count,
    or the points of `along`, for views that must correspond. The points of the look lie at equal distances along it; by
    default they are those of the view that lie in it, at least 3. Surfaces have no parts.
    """
    part, points = look.part, look.points
    if look.sd is not None:
        view = replace(view, errors=replace(view.errors, sd=look.sd))
    if part == WHOLE and points is None:
        return view
    seen = view.seen(nodes) if along is None else along
    words = "the whole surface, with its points", "Remove `part` and `points`."
    require(seen.dim == 2, "part, or number of points, of a surface", f"part {list(part)}, points {points}", *words)
    return _cut(view, seen, part) if points is None else _resampled(view, seen, part, points)


def _cut(view: View, seen: Interface, part: tuple[float, float]) -> View:
    chain, shares = _along(seen)
    chain = chain[(shares >= part[0] - 1e-9) & (shares <= part[1] + 1e-9)]
    value = f"{list(part)}, which has {len(chain)} of the {len(seen.points)} observed points"
    words = f"at least {FEWEST_POINTS} points", "Make it longer, or add `points`."
    require(len(chain) >= FEWEST_POINTS, "part of the interface to look at", value, *words)
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


KEPT = 1e-3  # directions in which no displacement exceeds this share of the errors are left out


def signals_of(
    displacements: Float[np.ndarray, "draw point"],
    information: Callable[[Float[np.ndarray, "point some"]], Float[np.ndarray, "some some"]],
) -> Float[np.ndarray, "draw signal"]:
    """Return displacements as signals z, so that an observation of draw i is z_i + ε with standard normal ε.

    With errors of covariance C, what an observation tells about the displacements V c, mm, which lie in a few
    directions V, is normal with mean c and covariance (Vᵀ C⁻¹ V)⁻¹; `information` returns Vᵀ C⁻¹ V of any directions V,
    1/mm².
    """
    centred = displacements - displacements.mean(axis=0)
    _, sizes, directions = np.linalg.svd(centred, full_matrices=False)
    number = int((sizes > 1e-12 * max(float(sizes[0]), 1e-300)).sum())
    if number == 0:
        return np.zeros((len(centred), 1))
    basis = directions[:number].T
    root = cholesky(information(basis))
    signals = centred @ basis @ root.T
    # Rotate to the directions that the draws differ in most; the errors stay independent.
    _, spreads, axes = np.linalg.svd(signals, full_matrices=False)
    kept = spreads > KEPT * np.sqrt(len(signals))
    return np.asarray(signals @ axes[kept].T) if kept.any() else np.zeros((len(signals), 1))


Nodes = Mapping[str, Float[np.ndarray, "_ _ _"]]  # nodes of simulated interfaces by condition, one interface a row, mm


@dataclass(frozen=True, eq=False)
class Observing:
    """The views of an experiment by condition, and nodes of interfaces, mm, about which displacements are small."""

    views: Mapping[str, View]
    reference: Mapping[str, Float[np.ndarray, "_ _"]]

    def focused(self, look: Look, along: Mapping[str, Interface] | None = None) -> "Observing":
        """Return `focused` views; `along` are whole interfaces by condition whose arc lengths count, not their own."""
        along = along or {}
        views = {n: focused(view, self.reference[n], look, along.get(n)) for n, view in self.views.items()}
        return Observing(views, self.reference)

    @cached_property
    def seen(self) -> dict[str, Interface]:
        """What would be observed of the reference without errors, by condition."""
        return {name: view.seen(self.reference[name]) for name, view in self.views.items()}

    def signals(self, nodes: Nodes) -> Float[np.ndarray, "draw signal"]:
        """Return what would be observed of interfaces, in standard deviations of independent errors."""
        rows = [view.rows(self.reference[n], nodes[n] - self.reference[n]) for n, view in self.views.items()]
        return signals_of(np.hstack(rows), self.information)

    def fisher(self, slopes: Mapping[str, Float[np.ndarray, "_ xyz dim"]]) -> Float[np.ndarray, "dim dim"]:
        """Return the Fisher information of the inputs from the slopes of the nodes by condition, mm per unit of it."""
        rows = [view.rows(self.reference[n], np.moveaxis(slopes[n], -1, 0)) for n, view in self.views.items()]
        return self.information(np.hstack(rows).T)

    def information(self, directions: Float[np.ndarray, "row some"]) -> Float[np.ndarray, "some some"]:
        """Return Vᵀ C⁻¹ V for displacements V of all observed points and the covariance C of their errors, 1/mm²."""
        model = self._model
        if model is not None:
            return model.information(directions)
        total, first = np.zeros((directions.shape[1], directions.shape[1])), 0
        for name, view in self.views.items():
            errors, number = view.errors, len(view.footprint.corners)
            if isinstance(errors, CoordinateErrors):
                rows = directions[first : first + number * self.reference[name].shape[1]]
                total += rows.T @ rows / errors.sd**2
            else:
                rows = directions[first : first + number]
                total += errors.model(self.seen[name]).information(rows)
            first += len(rows)
        return total

    @cached_property
    def _model(self) -> ErrorModel | None:
        """Covariance of all errors together; None if an interface has errors of coordinates."""
        known = {name: view.errors for name, view in self.views.items() if isinstance(view.errors, PointErrors)}
        if len(known) < len(self.views):
            return None
        seen = tuple(Observation(self.seen[name], errors, name) for name, errors in known.items())
        return (shared_errors(seen, NormalOffset()) or JointErrors(seen, tuple(known.values()))).model

    def displacement(self, undeformed: Mapping[str, Float[np.ndarray, "_ _"]]) -> float:
        """Return the root mean square displacement of the reference from undeformed nodes, mm, in their errors."""
        squares = []
        for name, view in self.views.items():
            rows = view.rows(self.reference[name], (self.reference[name] - undeformed[name])[None])[0]
            errors = view.errors
            sds = errors.sds(self.seen[name]) if isinstance(errors, PointErrors) else np.array(errors.sd)
            squares.append((rows / sds) ** 2)
        return float(np.sqrt(np.concatenate(squares).mean()))


STEP = 1e-3  # step of the differences of the present field, in widths of the box
WEAK = 1e-3
"""Directions of the inputs that move the present field by less than this share of the strongest are carried over by
their slopes alone."""


Fields = Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, "point value"]]  # a field, mm, by inputs
Fails = Callable[[Float[np.ndarray, "draw value"]], Float[np.ndarray, " draw"]]  # probability that a field's run fails


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
    """Return interfaces by condition as a field of the surrogate, mm; refuse those without common points."""
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


SLOPE_SD, OFFSET_SD = 50.0, 50.0  # standard deviations of the prior of the logistic function's slope and offset
PRIOR_RUNS, RARE = 2.0, 0.05  # runs that the base rate of failures begins with, and the share of these that fail
MOST_CHECKED = 200  # interfaces that are checked for crossing themselves


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
