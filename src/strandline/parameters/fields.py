"""Gaussian fields as priors of what varies from point to point, such as the stiffness of a specimen.

A field is written in its Karhunen–Loève modes: mean plus modes times independent standard normal coefficients. These
coefficients are the inputs of a calibration. The modes are eigenvectors of the covariance between points, each of which
counts by the length or area that it stands for (Nyström's method; Ghanem and Spanos, Stochastic Finite Elements, 1991,
section 2.3).

The standard deviation and the length of a field may be unknown: they are then inputs too. With an unknown length the
coefficients belong to a fixed basis V, the modes at the shortest length, and the field is C(length)^(1/2) V times them:
a symmetric root depends smoothly on the length, as the modes themselves would not.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh
from scipy.spatial.distance import cdist

from strandline.foundations import require, require_types, unfit
from strandline.parameters.parameter_space import Parameter
from strandline.parameters.priors import Normal, Prior

COVARIANCES: dict[str, Callable[[Any], Any]] = {
    "matern12": lambda r: np.exp(-r),
    "matern32": lambda r: (1 + np.sqrt(3) * r) * np.exp(-np.sqrt(3) * r),
    "matern52": lambda r: (1 + np.sqrt(5) * r + 5 * r**2 / 3) * np.exp(-np.sqrt(5) * r),
    "squared_exponential": lambda r: np.exp(-0.5 * r**2),
}
"""Correlation of a field at two points by distance over length; Rasmussen and Williams (2006), section 4.2."""
COEFFICIENT_BOX = (-5.0, 5.0)  # interval of each coefficient: a millionth of its prior's mass lies outside
KEPT = 0.99  # share of the variance that the modes keep if their number is not given
MOST_LOG_SD = 3.0  # largest sd of a logarithm, a factor of 20 at a point: more is a number in the unit of the field
TAIL = 1e-3  # mass of the prior of an unknown sd or length on either side of its box, where it has no bound above 0
LENGTHS = 32  # in the box of an unknown length, between which the modes of many draws are interpolated
STEP = 1e-3  # step of the central difference by the length, as a share of it: rounding and curvature err by about 1e-6

Values = Float[np.ndarray, "*some point"]


@dataclass(frozen=True, eq=False)
class Support:
    """Points at which a simulator takes the values of a field, mm, and the length or area that each stands for.

    Raises:
        InvalidInput: Points or weights of another shape, or a weight that is not above 0.
    """

    points: Float[np.ndarray, "point xyz"]
    weights: Float[np.ndarray, " point"]

    def __post_init__(self) -> None:
        shape, weights = np.shape(self.points), np.asarray(self.weights)
        places = len(shape) == 2 and 1 <= shape[1] <= 3
        require(places, "shape of a field's points", shape, "(points, 1 to 3 coordinates)", "Correct it.")
        right = weights.shape == shape[:1]
        require(right, "shape of a field's weights", weights.shape, f"{shape[:1]}, one for each point", "Correct it.")
        require((weights > 0).all(), "least weight of a field", f"{weights.min():g}", "above 0", "Correct it.")

    @classmethod
    def interval(cls, low: float, high: float, points: int) -> "Support":
        """Return the middles of equal parts of an interval, mm."""
        require(low < high, "interval of a field", (low, high), "the lower end first", "Correct it.")
        require(points > 0, "points of a field", points, "at least 1", "Correct it.")
        width = (high - low) / points
        return cls(low + width * (np.arange(points)[:, None] + 0.5), np.full(points, width))


@dataclass(frozen=True)
class GaussianField:
    """A stationary, isotropic Gaussian field, or with `log` one whose logarithm is.

    Args:
        mean: Mean of the field, in its unit; with `log` its median.
        sd: Standard deviation at a point, in the unit of the field; with `log` that of the natural logarithm. A prior
            if it is unknown.
        length: Correlation length, mm; a prior if it is unknown.
        log: Whether the logarithm of the field is Gaussian, so that the field is positive.
        covariance: ``matern12`` (exponential), ``matern32``, ``matern52`` or ``squared_exponential``.
        modes: Number of Karhunen–Loève modes, the inputs of the calibration; by default as many as keep 99 % of the
            variance.

    Raises:
        InvalidInput: A number that is not positive; with `log` an sd above 3; no such covariance.
    """

    mean: float
    sd: float | Prior
    length: float | Prior
    log: bool = True
    covariance: str = "matern32"
    modes: int | None = None

    def __post_init__(self) -> None:
        require_types(self)
        for name, value in {"sd": _box(self.sd)[0], "length": self.shortest, "modes": self.modes}.items():
            right = value is None or value > 0
            require(right, f"{name} of a field", getattr(self, name), "a number above 0", "Correct it.")
        remedy = "Give the median, or set log to false: the field itself is then Gaussian."
        require(self.mean > 0 or not self.log, "mean of a field", self.mean, "its median, above 0", remedy)
        log_sd = not self.log or _box(self.sd)[1] <= MOST_LOG_SD
        remedy = "Divide it by the mean if it is in the unit of the field, or set log to false."
        require(log_sd, "sd of a field", self.sd, f"at most {MOST_LOG_SD:g}, as sd of the natural logarithm", remedy)
        known = self.covariance in COVARIANCES
        require(known, "covariance of a field", self.covariance, f"one of {', '.join(COVARIANCES)}", "Correct it.")

    @property
    def unknown(self) -> tuple[str, ...]:
        """Which of ``sd`` and ``length`` have a prior."""
        return tuple(name for name in ("sd", "length") if isinstance(getattr(self, name), Prior))

    @property
    def shortest(self) -> float:
        """The length, or the smallest in its box, mm."""
        return _box(self.length)[0]

    def on(self, name: str, support: Support, unit: str = "1") -> "RandomField":
        """Return the field as an input of a simulator that takes it at these points.

        Raises:
            InvalidInput: More modes than points, or a length that the points do not resolve.
        """
        count, modes = len(support.points), self.modes
        distances = cdist(support.points, support.points)
        np.fill_diagonal(distances, np.inf)
        spacing = float(np.median(distances.min(axis=1)))
        if self.shortest < spacing:
            value, which = (self.length, "a lower end of ") if "length" in self.unknown else (f"{self.length:g} mm", "")
            expected = f"{which}at least {spacing:.3g} mm, the distance of neighbouring points"
            raise unfit(f"length of the field {name}", value, expected, "Raise it.")
        if modes is None:
            variances, _ = _eigen(self, support, self.shortest)
            modes = min(count, int(np.searchsorted(np.cumsum(variances), KEPT * support.weights.sum())) + 1)
        fewer = "Take fewer modes, or a finer mesh."
        require(modes <= count, f"modes of the field {name}", modes, f"at most {count}, its points", fewer)
        return RandomField(name, replace(self, modes=modes), support, unit)


def _box(given: float | Prior) -> tuple[float, float]:
    """Return the box of a number that may be unknown: the support of its prior, with tails cut off."""
    if not isinstance(given, Prior):
        return given, given
    low, high = given.support
    least = low if low > 0 else float(given.quantile(TAIL))
    return least, high if math.isfinite(high) else float(given.quantile(1 - TAIL))


def _eigen(prior: GaussianField, support: Support, length: float) -> tuple[Values, Float[np.ndarray, "point point"]]:
    """Return variances, falling, and vectors of W^(1/2) C W^(1/2), the covariance of a unit field with its weights."""
    roots = np.sqrt(support.weights)
    distances = cdist(support.points, support.points) / length
    variances, vectors = eigh(roots[:, None] * COVARIANCES[prior.covariance](distances) * roots)
    return np.maximum(variances[::-1], 0.0), vectors[:, ::-1]


@dataclass(frozen=True, eq=False)
class RandomField:
    """A field at the points where a simulator takes it; see `GaussianField.on`."""

    name: str
    prior: GaussianField
    support: Support = field(repr=False)
    unit: str = "1"

    @property
    def count(self) -> int:
        """Number of modes."""
        return cast(int, self.prior.modes)

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the coefficients by falling variance: E_1, E_2, …"""
        return tuple(f"{self.name}_{k}" for k in range(1, self.count + 1))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its inputs: the coefficients; E_sd and E_length if they are unknown."""
        return (*self.coefficients, *self.unknown)

    @property
    def unknown(self) -> tuple[str, ...]:
        """E_sd and E_length, if they are unknown."""
        return tuple(f"{self.name}_{one}" for one in self.prior.unknown)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The inputs of a calibration, in the order of `names`; an unknown sd or length is an input like any other."""
        prior = Normal(0.0, 1.0)
        coefficients = (Parameter(name, prior, box=COEFFICIENT_BOX, of_field=self) for name in self.coefficients)
        units = {"sd": "1" if self.prior.log else self.unit, "length": "mm"}
        given = {one: getattr(self.prior, one) for one in self.prior.unknown}
        unknown = (Parameter(f"{self.name}_{one}", p, units[one], _box(p)) for one, p in given.items())
        return (*coefficients, *unknown)

    @cached_property
    def _basis(self) -> tuple[Float[np.ndarray, " mode"], Float[np.ndarray, "point mode"]]:
        """Variances and vectors of the modes at the shortest length; the largest entry of each mode is positive."""
        variances, vectors = _eigen(self.prior, self.support, self.prior.shortest)
        kept = vectors[:, : self.count]
        largest = np.abs(kept / np.sqrt(self.support.weights)[:, None]).argmax(axis=0)
        return variances[: self.count], kept * np.sign(kept[largest, np.arange(self.count)])

    @cached_property
    def modes(self) -> Float[np.ndarray, "point mode"]:
        """Modes times the standard deviations of their coefficients; at the medians of an unknown sd and length."""
        sd, length = (float(p.quantile(0.5)) if isinstance(p, Prior) else p for p in (self.prior.sd, self.prior.length))
        return sd * _modes_at(self, length)

    @property
    def words(self) -> str:
        """The prior: ``Gaussian field: mean 400 Pa, sd 50 Pa, length 0.15 mm, covariance matern32``."""
        prior, unit = self.prior, "" if self.unit == "1" else f" {self.unit}"
        sd, length = (f"{one:g}" if isinstance(one, int | float) else f"{one}" for one in (prior.sd, prior.length))
        kind, middle = ("Gaussian field of its logarithm", "median") if prior.log else ("Gaussian field", "mean")
        width = sd if prior.log else f"{sd}{unit}"
        return f"{kind}: {middle} {prior.mean:g}{unit}, sd {width}, length {length} mm, covariance {prior.covariance}"

    @property
    def share(self) -> float:
        """Share of the field's variance that the modes have, averaged over its length or area; at the shortest length,
        where it is least, if the length is unknown.
        """
        return float(self._basis[0].sum() / self.support.weights.sum())

    def values(self, inputs: Float[np.ndarray, "*some input"]) -> Values:
        """Return the field at its points, in its unit, for inputs in the order of `names`."""
        return self._of_gaussian(self._of(inputs, "sd")[..., None] * self._unit(inputs, self._of(inputs, "length")))

    def _of_gaussian(self, gaussian: Values) -> Values:
        return np.asarray(self.prior.mean * np.exp(gaussian) if self.prior.log else self.prior.mean + gaussian)

    def values_of_many(self, inputs: Float[np.ndarray, "draw input"]) -> Float[np.ndarray, "draw point"]:
        """Return the values of many draws; with an unknown length, in modes interpolated between 32 lengths of its box.

        Each length needs an eigenvalue problem of all points. Linear in the logarithm of the length, the error is below
        0.5 % of the field's sd in a box whose ends differ by a factor of 20.
        """
        if "length" not in self.prior.unknown:
            return self.values(inputs)
        lengths, modes = self._table
        at = np.log(self._of(inputs, "length") / lengths[0]) / np.log(lengths[1] / lengths[0])
        lower = np.clip(at.astype(int), 0, LENGTHS - 2)
        unit = np.empty((len(inputs), len(self.support.points)))
        for k in np.unique(lower):
            rows = np.flatnonzero(lower == k)
            low, high = (inputs[rows, : self.count] @ modes[i].T for i in (k, k + 1))
            unit[rows] = low + (at[rows] - k)[:, None] * (high - low)
        return self._of_gaussian(self._of(inputs, "sd")[:, None] * unit)

    @cached_property
    def _table(self) -> tuple[Float[np.ndarray, " length"], Float[np.ndarray, "length point mode"]]:
        lengths = np.geomspace(*_box(self.prior.length), LENGTHS)
        return lengths, np.stack([_modes_at(self, float(length)) for length in lengths])

    def slopes(self, inputs: Float[np.ndarray, " input"]) -> Float[np.ndarray, "point input"]:
        """Return the derivatives of the values by the inputs, exact but for a central difference by the length."""
        sd, length = self._of(inputs, "sd"), self._of(inputs, "length")
        found = [sd * _modes_at(self, float(length))]
        if "sd" in self.prior.unknown:
            found.append(self._unit(inputs, length)[:, None])
        if "length" in self.prior.unknown:
            ahead, behind = (self._unit(inputs, np.asarray((1 + by) * length)) for by in (STEP, -STEP))
            found.append((sd * (ahead - behind) / (2 * STEP * length))[:, None])
        slopes = np.concatenate(found, axis=1)
        return np.asarray(self.values(inputs)[:, None] * slopes if self.prior.log else slopes)

    def _of(self, inputs: Float[np.ndarray, "*some input"], which: str) -> Float[np.ndarray, "*some"]:
        if which not in self.prior.unknown:
            return np.full(inputs.shape[:-1], getattr(self.prior, which))
        return np.asarray(inputs[..., self.count + self.prior.unknown.index(which)])

    def _unit(self, inputs: Float[np.ndarray, "*some input"], lengths: Float[np.ndarray, "*some"]) -> Values:
        """Return the Gaussian field less its mean, of unit sd."""
        coefficients = inputs[..., : self.count]
        if "length" not in self.prior.unknown:
            return np.asarray(coefficients @ _modes_at(self, cast(float, self.prior.length)).T)
        rows = zip(lengths.ravel(), coefficients.reshape(-1, self.count), strict=True)
        found = [_modes_at(self, float(length)) @ row for length, row in rows]
        return np.reshape(found, (*lengths.shape, len(self.support.points)))


@lru_cache(maxsize=16)
def _modes_at(field: RandomField, length: float) -> Float[np.ndarray, "point mode"]:
    """Return W^(-1/2) [W^(1/2) C W^(1/2)]^(1/2) V: the modes of a unit field at a length in the basis V, see above."""
    variances, basis = field._basis
    roots = np.sqrt(field.support.weights)[:, None]
    if length == field.prior.shortest:
        return np.asarray(basis * np.sqrt(variances) / roots)
    variances, vectors = _eigen(field.prior, field.support, length)
    return np.asarray((vectors * np.sqrt(variances)) @ (vectors.T @ basis) / roots)
