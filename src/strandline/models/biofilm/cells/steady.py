"""The steady state at a load: by Newton's method at once, or along the load path if the solid bends far.

The largest compressive strain of the first-order solution decides which. Below `SAFE_STRAIN` full Newton steps reach
the steady state. Above `DIRECT_STRAIN` the fold of the Saint-Venant–Kirchhoff law has been passed in every run seen,
and only the path shows it. Between them Newton's method is tried first, and what it finds has to lie on the branch that
is connected with the state at rest: there the most compressed element is compressed further as the load grows.
`docs/results/forward-model.md` shows the figures behind these bounds.

A path (x, load) is continued by pseudo-arclength: a step prescribes how far a functional of the unknowns advances and
leaves the load free, so that nothing is singular where the load has a maximum. The functional is the strain of the one
element that gives way fastest, chosen again at each step: the fold of a Saint-Venant–Kirchhoff solid is local, and an
arclength over all unknowns does not notice it until it is passed. Source: Keller, Lectures on Numerical Methods in
Bifurcation Problems (1987), chapters 4 and 5; Rheinboldt and Burkardt, ACM Trans. Math. Softw. 9 (1983) 215, for the
local parametrisation.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError
from strandline.models.biofilm import newton
from strandline.models.biofilm.cells.fields import Strain
from strandline.models.biofilm.newton import LinearSolver, NewtonSettings, NewtonStep, Vector

SAFE_STRAIN = 0.2
DIRECT_STRAIN = 0.27
FIRST_STRAIN = 0.25
"""First-order compression at the first point of the path; see `FIRST_SHARE`."""
FIRST_SHARE = 0.8
"""The first point of the path lies at most at this share of the load."""
SHORTEST_PATH = 2
"""Smallest number of Jacobians for a path."""
DIRECT = NewtonSettings(maximum_jacobians=4, smallest_damping=1.0)
Shares = Float[np.ndarray, " share"]


@runtime_checkable
class LoadedSystem(Protocol):
    """r(x, load) = 0; its methods may raise ForwardModelError."""

    @property
    def weights(self) -> Vector: ...

    def residual(self, x: Vector, load: float) -> Vector: ...

    def factorise(self, x: Vector, load: float) -> LinearSolver: ...

    def by_load(self) -> Vector:
        """Return the derivative of the residual with respect to the load, at the last factorised state."""

    def critical_strain(self, x: Vector, tangent: Vector) -> Strain: ...

    def check(self, x: Vector) -> Mapping[str, float]:
        """Return figures that show how close a solution is to being invalid; raise ForwardModelError if it is."""


CORRECTOR = NewtonSettings(1e-3, maximum_jacobians=1, smallest_damping=1.0, contraction=0.8)
"""For points along the path."""
POLISH = NewtonSettings(1e-8, maximum_jacobians=2, smallest_damping=1.0)
"""For a point that seems to lie beyond a fold."""
ARRIVAL = NewtonSettings(maximum_jacobians=6, smallest_damping=0.1)
"""For the state at the target load."""
SHARES, LOAD = np.linspace(0.0, 1.0, 201), slice(-1, None)
FIRST_STEP = 0.2
"""First step of strain, along the tangent."""
SMALLEST_STEP, LARGEST_STEP = 0.001, 0.11
"""Step of strain below which the path stalls, and largest one along the parabola through the last two points."""


@dataclass(frozen=True, eq=False)
class PathPoint:
    """A steady state and the tangent dx/d(load) there."""

    x: Vector
    load: float
    tangent: Vector


@dataclass(frozen=True, eq=False)
class Steady:
    """The unknowns of a steady state, and how many Jacobians they cost."""

    x: Vector
    jacobians: int


class Path:
    """The steady states from rest to a load; the `budget` (0: no limit) counts no Jacobians once that is passed."""

    def __init__(self, system: LoadedSystem, load: float, budget: int) -> None:
        self.system, self.load = system, load
        self.jacobians, self.reached = 0, 0.0
        self.budget, self.bracketed = budget, False
        self.figures: Mapping[str, float] = {}

    def follow(self, linear: Vector, first_load: float) -> Steady:
        """Return the state at the load; the path begins at `first_load`, `linear` is the first-order solution.

        Raises ForwardModelError: ``limit_point``: the load has a maximum below the target load, shown by the sign of
        the tangent beyond it; ``continuation_stalled``: neither is found within the budget; or what `check` raises. The
        evidence holds `load_reached`, the largest load with a steady state that was found, and with a limit point
        `limit_load`, an estimate of the maximum, and `load_slope`, d(load)/d(strain) beyond it, which is negative.
        """
        last = PathPoint(np.zeros_like(linear), 0.0, linear / self.load)
        point = self._first_point(linear, first_load)
        strain, step = self.system.critical_strain(point.x, point.tangent), FIRST_STEP
        while True:
            following = self._advance(last, point, strain, step)
            falls = strain.functional @ following.tangent < 0.0
            if falls:
                fold = self._fold(point, following, strain)
                if fold.evidence["limit_load"] < self.load:
                    raise fold
            elif following.load < self.load:
                last, point = point, following
                strain = self.system.critical_strain(point.x, point.tangent)
                step = self._next_step(last, point, strain)
                continue
            arrived = self._arrival(point, following, strain)
            if arrived is not None:
                return Steady(arrived, self.jacobians)
            step *= 0.5

    def _arrival(self, below: PathPoint, above: PathPoint, strain: Strain) -> Vector | None:
        """Return the steady state at the load between two points, which exists, within the budget or not; None if not
        found."""
        if self.budget > 0 and not self.bracketed:
            self.budget = max(self.budget, self.jacobians + ARRIVAL.maximum_jacobians)
        self.bracketed = True
        loads = _between(below, above, strain, SHARES, LOAD)[:, 0]
        guess = _between(below, above, strain, SHARES[[np.argmax(loads >= self.load)]])[0, :-1]
        try:
            found = newton.solve(AtLoad(self, self.load), guess, weights=self.system.weights, settings=ARRIVAL)
        except ForwardModelError as error:
            if error.kind in SHORTER_STEPS:
                return None
            raise
        return found.x

    def residual(self, x: Vector, load: float) -> Vector:
        return self.system.residual(x, load)

    def factorise(self, x: Vector, load: float) -> LinearSolver:
        """Factorise within the budget, and keep the tangent there."""
        if 0 < self.budget <= self.jacobians:
            raise self._failure("continuation_stalled", "the search along the load path was given up")
        self.jacobians += 1
        jacobian = self.system.factorise(x, load)
        self.tangent = -jacobian.solve(self.system.by_load())
        return jacobian

    def _first_point(self, linear: Vector, load: float) -> PathPoint:
        """Return the steady state at a low load, by Newton's method; at a lower one if that fails."""
        try:
            guess, weights = load / self.load * linear, self.system.weights
            found = newton.solve(AtLoad(self, load), guess, weights=weights, settings=CORRECTOR)
        except ForwardModelError as error:
            if error.kind == "continuation_stalled":
                raise
            return self._first_point(linear, 0.5 * load)
        return self._accepted(found.x, load)

    def _accepted(self, x: Vector, load: float) -> PathPoint:
        try:
            figures = self.system.check(x)
        except ForwardModelError as error:
            raise self._failure(error.kind, error.message, error.evidence) from error
        if load > self.reached:
            self.reached, self.figures = load, figures
        return PathPoint(x, load, self.tangent)

    def _next_step(self, last: PathPoint, point: PathPoint, strain: Strain) -> float:
        """Return a step of strain that leads a little beyond where the slope d(load)/d(strain) would be zero."""
        slopes = [1.0 / (strain.functional @ p.tangent) for p in (last, point)]
        advanced = strain.functional @ (point.x - last.x)
        fall = (slopes[0] - slopes[1]) / advanced if advanced > 0 else 0.0
        wanted = 1.15 * slopes[1] / fall if fall > 0 else np.inf
        return float(np.clip(wanted, 0.5 * LARGEST_STEP, LARGEST_STEP))

    def _advance(self, last: PathPoint, point: PathPoint, strain: Strain, step: float) -> PathPoint:
        """Return the point whose strain is larger by `step`, a half, a quarter, …; a falling tangent is judged at full
        accuracy."""
        reason: tuple[str, str, dict[str, float]]
        reason = ("continuation_stalled", "the steps along the load path became too short", {})
        while step >= SMALLEST_STEP:
            system = _AtStrain(self, strain.functional, strain.functional @ point.x + step)
            weights = np.append(self.system.weights, np.sqrt(len(point.x)))
            start = _predicted(last, point, strain, step)
            try:
                found = newton.solve(system, start, weights=weights, settings=CORRECTOR)
                if strain.functional @ self.tangent < 0.0:
                    found = newton.solve(system, found.x, weights=weights, settings=POLISH)
                return self._accepted(found.x[:-1], float(found.x[-1]))
            except ForwardModelError as error:
                if error.kind not in SHORTER_STEPS:
                    raise
                if error.kind == "inverted_elements":
                    reason = (error.kind, error.message, error.evidence)
            step *= 0.5
        raise self._failure(*reason)

    def _fold(self, before: PathPoint, point: PathPoint, strain: Strain) -> ForwardModelError:
        limit = max(float(_between(before, point, strain, SHARES, LOAD).max()), self.reached)
        evidence = {"limit_load": limit, "load_slope": 1.0 / float(strain.functional @ point.tangent)}
        evidence["critical_strain"] = float(strain.functional @ point.x)
        evidence["critical_x"], evidence["critical_y"] = strain.place
        return self._failure("limit_point", "the load path turns back: there is no steady state beyond", evidence)

    def _failure(self, kind: str, message: str, evidence: dict[str, float] | None = None) -> ForwardModelError:
        spent = {"load_reached": self.reached, "jacobians": float(self.jacobians)}
        return ForwardModelError(kind, message, {**self.figures, **(evidence or {}), **spent})


