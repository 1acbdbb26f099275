"""Errors of the points of an observed interface: local ones, correlated along it, and global ones.

Point i is off by e_i along its normal, with standard deviation s and correlation length ℓ along the interface. The
whole interface may be shifted, turned, scaled, and offset along its normals (a threshold that is a little too low).
For residuals r, the signed distances of the points to the true interface, this makes the covariance

    C = D + B Bᵀ,  D_ii = s_i² coth(h_i/2ℓ) on a polyline, s_i² max(1, 2πℓ²/a_i) on a surface,

with h_i the length and a_i the area that belong to a point, and B what one standard deviation of each global error does
to r. D has the spectral density of errors correlated as exp(-t/ℓ) at low frequencies, nearly s² 2ℓ/h for h below ℓ and
never below s²: enough for inputs that move the interface over lengths well above ℓ, and never singular.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import cho_solve, solve_triangular

from strandline.foundations import unfit
from strandline.interface.interface import Interface
from strandline.interface.normals import as_complex, as_pairs, node_normals, rotations, spacings, steady_normals

Draws = Float[np.ndarray, "draw point"]
PerPoint = Float[np.ndarray, " point"]
Errors = Float[np.ndarray, "run error"]
Place = Float[np.ndarray, " xyz"]
Nodes = Float[np.ndarray, "run node xyz"]
GLOBAL = ("shift", "rotation", "scale", "offset")
"""Names of the errors that all points share."""
MOST = {"rotation": 45.0, "scale": 0.5}
"""Largest standard deviations, degrees and a share; larger values are surely mistakes."""
_WAVES = 1000
"""Waves that make up the fields of errors on a surface."""


@dataclass(frozen=True)
class PointErrors:
    """Standard deviations of the errors of an observed interface.

    Args:
        sd: Standard deviation s of a point along its normal, mm.
        length: Correlation length ℓ = ∫₀^∞ ρ(t) dt along the interface, mm; 0 for independent points.
        shift: Standard deviation of the position of the whole interface, along each axis, mm.
        rotation: Standard deviation of its rotation, about each axis on a surface, degrees.
        scale: Standard deviation of its scale, as a share (0.005: half a per cent).
        offset: Standard deviation of a common offset along the normals, mm.
        shares: Standard deviation of each point relative to `sd`, if they differ; see `PointErrors.of_each`.
        shared: Whether shift, rotation and scale are the same for all observations, as with a fixed camera.

    Raises:
        InvalidInput: An `sd` that is not above 0, or another number that is negative or not finite.
    """

    sd: float
    length: float = 0.0
    shift: float = 0.0
    rotation: float = 0.0
    scale: float = 0.0
    offset: float = 0.0
    shared: bool = False
    shares: tuple[float, ...] = ()

    @classmethod
    def of_each(cls, sds: Sequence[float] | PerPoint, **others: Any) -> "PointErrors":
        """Return errors with a standard deviation for each point, mm; `sd` is their root mean square.

        Raises:
            InvalidInput: A standard deviation that is not above 0 or not finite, or none at all.
        """
        if not len(sds):
            remedy = "Give them, or state one that holds for all points."
            raise unfit("errors of the observed points", "no standard deviation", "one for each point", remedy)
        for number, sd in enumerate(sds, start=1):
            if not (math.isfinite(sd) and sd > 0):
                remedy = "Correct it, or leave the point out."
                raise unfit(f"standard deviation of point {number}", float(sd), "a finite number above 0", remedy)
        rms = float(np.sqrt(np.mean(np.square(sds))))
        return cls(rms, shares=tuple((np.asarray(sds, float) / rms).tolist()), **others)

    def __post_init__(self) -> None:
        for name in ("sd", "length", *GLOBAL):
            value, most = getattr(self, name), MOST.get(name, math.inf)
            if math.isfinite(value) and (value > 0 if name == "sd" else 0 <= value <= most):
                continue
            limit = f", at most {most:g}" + (" degrees" if name == "rotation" else ", a share") if name in MOST else ""
            expected = "a finite number above 0" if name == "sd" else f"a finite number, 0 or above{limit}"
            raise unfit(f"{name} of the errors of points", value, expected, f"Correct {name}.")

    def reversed(self) -> "PointErrors":
        """Return the errors of the same points in the opposite order."""
        return replace(self, shares=self.shares[::-1])

    @property
    def local_part(self) -> "PointErrors":
        """The same errors without the global ones."""
        return PointErrors(self.sd, self.length, shares=self.shares)

    def of_points(self, number: int) -> "PointErrors":
        """Return the errors of an interface with this number of points: if it is another one, all have `sd`."""
        return self if len(self.shares) in (0, number) else replace(self, shares=())

    @property
    def facts(self) -> dict[str, float]:
        """The parameters by name, lengths in mm."""
        others = {f"{name}_sd": float(getattr(self, name)) for name in GLOBAL if getattr(self, name) > 0}
        if self.shares:
            others |= {"least_point_sd": self.sd * min(self.shares), "largest_point_sd": self.sd * max(self.shares)}
        return {"point_sd": float(self.sd), "correlation_length": float(self.length), **others}

    def model(self, seen: Interface, *, middle: Place | None = None) -> "ErrorModel":
        """Return the covariance of the signed distances of the points of `seen`.

        Args:
            seen: The observed interface.
            middle: Point about which it is turned and scaled, mm; default: the mean of its points.

        Raises:
            InvalidInput: A correlation length above half the length of the interface.
        """
        self.require_fits(seen)
        shared = self._global(seen, seen.points.mean(axis=0) if middle is None else middle)
        return ErrorModel(self.local_variances(seen), shared)

    def require_fits(self, seen: Interface) -> None:
        """Refuse an interface of less than two correlation lengths, or smaller than a shift or an offset."""
        extent = float(np.linalg.norm(np.ptp(seen.points, axis=0)))
        for name in ("shift", "offset"):
            if getattr(self, name) > extent:
                expected = f"at most the size of the observed interface, {extent:.4g} mm"
                remedy = "Correct it, its unit, or the unit of the observation."
                raise unfit(f"{name} of the errors of points", f"{getattr(self, name):.4g} mm", expected, remedy)
        whole = float(seen.lengths.sum()) if seen.dim == 2 else math.sqrt(float(seen.areas.sum()))
        if self.length > 0.5 * whole:
            expected = f"at most half the length of the interface, {0.5 * whole:.4g} mm"
            remedy = "Correct it, its unit or that of the observation; or state a shift, rotation, scale or offset."
            raise unfit("correlation length of the errors of points", f"{self.length:.4g} mm", expected, remedy)

    def local_variances(self, seen: Interface) -> PerPoint:
        """Return D_ii, mm²."""
        own = spacings(seen, gaps=False)
        if seen.dim == 2:
            return np.asarray(self.sds(seen) ** 2 * 2 * summed_length(self.length, own) / own)
        return np.asarray(self.sds(seen) ** 2 * np.maximum(1.0, 2 * math.pi * self.length**2 / own))

    def sds(self, seen: Interface) -> PerPoint:
        """Return the standard deviation of each point, mm.

        Raises:
            InvalidInput: The errors belong to another number of points.
        """
        if self.shares and len(self.shares) != len(seen.points):
            found = f"{len(self.shares)} standard deviations for {len(seen.points)} points"
            remedy = "State those of this interface, or one that holds for all points."
            raise unfit("errors of the observed points", found, "one for each point", remedy)
        return np.asarray(np.full(len(seen.points), self.sd) * np.array(self.shares or 1.0))

    def local_draws(self, true: Interface, number: int, random: np.random.Generator) -> Draws:
        """Return local errors, mm, correlated as exp(-t/ℓ) along the interface, one row per draw."""
        return np.asarray(self.sds(true) * correlated(true, self.length, number, random))

    def effective_length(self, seen: Interface) -> float:
        """Return ℓ, mm, as points h apart show it, see `summed_length`: independent points have ℓ = h/2."""
        if seen.dim == 2:
            return float(summed_length(self.length, spacings(seen).mean()))
        return max(self.length, 0.5 * float(np.sqrt(spacings(seen)).mean()))

    def draw(self, true: Interface, random: np.random.Generator) -> Interface:
        """Return `true` as it might be observed; local errors are correlated as exp(-t/ℓ) along it."""
        local = self.local_draws(true, 1, random)[0]
        points = true.points + local[:, None] * self._normals(true)
        return self.moved(Interface(points, true.cells), random.standard_normal(self.global_errors(true.dim)))

    def moved(self, seen: Interface, by: Float[np.ndarray, " error"], *, middle: Place | None = None) -> Interface:
        """Return `seen` with its global errors increased, in standard deviations, in the order of `ErrorModel`.

        It is turned and scaled about `middle`, by default the mean of its points.
        """
        shift, rotation, scale, offset = (one[0] for one in self._sizes(by[None], seen.dim))
        middle = seen.points.mean(axis=0) if middle is None else middle
        arm = (1 + scale) * (seen.points - middle) + offset * self._normals(seen)
        return Interface(middle + shift + arm @ rotations(rotation[None])[0].T, seen.cells)

    def followed(self, points: Nodes, template: Interface, by: Errors, *, middle: Place) -> Nodes:
        """Return simulated interfaces after the shift, rotation, scale and offset that the observation has.

        Args:
            points: Nodes of the simulated interfaces, mm.
            template: A simulated interface, for its cells.
            by: Global errors of the observation for each of them, in standard deviations, in the order of `ErrorModel`.
            middle: Point about which the observation was turned and scaled, mm.
        """
        shift, rotation, scale, offset = self._sizes(by, template.dim)
        normals = node_normals(points, template.cells) if offset.any() else np.zeros((1, 1, template.dim))
        if template.dim == 2:
            place, centre, step = as_complex(points), as_complex(middle), as_complex(shift)[:, None]
            arm = (1 + scale) * (place - centre) + offset * as_complex(normals)
            return as_pairs(centre + step + np.exp(1j * rotation) * arm)
        arm = (1 + scale)[..., None] * (points - middle) + offset[..., None] * normals
        return np.asarray(middle + shift[:, None] + np.einsum("rnx,ryx->rny", arm, rotations(rotation)))

    def sizes(self, by: Float[np.ndarray, " error"], dim: int) -> dict[str, tuple[float, ...]]:
        """Return the global errors by name: shift and offset in mm, rotation in degrees, scale as a share.

        Args:
            by: Global errors in standard deviations, in the order of `ErrorModel`.
            dim: Number of coordinates, 2 or 3.
        """
        found = dict(zip(GLOBAL, (tuple(one[0].tolist()) for one in self._sizes(by[None], dim)), strict=True))
        stated = {name: one for name, one in found.items() if getattr(self, name) > 0}
        if "rotation" in stated:
            stated["rotation"] = tuple(math.degrees(angle) for angle in stated["rotation"])
        return stated

    def _sizes(self, by: Errors, dim: int) -> list[Float[np.ndarray, "run _"]]:
        """Return shift, rotation (radians), scale and offset for errors in standard deviations."""
        numbers, found, first = _numbers(dim), [], 0
        for name in GLOBAL:
            size = getattr(self, name) * (math.radians(1.0) if name == "rotation" else 1.0)
            count = numbers[name] if size > 0 else 0
            found.append(size * by[:, first : first + count] if count else np.zeros((len(by), numbers[name])))
            first += count
        return found

    def global_errors(self, dim: int) -> int:
        """Return the number of global errors of an interface in the plane or in space."""
        return sum(_numbers(dim)[name] for name in GLOBAL if getattr(self, name) > 0)

    def moves(self, dim: int) -> Bool[np.ndarray, " error"]:
        """Return which global errors move the interface as a whole: all but the offset along its normals."""
        kept = [(name, count) for name, count in _numbers(dim).items() if getattr(self, name) > 0]
        return np.repeat([name != "offset" for name, _ in kept], [count for _, count in kept]).astype(bool)

    def _normals(self, seen: Interface) -> Float[np.ndarray, "point xyz"]:
        """Return normals whose errors, times the distance that the whole interface may move, are below s."""
        reach = float(np.linalg.norm(np.ptp(seen.points, axis=0))) / 2
        moved = self.shift + self.offset + (math.radians(self.rotation) + self.scale) * reach
        return steady_normals(seen, max(self.length, moved))

    def _global(self, seen: Interface, middle: Place) -> Float[np.ndarray, "point error"]:
        """Return B: what one standard deviation of each global error does to the signed distances, mm."""
        normals, arm = self._normals(seen), seen.points - middle
        turns = np.cross(arm, normals) if seen.dim == 3 else arm[:, :1] * normals[:, 1:] - arm[:, 1:] * normals[:, :1]
        columns = {
            "shift": normals,
            "rotation": math.radians(1.0) * turns,
            "scale": (normals * arm).sum(axis=1, keepdims=True),
            "offset": np.ones((len(arm), 1)),
        }
        stated = [getattr(self, name) * columns[name] for name in GLOBAL if getattr(self, name) > 0]
        return np.hstack(stated or [arm[:, :0]])


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """The covariance C = D + B Bᵀ of n residuals, in O(n).

    Args:
        local: Diagonal of D, shape (n,), mm².
        shared: B, shape (n, k), mm; k may be 0.
    """

    local: PerPoint
    shared: Float[np.ndarray, "point error"]

    @cached_property
    def _factor(self) -> Float[np.ndarray, "error error"]:
        """Lower Cholesky factor of I + Bᵀ D⁻¹ B."""
        return np.linalg.cholesky(np.eye(len(self.gram)) + self.gram)

    @cached_property
    def features(self) -> Float[np.ndarray, "point error"]:
        """D⁻¹ B."""
        return np.asarray(self.shared / self.local[:, None])

    @cached_property
    def gram(self) -> Float[np.ndarray, "error error"]:
        """Bᵀ D⁻¹ B."""
        return np.asarray(self.shared.T @ self.features)

    @cached_property
    def projection(self) -> Float[np.ndarray, "error point"]:
        """The matrix P with Pᵀ P = D⁻¹ B (I + Bᵀ D⁻¹ B)⁻¹ Bᵀ D⁻¹."""
        return np.asarray(np.linalg.solve(self._factor, self.features.T))

    def square(self, residuals: Float[np.ndarray, "*case point"]) -> Float[np.ndarray, "*case"]:
        """Return rᵀ C⁻¹ r, by Woodbury's identity."""
        explained = residuals @ self.projection.T
        return np.asarray((residuals**2 / self.local).sum(axis=-1) - (explained**2).sum(axis=-1))

    def solved(self, residuals: Float[np.ndarray, "*case point"]) -> Float[np.ndarray, "*case point"]:
        """Return C⁻¹ r."""
        return np.asarray(residuals / self.local - (residuals @ self.projection.T) @ self.projection)

    def information(self, slopes: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "dim dim"]:
        """Return JᵀC⁻¹J."""
        return np.asarray(slopes.T @ self.solved(slopes.T).T)

    def square_of(self, squares: Float[np.ndarray, " run"], products: Errors) -> Float[np.ndarray, " run"]:
        """Return rᵀ C⁻¹ r from rᵀ D⁻¹ r and Bᵀ D⁻¹ r."""
        explained = solve_triangular(self._factor, products.T, lower=True)
        return np.asarray(np.maximum(squares - (explained**2).sum(axis=0), 0.0))

    def shared_errors(self, products: Errors) -> Errors:
        """Return the most probable global errors, in their standard deviations: Bᵀ C⁻¹ r, from Bᵀ D⁻¹ r."""
        return np.asarray(cho_solve((self._factor, True), products.T).T)

    @property
    def log_det(self) -> float:
        """log det C, by the matrix determinant lemma."""
        return float(np.log(self.local).sum() + 2 * np.log(np.diag(self._factor)).sum())


