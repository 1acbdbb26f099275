"""Univariate prior distributions.

A prior is a small frozen dataclass with a log density that works on NumPy *and* JAX arrays (and under `jax.jit`),
and with a cumulative distribution and quantile on NumPy arrays; that of an input that is correlated with another one
works on JAX arrays too, as all of these do. A study can use your own prior as ``module:name``.
"""

import math
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from scipy import special

from strandline.foundations import InvalidInput, require_types, unfit

Array = Any  # a NumPy or a JAX array of any shape, or a float

LEAST_MASS = 1e-10
"""Minimum mass of a truncated prior; below it, rounding errors of the cumulative distribution show in the density."""
LARGEST, LEAST, LEAST_SHARE = 1e100, 1e-100, 1e-9
"""Largest magnitude of a number in a prior, smallest width, and smallest width as a share of the numbers themselves."""
EDGE = 1e-12  # least share of a prior beyond a point that is mapped to a standard normal quantile
MOST_SHAPE, MOST_MU, MOST_SIGMA = 1e6, 300.0, 100.0
"""Largest shape of a beta distribution, largest |mu| and sigma of a log-normal; exponentials overflow beyond these."""


@runtime_checkable
class Prior(Protocol):
    """A univariate distribution; `support` is the smallest closed interval that carries all mass."""

    @property
    def support(self) -> tuple[float, float]: ...

    def log_density(self, x: Array) -> Array:
        """Return the normalised log density, -inf outside the support; any shape, NumPy or JAX."""

    def cdf(self, x: Array) -> Array:
        """Return the probability of values ≤ x (NumPy)."""

    def quantile(self, p: Array) -> Array:
        """Return the inverse of `cdf` (NumPy)."""


class _Bounded:
    low: float
    high: float

    @property
    def support(self) -> tuple[float, float]:
        return self.low, self.high


@dataclass(frozen=True)
class Uniform(_Bounded):
    """Uniform on [low, high]."""

    low: float
    high: float
    fields: ClassVar[str] = "[low, high]"

    def __post_init__(self) -> None:
        require_types(self)
        _require_interval("uniform", self.low, self.high)

    def log_density(self, x: Array) -> Array:
        xp = _namespace(x)
        inside = (x >= self.low) & (x <= self.high)
        return xp.where(inside, -math.log(self.high - self.low), -xp.inf)

    def cdf(self, x: Array) -> Array:
        return _namespace(x).clip((x - self.low) / (self.high - self.low), 0.0, 1.0)

    def quantile(self, p: Array) -> Array:
        return self.low + np.asarray(p) * (self.high - self.low)


@dataclass(frozen=True)
class Normal:
    """Normal with the given mean and standard deviation."""

    mean: float
    sd: float
    fields: ClassVar[str] = "[mean, sd]"

    def __post_init__(self) -> None:
        require_types(self)
        _require_number("normal", "mean", self.mean)
        _require_number("normal", "sd", self.sd, least=LEAST)

    @property
    def support(self) -> tuple[float, float]:
        return -math.inf, math.inf

    def log_density(self, x: Array) -> Array:
        z = (x - self.mean) / self.sd
        return -0.5 * z * z - math.log(self.sd) - 0.5 * math.log(2 * math.pi)

    def cdf(self, x: Array) -> Array:
        return _special(x).ndtr((x - self.mean) / self.sd)

    def quantile(self, p: Array) -> Array:
        return self.mean + self.sd * special.ndtri(np.asarray(p))


