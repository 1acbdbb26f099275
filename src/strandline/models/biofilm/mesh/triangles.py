"""Quadratic and linear fields on triangles in the coordinates of the reference triangle, in all elements at once."""

from dataclasses import dataclass
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float, Int

AtPoints = Float[np.ndarray, "point element"]
Numbers = Int[np.ndarray, " entry"]


@dataclass(frozen=True, eq=False)
class Rule:
    """Constant matrices: fields at the points from coefficients, and integrals over an element from values there.

    Args:
        number: Number of points.
        velocity: Value and slopes of a quadratic field, (3 point, 6).
        pressure: Value of a linear field, (point, 3).
        momentum: Integrals of values and slopes of the quadratic test functions, (6, 3 point).
        mass: Integrals of values of the linear test functions, (3, point).
        by_velocity: Integrals of test times trial functions, (36, 7 point), for the coefficients in `_Fields`.
        by_displacement: The same for slopes of the trial functions alone, (36, 6 point).
        by_pressure: The same for slopes of the test functions and values of linear trial functions, (18, 2 point).
        mass_by_slopes: The same for values of linear test functions and slopes of trial functions, (18, 2 point).
        mass_by_values: The same for values of linear test and trial functions, (9, point).
    """

    number: int
    velocity: Float[np.ndarray, "value 6"]
    pressure: Float[np.ndarray, "point 3"]
    momentum: Float[np.ndarray, "6 value"]
    mass: Float[np.ndarray, "3 point"]
    by_velocity: Float[np.ndarray, "36 coefficient"]
    by_displacement: Float[np.ndarray, "36 fewer"]
    by_pressure: Float[np.ndarray, "18 slope"]
    mass_by_slopes: Float[np.ndarray, "18 slope"]
    mass_by_values: Float[np.ndarray, "9 point"]

    @property
    def slopes(self) -> Float[np.ndarray, "slope 6"]:
        """Slopes of a quadratic field, (2 point, 6)."""
        return self.velocity[self.number :]

    @classmethod
    def of(cls, space: Any, rule: Any) -> "Rule":
        """Return the matrices for the shape functions of `space` and a quadrature rule."""
        points, weights = np.array([point[:2] for point in rule.points]), np.array(rule.weights)
        first = ng.ElementId(ng.VOL, 0)
        quadratic, linear = (ng.H1(space.mesh, order=order).GetFE(first) for order in (2, 1))
        value = np.array([list(quadratic.CalcShape(x, y)) for x, y in points])
        slope = np.array([np.array(quadratic.CalcDShape(x, y)) for x, y in points])
        plain = np.array([list(linear.CalcShape(x, y)) for x, y in points])
        N = np.stack([value, slope[:, :, 0], slope[:, :, 1]])

        def integrals(test: Any, trial: Any) -> Any:
            return np.einsum("aqi,bqj,q->ijabq", test, trial, weights).reshape(test.shape[2] * trial.shape[2], -1)

        return cls(
            number=len(weights),
            velocity=N.reshape(-1, 6),
            pressure=plain,
            momentum=np.ascontiguousarray((N * weights[:, None]).reshape(-1, 6).T),
            mass=np.ascontiguousarray((plain * weights[:, None]).T),
            by_velocity=np.hstack([integrals(N[:1], N), integrals(N[1:], N[1:])]),
            by_displacement=np.hstack([integrals(N[:1], N[1:]), integrals(N[1:], N[1:])]),
            by_pressure=integrals(N[1:], plain[None]),
            mass_by_slopes=integrals(plain[None], N[1:]),
            mass_by_values=integrals(plain[None], plain[None]),
        )


def numbers_of(space: Any, component: int, cells: Int[np.ndarray, " element"]) -> Int[np.ndarray, "axis node element"]:
    """Return the numbers of a field's coefficients, one block for each axis; fields 0 and 2, v and d, are quadratic."""
    start, part = space.Range(component).start, space.components[component]
    found = np.array([part.GetDofNrs(ng.ElementId(ng.VOL, int(cell))) for cell in cells]) + start
    return np.ascontiguousarray(found.reshape(len(cells), -1, 6 if component in (0, 2) else 3).transpose(1, 2, 0))


def map_at_rest(
    mesh: Any, cells: Int[np.ndarray, " element"], rule: Any
) -> Float[np.ndarray, "axis slope point element"]:
    """Return ∂X/∂ξ at the points of each element."""
    maps = np.stack([_slopes_at_rest(mesh, int(cell), rule) for cell in cells], axis=-1)
    return np.ascontiguousarray(maps.transpose(1, 2, 0, 3))


def _slopes_at_rest(mesh: Any, cell: int, rule: Any) -> Float[np.ndarray, "point 2 2"]:
    map_at_rest = mesh.GetTrafo(ng.ElementId(ng.VOL, cell))
    points = [map_at_rest(*point.point[:2]) for point in rule]  # the map must outlive them, and they their slopes
    return np.array([np.array(point.jacobi) for point in points])


def places_of(
    rows: Int[np.ndarray, "row element"], columns: Int[np.ndarray, "column element"]
) -> tuple[Numbers, Numbers]:
    """Return row and column of each entry of a block (row × column, element)."""
    shape = (len(rows), len(columns), rows.shape[1])
    return np.broadcast_to(rows[:, None], shape).ravel(), np.broadcast_to(columns[None], shape).ravel()