SHORTER_STEPS = ("newton_stalled", "newton_maxit", "nonfinite_residual", "linear_solve", "inverted_elements")


class _AtStrain:
    """The equations with the load as a further unknown and a given value of a functional as a further equation."""

    def __init__(self, path: Path, functional: Vector, value: float) -> None:
        self._path, self._functional, self._value = path, functional, value

    def residual(self, z: Vector) -> Vector:
        x, load = z[:-1], float(z[-1])
        return np.append(self._path.residual(x, load), self._functional @ x - self._value)

    def factorise(self, z: Vector) -> LinearSolver:
        return _Bordered(self._path.factorise(z[:-1], float(z[-1])), self._path.tangent, self._functional)


@dataclass(frozen=True, eq=False)
class _Bordered:
    """The Jacobian [[J, ∂r/∂load], [functional, 0]] by block elimination; regular if J is, and the tangent rises."""

    jacobian: LinearSolver
    tangent: Vector
    functional: Vector

    def solve(self, right: Vector) -> Vector:
        x = self.jacobian.solve(right[:-1])
        load = (right[-1] - self.functional @ x) / (self.functional @ self.tangent)
        return np.append(x + load * self.tangent, load)


def _predicted(last: PathPoint, point: PathPoint, strain: Strain, step: float) -> Vector:
    """Return unknowns and load after `step`: along the tangent from the first point, later along the parabola."""
    c = strain.functional
    here = np.append(point.x, point.load)
    slope = np.append(point.tangent, 1.0) / (c @ point.tangent)
    if last.load == 0.0:
        return np.asarray(here + step * slope)
    back = c @ (last.x - point.x)
    bend = (np.append(last.x, last.load) - here - back * slope) / back**2
    return np.asarray(here + step * slope + step**2 * bend)