@dataclass(frozen=True)
class LogNormal:
    """log x ~ Normal(mu, sigma²); the mode is exp(mu - sigma²)."""

    mu: float
    sigma: float
    fields: ClassVar[str] = "[mu, sigma]"

    def __post_init__(self) -> None:
        require_types(self)
        hint = " (mu is the mean of log x, not of x)"
        _require_number("lognormal", "mu", self.mu, least=-MOST_MU, most=MOST_MU, hint=hint)
        _require_number("lognormal", "sigma", self.sigma, least=LEAST_SHARE, most=MOST_SIGMA)

    @property
    def support(self) -> tuple[float, float]:
        return 0.0, math.inf

    def log_density(self, x: Array) -> Array:
        """Return the log-normal log density, -inf for x ≤ 0."""
        xp = _namespace(x)
        positive = x > 0
        log_x = xp.log(xp.where(positive, x, 1.0))
        z = (log_x - self.mu) / self.sigma
        value = -0.5 * z * z - log_x - math.log(self.sigma) - 0.5 * math.log(2 * math.pi)
        return xp.where(positive, value, -xp.inf)

    def cdf(self, x: Array) -> Array:
        xp, positive = _namespace(x), x > 0
        z = xp.log(xp.where(positive, x, 1.0) / math.exp(self.mu)) / self.sigma
        return xp.where(positive, _special(x).ndtr(z), 0.0)

    def quantile(self, p: Array) -> Array:
        return np.exp(self.mu + self.sigma * special.ndtri(np.asarray(p)))


@dataclass(frozen=True)
class LogUniform(_Bounded):
    """Uniform in the logarithm on [low, high], both above 0: the density is proportional to 1/x."""

    low: float
    high: float
    fields: ClassVar[str] = "[low, high]"

    def __post_init__(self) -> None:
        require_types(self)
        _require_interval("loguniform", self.low, self.high)
        _require_number("loguniform", "low", self.low, least=LEAST)

    @property
    def _span(self) -> float:
        return math.log(self.high / self.low)

    def log_density(self, x: Array) -> Array:
        """Return -log(x log(high/low)) inside, -inf outside."""
        xp = _namespace(x)
        inside = (x >= self.low) & (x <= self.high)
        return xp.where(inside, -xp.log(xp.where(inside, x, self.low)) - math.log(self._span), -xp.inf)

    def cdf(self, x: Array) -> Array:
        xp = _namespace(x)
        return xp.log(xp.clip(x, self.low, self.high) / self.low) / self._span

    def quantile(self, p: Array) -> Array:
        return np.clip(self.low * np.exp(self._span * np.asarray(p)), self.low, self.high)


@dataclass(frozen=True)
class ScaledBeta(_Bounded):
    """Beta(a, b) stretched to [low, high]."""

    a: float
    b: float
    low: float
    high: float
    fields: ClassVar[str] = "[a, b, low, high]"

    def __post_init__(self) -> None:
        require_types(self)
        _require_number("beta", "a", self.a, least=1 / MOST_SHAPE, most=MOST_SHAPE)
        _require_number("beta", "b", self.b, least=1 / MOST_SHAPE, most=MOST_SHAPE)
        _require_interval("beta", self.low, self.high)

    def log_density(self, x: Array) -> Array:
        """Return the log-density at `x`, of any shape, per unit of the input; -inf outside [low, high]."""
        xp = _namespace(x)
        t = (x - self.low) / (self.high - self.low)
        inside = (t >= 0) & (t <= 1)
        safe = xp.where((t > 0) & (t < 1), t, 0.5)
        interior = (self.a - 1) * xp.log(safe) + (self.b - 1) * xp.log1p(-safe)
        edge = xp.where(t == 0, _at_edge(self.a), _at_edge(self.b))
        value = xp.where((t > 0) & (t < 1), interior, edge)
        norm = float(special.betaln(self.a, self.b)) + math.log(self.high - self.low)
        return xp.where(inside, value - norm, -xp.inf)

    def cdf(self, x: Array) -> Array:
        t = _namespace(x).clip((x - self.low) / (self.high - self.low), 0.0, 1.0)
        return _special(x).betainc(self.a, self.b, t)

    def quantile(self, p: Array) -> Array:
        return self.low + (self.high - self.low) * special.betaincinv(self.a, self.b, np.asarray(p))


