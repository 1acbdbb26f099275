"""Signed distances of the observed points as a function of the field, near one predicted interface.

A small motion of the simulated interface by a along its normal and by τ along its tangent, at the point closest to an
observed one, changes the signed distance by -a to first order (Danskin 1966) and by τ a' - ½ κ τ² to second order; a'
is the derivative of a along the interface, κ its curvature. One search for closest points yields these for all modes.
Sums over the residuals are then polynomials of the coefficients.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array
from scipy.stats import qmc

from strandline.discrepancy import JointErrors, Sums, closest_points, extended, sums_of
from strandline.interface import ErrorModel, Interface
from strandline.surrogate import FieldSurrogate

REGISTRATIONS = 2  # steps of registration, as in `strandline.discrepancy.normal_offset`
STEP = 1e-6
"""Step of the finite differences, in extents of the interface; all but the ends that go on straight is linear."""
NOTHING = 1e-9  # distance, in extents of the observed interface, below which it has no direction
TRUSTED = 0.5
"""Second-order part of the change of the residuals, as a share of the first-order one, up to which it is trusted."""
TINY = 1e-300  # keeps quotients finite where segments or motions are nothing
BENT = 8  # leading modes that count to second order
BLOCK = 1024  # fields whose likelihood is computed together
TRIED = 256  # inputs tried before the first step
GAUSS_NEWTON_STEPS = 12
SHARES = (1.0, 0.5, 0.25, 0.1)  # shares of a Gauss–Newton step that are tried until one fits better
_DIFFERENCE = 1e-3  # step of the finite differences, in widths of the box
Residuals = Float[np.ndarray, " seen"]
Modes = Float[np.ndarray, "draw mode"]
Tail = Float[np.ndarray, "draw rest"]
Rows = Float[np.ndarray, "row node 2"]
Others = Float[np.ndarray, "other node 2"]
Point = Float[np.ndarray, " dim"]
Slopes = Float[np.ndarray, "seen dim"]


@dataclass(frozen=True, eq=False)
class NearField:
    """r ≈ residuals + slopes z + bends z² + tail t, for z = coefficients - at and what the modes leave over, all in mm.

    The residuals are signed distances of all observed points, one observation after the other. `bends` are factors of
    the products z_k z_l, k ≤ l, of up to `BENT` leading modes, in the order of `numpy.triu_indices`, t are standard
    normal numbers, and `model` is D and B of the residuals' errors, for the sums.
    """

    at: Float[np.ndarray, " mode"]
    residuals: Residuals
    slopes: Float[np.ndarray, "seen mode"]
    bends: Float[np.ndarray, "seen pair"]
    tail: Float[np.ndarray, "seen rest"]
    model: ErrorModel

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.gram).all())

    def sums(self, coefficients: Modes, tail: Tail | None = None) -> Sums:
        """Return rᵀ D⁻¹ r and Bᵀ D⁻¹ r of fields; far away, to first order only."""
        squares, products = [], []
        for first in range(0, len(coefficients), BLOCK):
            part = slice(first, first + BLOCK)
            terms = self._terms(coefficients[part], None if tail is None else tail[part])
            number = terms.shape[1]
            squares.append(np.einsum("dk,dk->d", terms @ self.gram[:number, :number], terms))
            products.append(terms @ self.products[:number])
        return np.concatenate(squares), np.concatenate(products)

    def offsets(self, coefficients: Modes, tail: Tail | None = None) -> Float[np.ndarray, "draw seen"]:
        """Return the residuals r of fields, mm; far away, to first order only."""
        terms = self._terms(coefficients, tail)
        return np.asarray(terms @ self.factors[:, : terms.shape[1]].T)

    def _terms(self, coefficients: Modes, tail: Tail | None) -> Float[np.ndarray, "draw term"]:
        """Return what the columns of `factors` are multiplied by."""
        z = coefficients - self.at
        products, share = self.bending(z)
        columns = [np.ones((len(z), 1)), z, share[:, None] * products]
        return np.hstack(columns if tail is None else [*columns, tail])

    def bending(self, z: Modes) -> tuple[Float[np.ndarray, "draw pair"], Float[np.ndarray, " draw"]]:
        """Return the products z_k z_l, and the share with which they count: less and less far away."""
        modes, pairs = len(self.at), self.bends.shape[1]
        first, second = np.triu_indices(min(modes, BENT))
        products = z[:, first] * z[:, second]
        ahead, bent = slice(1, 1 + modes), slice(1 + modes, 1 + modes + pairs)
        size = np.einsum("dk,dk->d", z @ self.gram[ahead, ahead], z)
        share = np.einsum("dk,dk->d", products @ self.gram[bent, bent], products) / np.maximum(size, TINY)
        return products, np.asarray(1 / (1 + share / TRUSTED**2))

    @cached_property
    def factors(self) -> Float[np.ndarray, "seen term"]:
        return np.column_stack([self.residuals, self.slopes, self.bends, self.tail])

    @cached_property
    def gram(self) -> Float[np.ndarray, "term term"]:
        """Their products, weighed by D⁻¹."""
        return np.asarray(self.factors.T @ (self.factors / self.model.local[:, None]))

    @cached_property
    def products(self) -> Float[np.ndarray, "term error"]:
        """Their products with B, weighed by D⁻¹."""
        return np.asarray(self.factors.T @ self.model.features)


def near_field(
    surrogate: FieldSurrogate, joint: JointErrors, coefficients: Float[np.ndarray, " mode"], *, linear: bool = False
) -> NearField:
    """Return the residuals near the interface with these coefficients, which follows the observations' global errors.

    With `linear`, residuals and slopes are enough.
    """
    modes, rest = len(coefficients), 0 if linear else len(surrogate.modes.tail)
    templates = {name: surrogate.layouts[name].template for name in joint.conditions}
    step = STEP * max(float(np.ptp(one.points, axis=0).max()) for one in templates.values())
    moved = coefficients + step * np.eye(1 + modes + rest, modes, -1)
    points = surrogate.points(moved, step * np.eye(1 + modes + rest, rest, -1 - modes) if rest else None)
    longer = {name: extended(points[name], templates[name]) for name in templates}
    model, g = joint.model, np.zeros((1, joint.model.shared.shape[1]))
    for _ in range(REGISTRATIONS if model.shared.any() else 0):
        first = joint.followed({name: rows[:1] for name, rows in longer.items()}, templates, g)
        r = _distances(joint, first, templates).residuals + model.shared @ g[0]
        g = model.shared_errors((r @ model.features)[None]) * joint.moves
    number, fields = int(np.count_nonzero(joint.moves)) if g.any() else 0, modes + rest
    rows = {name: np.concatenate([one, one[:1].repeat(number, axis=0)]) for name, one in longer.items()}
    by = np.repeat(g, 1 + fields + number, axis=0)
    by[1 + fields :, joint.moves] += STEP * np.eye(number)
    found = _distances(joint, joint.followed(rows, templates, by) if number else rows, templates)
    motion = found.by(np.append(np.full(fields, step), np.full(number, STEP)))
    if number:
        motion = motion.registered(model, joint.moves, fields)
    return NearField(
        at=coefficients,
        residuals=found.residuals + model.shared @ g[0],
        slopes=-motion.across[:, :modes],
        bends=motion.bends(0 if linear else min(modes, BENT)),
        tail=-motion.across[:, modes:],
        model=model,
    )


class _Motions(NamedTuple):
    """Signed distances from an interface, how others move at the closest points, and its curvature there. Motions are
    along the normal, along the tangent, and the derivative of the former along the interface.
    """

    residuals: Residuals
    across: Float[np.ndarray, "seen other"]
    along: Float[np.ndarray, "seen other"]
    turn: Float[np.ndarray, "seen other"]
    curvature: Residuals

    def by(self, steps: Float[np.ndarray, " other"]) -> "_Motions":
        return self._replace(across=self.across / steps, along=self.along / steps, turn=self.turn / steps)

    def registered(self, model: ErrorModel, moves: Bool[np.ndarray, " error"], fields: int) -> "_Motions":
        """Return the motions of r + Bg, g the most probable global errors, from those of r at constant g. The first
        motions are those of `fields`, the others those of an interface that follows the global errors. They are not
        quite B, which belongs to the observed points: with N what they do and g = P (r + Bg), d(r + Bg) = dr + (B - N)
        dg = (I - (B - N) P)⁻¹ dr.
        """
        off = model.shared[:, moves] - self.across[:, fields:]
        P = model.shared_errors(model.features)[:, moves].T
        own = self.across[:, :fields]
        across = own + off @ np.linalg.solve(np.eye(off.shape[1]) - P @ off, P @ own)
        follows = -P @ across
        along, turn = (one[:, :fields] + one[:, fields:] @ follows for one in (self.along, self.turn))
        return self._replace(across=across, along=along, turn=turn)

    def bends(self, modes: int) -> Float[np.ndarray, "seen pair"]:
        """Return the factors of the products of two motions, of the first ones."""
        one, other = np.triu_indices(modes)
        found = self.along[:, one] * self.turn[:, other] + self.along[:, other] * self.turn[:, one]
        found -= self.curvature[:, None] * self.along[:, one] * self.along[:, other]
        return np.asarray(found * np.where(one == other, 0.5, 1.0))


def _distances(joint: JointErrors, points: Mapping[str, Rows], templates: Mapping[str, Interface]) -> _Motions:
    """Return the distances of all observed points from the first of some interfaces, and how the others move."""
    found = [_of_one(o.interface.points, points[o.condition], templates[o.condition]) for o in joint.observations]
    return _Motions(*(np.concatenate(part) for part in zip(*found, strict=True)))


def _of_one(seen: Float[np.ndarray, "seen 2"], points: Rows, template: Interface) -> _Motions:
    interface = Interface(points[0], template.cells)
    found = closest_points(seen, interface, once=True)
    cells, normals = template.cells[found.cells], interface.normals[found.cells]
    ends = points[0][cells]
    side = np.where(((seen - ends[:, 0]) * normals).sum(axis=1) < 0, -1.0, 1.0)
    distance = np.sqrt(found.squares)
    apart = (distance > NOTHING * np.ptp(seen, axis=0).max())[:, None]
    away = np.where(apart, distance[:, None], 1.0)
    n = np.where(apart, side[:, None] * (seen - found.points) / away, normals)
    t = np.stack([n[:, 1], -n[:, 0]], axis=1)
    chord = ends[:, 1] - ends[:, 0]
    t *= np.where((t * chord).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    share = ((found.points - ends[:, 0]) * chord).sum(axis=1) / np.maximum((chord**2).sum(axis=1), TINY)
    moves = points[1:] - points[0]
    slopes, tangents = _along(template, points[0], moves), _along(template, points[0], interface.points[None])[0]
    steep = np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), TINY)
    bent = _along(template, points[0], (tangents / steep)[None])[0]

    def there(values: Float[np.ndarray, "*other node 2"]) -> Float[np.ndarray, "*other seen 2"]:
        """Return values of the nodes at the closest points."""
        first, second = values[..., cells[:, 0], :], values[..., cells[:, 1], :]
        return np.asarray((1 - share)[:, None] * first + share[:, None] * second)

    move, slope = there(moves), there(slopes)
    return _Motions(
        side * distance,
        (move * n).sum(axis=2).T,
        (move * t).sum(axis=2).T,
        (slope * n).sum(axis=2).T,
        (there(bent) * n).sum(axis=1),
    )


def _along(template: Interface, points: Float[np.ndarray, "node 2"], values: Others) -> Others:
    """Return the derivatives of values of the nodes along a polyline: the mean over the segments at each node."""
    first, second = template.cells.T
    segments = np.arange(len(first))
    touching = csr_array((np.ones(2 * len(first)), (np.append(first, second), np.append(segments, segments))))
    lengths = touching @ np.linalg.norm(points[second] - points[first], axis=1)
    number, _, dim = values.shape
    changes = (values[:, second] - values[:, first]).swapaxes(0, 1).reshape(len(segments), number * dim)
    summed = (touching @ changes) / np.maximum(lengths, TINY)[:, None]
    return np.asarray(summed.reshape(len(points), number, dim).swapaxes(0, 1))


@dataclass(frozen=True, eq=False)
class Linearised:
    """r(x) ≈ residuals + slopes (x - at) around the inputs that fit best, in mm and mm per unit of the input; `widths`
    are those of the box, `field` are the residuals as a function of the field there.
    """

    at: Point
    slopes: Slopes
    widths: Point
    field: NearField

    @property
    def residuals(self) -> Residuals:
        """Signed distances of all observed points at `at`, one observation after the other, mm."""
        return self.field.residuals

    @property
    def scaled(self) -> Slopes:
        """What a standard deviation of a uniform prior over the box does to the residuals, mm."""
        return np.asarray(self.slopes * self.widths / np.sqrt(12.0))

    def covariance(self, model: ErrorModel) -> Float[np.ndarray, "dim dim"]:
        """Return the covariance of the inputs that errors of this covariance allow, without a prior."""
        return np.asarray(np.linalg.inv(model.information(self.slopes)))


def linearise(surrogate: FieldSurrogate, joint: JointErrors) -> Linearised:
    """Return the residuals around the inputs that fit best, by Gauss–Newton steps inside the box of the inputs."""
    low, high = surrogate.warping.low, surrogate.warping.high
    widths, model = high - low, joint.model
    middle, many = 0.5 * (low + high), surrogate.shares_kernel
    weak = np.diag((1.0 if many else 1e-6) * 12 / widths**2)  # keeps inputs in place that the data do not tell

    def badness(x: Point, field: NearField) -> float:
        off = x - middle
        return float(model.square(field.residuals)) + (float(off @ weak @ off) if many else 0.0)

    def around(x: Point) -> tuple[NearField, Slopes]:
        step = _DIFFERENCE * widths * np.where(x + _DIFFERENCE * widths > high, -1.0, 1.0)
        coefficients = surrogate.mean(x + np.vstack([np.zeros(len(x)), np.diag(step)]))
        field = near_field(surrogate, joint, coefficients[0], linear=True)
        return field, field.slopes @ ((coefficients[1:] - coefficients[0]) / step[:, None]).T

    sobol = qmc.Sobol(len(low), seed=np.random.default_rng(0))
    tried = low + widths * (np.full((1, len(low)), 0.5) if many else sobol.random(TRIED))
    squares = model.square_of(*sums_of(joint, surrogate.points(surrogate.mean(tried)), surrogate.templates))
    x = tried[int(np.argmin(squares))]
    field, J = around(x)
    for _ in range(GAUSS_NEWTON_STEPS):
        r = field.residuals
        slope = J.T @ model.solved(r) + (weak @ (x - middle) if many else 0.0)
        moved = np.clip(x - np.linalg.solve(model.information(J) + weak, slope), low, high)
        if (np.abs(moved - x) <= 1e-6 * widths).all():
            break
        for share in SHARES:
            field_moved, J_moved = around(x + share * (moved - x))
            if badness(x + share * (moved - x), field_moved) < badness(x, field):
                break
        else:
            break
        x, field, J = x + share * (moved - x), field_moved, J_moved
    return Linearised(x, J, widths, near_field(surrogate, joint, field.at))