def _between(
    first: PathPoint, second: PathPoint, strain: Strain, shares: Shares, part: slice = slice(None)
) -> Float[np.ndarray, "share part"]:
    """Return unknowns and load, or a part of these, between two points, by Hermite's cubic in a strain from 0 to 1."""
    c, u = strain.functional, shares[:, None]
    width = c @ (second.x - first.x)
    values = [np.append(p.x, p.load)[part] for p in (first, second)]
    slopes = [(width * np.append(p.tangent, 1.0) / (c @ p.tangent))[part] for p in (first, second)]
    weights = ((1 + 2 * u) * (1 - u) ** 2, u**2 * (3 - 2 * u), u * (1 - u) ** 2, u**2 * (u - 1))
    return np.asarray(sum(h * one for h, one in zip(weights, (*values, *slopes), strict=True)))


@runtime_checkable
class Bending(LoadedSystem, Protocol):
    """A loaded solid in a flow."""

    def undeformed(self, load: float) -> Vector: ...

    def largest_compression(self, x: Vector) -> float: ...

    def largest_strain(self, x: Vector) -> Strain: ...


def first_order(bending: Bending, load: float) -> tuple[Vector, NewtonStep]:
    """Return the flow past a rigid body, and Newton's step from there; raises what `bending` raises."""
    start = bending.undeformed(load)
    return start, newton.step(AtLoad(bending, load), start)


def steady_state(bending: Bending, load: float, *, budget: int = 0) -> Steady:
    """Return the steady state at a load that is connected with the one at rest; raise as `Path.follow`.

    The `budget` is a number of Jacobians after which a search along the load path is given up; 0: no limit.
    """
    start, first = first_order(bending, load)
    linear = np.asarray(start + first.correction)
    strain = bending.largest_compression(linear)
    spent = 1
    if strain <= DIRECT_STRAIN:
        try:
            system, weights = AtLoad(bending, load), bending.weights
            found = newton.solve(system, start, weights=weights, settings=DIRECT, first=first)
            spent += found.jacobians
            if strain <= SAFE_STRAIN:
                return Steady(found.x, spent)
            spent += 1
            tangent = -bending.factorise(found.x, load).solve(bending.by_load())
            if bending.largest_strain(found.x).functional @ tangent > 0.0:  # compressed further as the load grows
                return Steady(found.x, spent)
        except ForwardModelError as error:
            spent += int(error.evidence.get("jacobians", 0))
    first_load = load * min(FIRST_SHARE, FIRST_STRAIN / strain)
    left = max(SHORTEST_PATH, budget - spent) if budget else 0
    try:
        traced = Path(bending, load, left).follow(linear, first_load)
    except ForwardModelError as error:
        total = {"jacobians": error.evidence.get("jacobians", 0.0) + spent}
        raise ForwardModelError(error.kind, error.message, error.evidence | total) from error
    return Steady(traced.x, spent + traced.jacobians)


class AtLoad:
    """The equations of a loaded solid at one load, as `newton.solve` takes them."""

    def __init__(self, system: LoadedSystem | Path, load: float) -> None:
        self._system, self._load = system, load

    def residual(self, x: Vector) -> Vector:
        return self._system.residual(x, self._load)

    def factorise(self, x: Vector) -> LinearSolver:
        return self._system.factorise(x, self._load)