@dataclass(frozen=True)
class Truncated:
    """`base` restricted to [low, high] and normalised again; `mass_cut` is the probability left out."""

    base: Prior
    low: float
    high: float
    fields: ClassVar[str] = "{prior: …, low: …, high: …}"

    def __post_init__(self) -> None:
        _require_interval("truncated", self.low, self.high)
        if not self.mass > LEAST_MASS:
            found = f"{self.base} on [{self.low:g}, {self.high:g}]"
            expected = f"an interval in which the prior has a mass above {LEAST_MASS:g}"
            raise unfit("truncated prior keeps no mass", found, expected, "Move the bounds or the prior.")

    @property
    def mass(self) -> float:
        """Probability of `base` in [low, high]."""
        return float(self.base.cdf(self.high) - self.base.cdf(self.low))

    @property
    def mass_cut(self) -> float:
        """Probability of `base` outside [low, high]."""
        return 1.0 - self.mass

    @property
    def support(self) -> tuple[float, float]:
        low, high = self.base.support
        return max(low, self.low), min(high, self.high)

    def log_density(self, x: Array) -> Array:
        xp = _namespace(x)
        inside = (x >= self.low) & (x <= self.high)
        return xp.where(inside, self.base.log_density(x) - math.log(self.mass), -xp.inf)

    def cdf(self, x: Array) -> Array:
        below = self.base.cdf(self.low)
        xp = _namespace(x)
        return xp.clip((self.base.cdf(xp.clip(x, self.low, self.high)) - below) / self.mass, 0, 1)

    def quantile(self, p: Array) -> Array:
        below = self.base.cdf(self.low)
        return np.clip(self.base.quantile(below + np.asarray(p) * self.mass), self.low, self.high)


PRIORS = {"uniform": Uniform, "loguniform": LogUniform, "normal": Normal, "lognormal": LogNormal, "beta": ScaledBeta}
"""Names in study files → classes that take the listed numbers in the order of their fields."""


def truncate(prior: Prior, low: float, high: float) -> Prior:
    """Return `prior` restricted to [low, high]; `prior` itself if nothing is cut off."""
    support_low, support_high = prior.support
    if low <= support_low and support_high <= high:
        return prior
    return Truncated(prior, low, high)


def _namespace(x: Array) -> Any:
    return x.__array_namespace__() if hasattr(x, "__array_namespace__") else np


def _special(x: Array) -> Any:
    """Return SciPy's special functions, or those of JAX for its arrays."""
    return special if _namespace(x) is np else import_module("jax.scipy.special")


def normal_score(prior: Prior, x: Array) -> Array:
    """Return the standard normal quantile of the share of a prior below x, NumPy or JAX; finite also at its ends."""
    return _special(x).ndtri(_namespace(x).clip(prior.cdf(x), EDGE, 1 - EDGE))


def _at_edge(exponent: float) -> float:
    """Return the limit of (exponent - 1)·log t for t → 0."""
    return 0.0 if exponent == 1 else math.copysign(math.inf, 1 - exponent)


def require_span(what: str, low: float, high: float) -> None:
    """Refuse an interval too wide or too narrow to compute with; the message begins with `what`."""
    size = max(abs(low), abs(high))
    if size > LARGEST:
        expected = f"numbers of at most {LARGEST:g} in magnitude"
    elif not high - low >= max(LEAST, LEAST_SHARE * size):
        expected = f"bounds that differ by at least {max(LEAST, LEAST_SHARE * size):.3g}"
    else:
        return
    raise InvalidInput(what, value=[low, high], expected=expected, remedy="Choose other bounds.")


def _require_interval(name: str, low: float, high: float) -> None:
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        remedy = "Correct the bounds."
        raise unfit(f"bounds of the {name} prior", [low, high], "two finite numbers, the lower one first", remedy)
    require_span(f"bounds of the {name} prior", low, high)


def _require_number(
    name: str, field: str, value: float, *, least: float = -LARGEST, most: float = LARGEST, hint: str = ""
) -> None:
    if not (math.isfinite(value) and least <= value <= most):
        above = " above 0," if least > 0 else ""
        expected = f"a finite number{above} from {least:g} to {most:g}{hint}"
        raise unfit(f"{field} of the {name} prior", value, expected, f"Correct {field}.")