def _numbers(dim: int) -> dict[str, int]:
    return {"shift": dim, "rotation": 1 if dim == 2 else 3, "scale": 1, "offset": 1}


def summed_length(length: Any, spacing: Any) -> Any:
    """Return (h/2) coth(h/2ℓ), half of h times the sum of exp(-|k|h/ℓ) over all integers k; arrays of any shape.

    It takes the place of the correlation length ℓ of errors at points h apart: nearly ℓ if h is small, h/2 if ℓ is 0.
    """
    with np.errstate(divide="ignore"):
        return 0.5 * spacing / np.tanh(np.divide(0.5 * spacing, length))


def correlated(interface: Interface, length: float, number: int, random: np.random.Generator) -> Draws:
    """Return standard normal numbers at the points, correlated as exp(-t/ℓ) at distance t, one row per draw.

    On a polyline t is measured along it; the first and last point of a closed one are correlated the way round.
    """
    if length > 0 and interface.dim == 3:  # sums of random waves, Rahimi and Recht 2007; draws share the waves
        waves = random.standard_normal((_WAVES, 3)) / (length * np.abs(random.standard_normal((_WAVES, 1))))
        phases = interface.points @ waves.T
        both = np.hstack([np.cos(phases), np.sin(phases)])
        return np.asarray(random.standard_normal((number, 2 * _WAVES)) @ both.T / math.sqrt(_WAVES))
    white = random.standard_normal((number, len(interface.points)))
    return white if length == 0 else _along(interface, length, white)


def _along(polyline: Interface, length: float, white: Draws) -> Draws:
    keep = np.exp(-polyline.lengths / length)
    new = np.sqrt(1 - keep**2)
    corners = np.append(polyline.cells[:, 0], polyline.cells[-1, 1])
    out, value = np.empty_like(white), white[:, 0]
    out[:, corners[0]] = value
    for k, corner in enumerate(corners[1:]):
        if corner == corners[0]:
            break
        value = keep[k] * value + new[k] * white[:, k + 1]
        out[:, corner] = value
    return out
