"""What was observed: an interface, its noise, and the condition it belongs to."""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.foundations import is_label, unfit
from strandline.interface.interface import Interface
from strandline.interface.normals import spacings
from strandline.interface.point_errors import GLOBAL, PointErrors

Known = tuple[float, float] | float | None
"""A range with a log-uniform prior, a known value, or None for a wide range that follows from the residuals."""
_TYPICAL = 0.1
"""Guess of the sd, in spacings of the observed points, until residuals are known."""


@runtime_checkable
class Noise(Protocol):
    """Errors of one observed interface, as a discrepancy d² sees them.

    Nothing else turns d² into a log-likelihood, for runs and for surrogates alike. `strandline.testing.noise` checks
    an implementation.
    """

    @property
    def scale(self) -> float:
        """The d² that costs half a unit of log-likelihood, in the unit of d²; σ_N² for a Gaussian."""

    @property
    def facts(self) -> dict[str, float]:
        """Its parameters by name, for summary.json and posterior.nc."""

    def log_density(self, squared: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the log-likelihood of discrepancies d² ≥ 0, without `constant`; 0 at d² = 0, falling from there."""

    def constant(self, terms: int) -> float:
        """Return the constant that `log_density` omits from the density of `terms` residuals whose squares sum to d².

        With it, that density integrates to 1. It is used to compare models by their evidence if the discrepancy is
        such a sum.
        """


@dataclass(frozen=True)
class GaussianNoise:
    """Independent Gaussian errors of one variance: log L = -½ d²/σ_N² (Willmann et al. 2022, Eq. 4).

    Args:
        variance: Variance σ_N², in the unit of d².

    Raises:
        InvalidInput: A variance that is not a finite number above 0.
    """

    variance: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.variance) and self.variance > 0):
            what, remedy = "noise variance of the observation", "Estimate it from the resolution of the measurement."
            raise unfit(what, self.variance, "a finite number above 0, in the unit of the discrepancy d²", remedy)

    @property
    def scale(self) -> float:
        """Variance σ_N²."""
        return self.variance

    @property
    def facts(self) -> dict[str, float]:
        """The variance."""
        return {"noise_variance": self.variance}

    def log_density(self, squared: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return -½ d²/σ_N²."""
        return np.asarray(-0.5 * squared / self.variance)

    def constant(self, terms: int) -> float:
        """Return -½ n log(2πσ_N²)."""
        return -0.5 * terms * math.log(2 * math.pi * self.variance)


NOISES = {"gaussian": GaussianNoise}
"""Noise models by their names in study files."""


@dataclass(frozen=True)
class UnknownErrors:
    """Errors of points whose sd and correlation length are not known.

    Args:
        sd: Standard deviation of a point along its normal, mm: a range with a log-uniform prior, a known value, or None
            for a wide range.
        length: Correlation length along the interface, mm; likewise.
        shift: Standard deviation of the position of the whole interface, along each axis, mm.
        rotation: Standard deviation of its rotation, degrees.
        scale: Standard deviation of its scale, as a share.
        offset: Standard deviation of a common offset along the normals, mm.
        model_error: Whether the model may err by a smooth offset along the interface, of unknown size.
        spread: Numbers of the inputs that may differ from condition to condition, by an unknown amount.

    Raises:
        InvalidInput: A range that is empty or not above 0, or another number that `PointErrors` refuses.
    """

    sd: Known = None
    length: Known = None
    shift: float = 0.0
    rotation: float = 0.0
    scale: float = 0.0
    offset: float = 0.0
    model_error: bool = False
    spread: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name, given in (("sd", self.sd), ("length", self.length)):
            if isinstance(given, tuple) and not (math.isfinite(given[1]) and 0 < given[0] < given[1]):
                expected, remedy = "a range [low, high] with 0 < low < high", "Correct the range, or write `unknown`."
                raise unfit(f"{name} of the errors of points", list(given), expected, remedy)
        self.known(_middle(self.sd, 1.0), _middle(self.length, 0.0))

    @property
    def facts(self) -> dict[str, float]:
        """The global errors by name, lengths in mm."""
        return {f"{name}_sd": float(getattr(self, name)) for name in GLOBAL if getattr(self, name) > 0}

    @property
    def stated(self) -> bool:
        """Whether both sd and correlation length are known, so that only an error of the model is inferred."""
        return isinstance(self.sd, float) and isinstance(self.length, float)

    @property
    def inferred(self) -> str:
        """What is inferred, in words."""
        if not self.stated:
            return "unknown"
        return "a model error" if self.model_error else "a spread"

    def known(self, sd: float, length: float) -> PointErrors:
        """Return the errors with this sd and correlation length, mm."""
        return PointErrors(sd, length, self.shift, self.rotation, self.scale, self.offset)

    def typical(self, seen: Interface) -> PointErrors:
        """Return a first guess of the errors."""
        spacing = float(np.median(spacings(seen)))
        sd = _middle(self.sd, _TYPICAL * (spacing if seen.dim == 2 else math.sqrt(spacing)))
        return self.known(sd, _middle(self.length, 0.0))

    def require_fits(self, seen: Interface) -> None:
        """Refuse an interface that is too short for the correlation length, and surfaces."""
        if seen.dim == 3:
            remedy = "Remove `model_error` and `spread`."
            remedy = remedy if self.stated else "State them, e.g. noise: {sd: 3, length: 15, unit: um}."
            expected = "a known sd and correlation length, and no model error"
            raise unfit("noise of points on a surface", self.inferred, expected, remedy)
        longest = self.length[1] if isinstance(self.length, tuple) else self.length or 0.0
        self.known(1.0, longest).require_fits(seen)

    def sds(self, otherwise: Float[np.ndarray, " guess"]) -> Float[np.ndarray, " sd"]:
        """Return values of the sd to be compared, mm: `otherwise`, or what of it is in the range."""
        return _values(self.sd, otherwise)

    def lengths(self, otherwise: Float[np.ndarray, " guess"]) -> Float[np.ndarray, " length"]:
        """Return values of the correlation length to be compared, mm; likewise."""
        return _values(self.length, otherwise)


def _middle(given: Known, otherwise: float) -> float:
    if given is None:
        return otherwise
    return math.sqrt(given[0] * given[1]) if isinstance(given, tuple) else float(given)


def _values(given: Known, otherwise: Float[np.ndarray, " guess"]) -> Float[np.ndarray, " value"]:
    if given is None:
        return otherwise
    if isinstance(given, tuple):
        low, high = (float(np.clip(end, *given)) for end in (otherwise[0], otherwise[-1]))
        if not low < high:
            low, high = given
        return np.geomspace(low, high, len(otherwise))
    return np.array([max(float(given), 1e-12)])


@dataclass(frozen=True, eq=False, init=False)
class Observation:
    """An observed interface and its noise.

    Args:
        interface: Observed interface, mm.
        noise: Noise model of the measure; or the errors of the observed points, known or unknown, from which the noise
            of every measure follows; a number is the variance σ_N² of Gaussian noise, in the unit of d².
        condition: Experimental condition or time; "" if the model has only one, without a name.

    Raises:
        InvalidInput: A variance that is not a finite number above 0, or something that is not a noise model.
    """

    interface: Interface
    noise: Noise | PointErrors | UnknownErrors
    condition: str = ""

    def __init__(
        self, interface: Interface, noise: Noise | PointErrors | UnknownErrors | float, condition: str = ""
    ) -> None:
        given: object = interface
        if not isinstance(given, Interface):
            remedy = "Make one of points, e.g. Interface.polyline(points), or read a file with strandline.readers."
            raise unfit("interface of an observation", given, "an Interface", remedy)
        if isinstance(noise, int | float) and not isinstance(noise, bool):
            noise = GaussianNoise(float(noise))
        if not isinstance(noise, Noise | PointErrors | UnknownErrors) or isinstance(noise, type):
            expected = "a noise model, the errors of the points, or the variance σ_N² in the unit of d²"
            remedy = "Give e.g. PointErrors(sd=0.003), or 0.001; strandline.interface.Noise lists its parts."
            raise unfit("noise of an observation", noise, expected, remedy)
        object.__setattr__(self, "interface", interface)
        object.__setattr__(self, "noise", noise)
        object.__setattr__(self, "condition", condition)

    @property
    def known(self) -> PointErrors | None:
        """The errors of the points if they are stated; else None."""
        return self.noise if isinstance(self.noise, PointErrors) else None

    @property
    def unknown(self) -> UnknownErrors | None:
        """The errors of the points if they are to be inferred; else None."""
        return self.noise if isinstance(self.noise, UnknownErrors) else None

    @property
    def errors(self) -> PointErrors | None:
        """The errors of the points, a first guess if they are unknown; None if a noise model is stated."""
        return self.known if self.unknown is None else self.unknown.typical(self.interface)

    def reversed(self) -> "Observation":
        """Return the same observation in the other direction; standard deviations of its points go with them."""
        turned = self.known is not None and self.interface.dim == 2  # a surface keeps the order of its points
        noise = self.known.reversed() if turned and self.known else self.noise
        return Observation(self.interface.reversed(), noise, self.condition)


def is_condition(name: object) -> bool:
    """Return whether `name` can name a condition: "" for the only one, else a short text valid in file names."""
    return is_label(name) and name == name.strip() and not set(name) & set("/\\")
