"""From discrepancies to a log-likelihood: how each observed interface is compared, and the sum over conditions.

An observation states either the noise of a measure, such as a variance σ_N², or the errors of its points. Of the
latter follow the noise of each measure and, for a measure that can use it, the covariance of its residuals.
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, cast

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import (
    AdaptsToErrors,
    Discrepancy,
    JointErrors,
    MeasureKey,
    NormalOffset,
    Snapshot,
    Values,
    WhitenedOffset,
    independent_terms,
    shared_errors,
    squared_discrepancies,
    unit_of,
)
from strandline.foundations import InvalidInput, NumericsError, StrandlineError, require
from strandline.interface import GaussianNoise, Interface, Noise, Observation, PointErrors, UnknownErrors
from strandline.likelihood.noise_rule import differences, noise_variance, second_differences

STEP = 0.5  # step of the finite differences, in standard deviations of the global errors
NEWTON = 2  # Newton's steps


@dataclass(frozen=True, eq=False)
class Registered:
    """d²/σ_N² with the global errors of the observation integrated out; without a unit.

    With g the global errors in their standard deviations, the likelihood is ∫ exp(-½ f(g)) dg with f(g) = d²(g)/σ_N² +
    |g|², where the simulated interface has followed the observation by g. Signed distances of the observed points give
    a first g, Newton's steps lead from there to the least f, and the likelihood is exp(-½ min f) but for a constant
    (Laplace). The Hessian H of d²/σ_N² hardly changes and is computed once, `inverse` is (H + 2I)⁻¹; it also corrects
    one-sided differences to the second order. Each evaluation takes 3 + 2k evaluations of the measure; k, the number of
    global errors, is up to five in the plane.
    """

    measure: Discrepancy
    variance: float
    errors: PointErrors
    inverse: Float[np.ndarray, "error error"]
    unit: ClassVar[str] = "1"

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        return float(self.many(simulated.points[None], simulated, observed)[0])

    def many(self, points: Float[np.ndarray, "run point xyz"], template: Interface, observed: Interface) -> Values:
        """Return -2 log-likelihood of each run, shape (run,): the least over errors of the whole interface."""
        number = self.errors.global_errors(observed.dim)
        middle = observed.points.mean(axis=0)

        def f(g: Float[np.ndarray, "run error"]) -> Values:
            moved = self.errors.followed(points, template, g, middle=middle)
            squares = squared_discrepancies(self.measure, moved, template, observed)
            return np.asarray(squares / self.variance + (g**2).sum(axis=1))

        g = WhitenedOffset(self.errors).global_errors(points, template, observed)
        least = here = f(g)
        bend = 0.5 * STEP * np.diag(np.linalg.inv(self.inverse))
        for _ in range(NEWTON):
            slopes = np.array([(f(g + STEP * e) - here) / STEP for e in np.eye(number)]).T - bend
            g = g - slopes @ self.inverse
            here = f(g)
            least = np.minimum(least, here)
        return np.asarray(least)


def curvature_inverse(
    measure: Discrepancy, variance: float, errors: PointErrors, observed: Interface, nodes: int
) -> Float[np.ndarray, "error error"]:
    """Return (H + 2I)⁻¹ at the observation itself, as simulated interfaces with this number of nodes see it."""
    moves = STEP * differences(errors.global_errors(observed.dim))
    template = observed.resampled(nodes) if observed.dim == 2 else observed
    points = np.repeat(template.points[None], len(moves), axis=0)
    moved = errors.followed(points, template, moves, middle=observed.points.mean(axis=0))
    squares = squared_discrepancies(measure, moved, template, observed)
    values, vectors = np.linalg.eigh(second_differences(squares, moves.shape[1]) / (variance * STEP**2))
    return np.asarray((vectors / (np.maximum(values, 0.0) + 2.0)) @ vectors.T)


@dataclass(frozen=True)
class WhitenedNoise:
    """Noise of residuals whose covariance C, in mm², is in d² already: log L = -½ d²."""

    log_det: float

    @property
    def scale(self) -> float:
        return 1.0

    @property
    def facts(self) -> dict[str, float]:
        return {"noise_variance": 1.0}

    def log_density(self, squared: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        return np.asarray(-0.5 * squared)

    def constant(self, terms: int) -> float:
        return -0.5 * (terms * math.log(2 * math.pi) + self.log_det)


@dataclass(frozen=True, eq=False)
class FittedErrors(PointErrors):
    """Errors of points for which the noise of one measure is known, and taken for similar observations too: σ_N² of the
    local errors, in the unit of d², and (H + 2I)⁻¹ of the global ones, see `Registered`.
    """

    variance: float = 1.0
    inverse: Float[np.ndarray, "error error"] | None = None

    @property
    def facts(self) -> dict[str, float]:
        return {**super().facts, "noise_variance": self.variance}


@dataclass(frozen=True, eq=False)
class Compared:
    """An observation with the measure and the noise that turn a simulated interface into a log-likelihood."""

    observation: Observation
    measure: Discrepancy
    noise: Noise


def with_variance(observation: Observation, measure: Discrepancy, nodes: int) -> Noise | PointErrors | UnknownErrors:
    """Return the noise of an observation such that σ_N² is not computed again for others like it."""
    noise = observation.noise
    if not isinstance(noise, PointErrors) or isinstance(noise, FittedErrors) or isinstance(measure, NormalOffset):
        return noise
    return _fitted(observation, measure, nodes)


def _fitted(observation: Observation, measure: Discrepancy, nodes: int) -> FittedErrors:
    errors = observation.errors
    assert errors is not None
    return _kept(MeasureKey.of(adapted(measure, observation)), Snapshot.of(observation.interface), errors, nodes)


@lru_cache(maxsize=64)
def _kept(key: MeasureKey, snapshot: Snapshot, errors: PointErrors, nodes: int) -> FittedErrors:
    seen = snapshot.interface
    variance = noise_variance(key.measure, seen, errors, nodes)
    several = errors.global_errors(seen.dim) > 0
    inverse = curvature_inverse(key.measure, variance, errors, seen, nodes) if several else None
    return FittedErrors(**vars(errors), variance=variance, inverse=inverse)


def adapted(measure: Discrepancy, observation: Observation) -> Discrepancy:
    """Return the measure with options that suit the errors of the observed points, but for those that the user set."""
    errors = observation.errors
    return measure.adapted(errors) if isinstance(measure, AdaptsToErrors) else measure


def compared(observation: Observation, measure: Discrepancy, nodes: int) -> Compared:
    """Return how an observation is compared with simulated interfaces that have this number of nodes.

    Unknown errors are replaced by a first guess; `infer_noise` infers them.

    Raises:
        InvalidInput: The errors of the points are stated, and no noise variance of the measure fits them.
    """
    errors, seen = observation.errors, observation.interface
    if errors is None:
        return Compared(observation, measure, cast(Noise, observation.noise))
    if not isinstance(measure, NormalOffset):
        fitted = errors if isinstance(errors, FittedErrors) else _fitted(observation, measure, nodes)
        measure = adapted(measure, observation)
        if fitted.inverse is None:
            return Compared(observation, measure, GaussianNoise(fitted.variance))
        registered = Registered(measure, fitted.variance, errors, fitted.inverse)
        return Compared(observation, registered, WhitenedNoise(0.0))
    whitened = WhitenedOffset(errors)
    return Compared(observation, whitened, WhitenedNoise(whitened.model(seen).log_det))


@dataclass(frozen=True)
class InterfaceLikelihood:
    """log L = Σ over conditions of the log density of d² under their noise; for Gaussian noise, Eq. (4) of the study.

    There is an observation for each condition or time that was observed; further simulated ones are ignored.

    Raises:
        InvalidInput: no observation, or two of one condition.
    """

    observations: tuple[Observation, ...]
    discrepancy: Discrepancy

    def __post_init__(self) -> None:
        what, expected = "observations of the likelihood", "at least one observed interface"
        require(self.observations, what, "none", expected, "Supply an observation.")
        name, number = Counter(self.conditions).most_common(1)[0]
        words = "a different condition for each", "Name the conditions as the model does."
        require(number == 1, "conditions of the observations", f"{number} observations of {_spoken(name)}", *words)

    def __call__(self, interfaces: Interface | Mapping[str, Interface]) -> float:
        """Return log L, without `constant`, of the simulated interfaces by condition."""
        simulated = self._matched(interfaces)
        if self._shared is not None:
            return -0.5 * self._shared.square(simulated)
        squares = np.split(self.discrepancies(simulated), len(self.observations))
        ones = [self._compared(o, simulated[o.condition]) for o in self.observations]
        return float(sum(one.noise.log_density(square)[0] for one, square in zip(ones, squares, strict=True)))

    def discrepancies(self, interfaces: Interface | Mapping[str, Interface]) -> Float[np.ndarray, " condition"]:
        """Return d² of each observation, in `unit`; a single interface suffices if there is one observation.

        Raises:
            InvalidInput: an observed condition is not among the simulated ones.
            NumericsError: the measure returned a number that is negative or not finite.
        """
        simulated = self._matched(interfaces)
        return np.array([self._discrepancy(simulated[o.condition], o) for o in self.observations])

    @property
    def conditions(self) -> tuple[str, ...]:
        """The observed conditions, in the order of the observations."""
        return tuple(o.condition for o in self.observations)

    @property
    def independent_terms(self) -> int | None:
        """Number of independent residuals that d² sums over all observations; None if it is not such a sum."""
        counts = [independent_terms(adapted(self.discrepancy, o), o.interface) for o in self.observations]
        known = [count for count in counts if count is not None]
        return sum(known) if len(known) == len(counts) else None

    @property
    def unit(self) -> str:
        """Unit of d² and of the noise variances."""
        first = self.observations[0].interface
        return unit_of(self._compared(self.observations[0], first).measure, first)

    @property
    def constant(self) -> float | None:
        """The Gaussian constant -½ Σ n_c log(2πσ_N,c²) that `__call__` leaves out.

        None if d² is not a sum of n_c independent residuals, with n_c fixed by the observation. Noise that is inferred
        leaves out -½ n log 2π alone. σ_N is in mm: the constant depends on the unit, as any log density of data does.
        """
        counts = [independent_terms(adapted(self.discrepancy, o), o.interface) for o in self.observations]
        measures = [self._compared(o, o.interface).measure for o in self.observations]
        if any(o.unknown for o in self.observations):
            points = sum(len(o.interface.points) for o in self.observations)
            return -0.5 * points * math.log(2 * math.pi)
        if any(count is None for count in counts) or any(isinstance(one, Registered) for one in measures):
            return None
        if self._shared is not None:
            return WhitenedNoise(self._shared.model.log_det).constant(sum(n or 0 for n in counts))
        noises = [self._compared(o, o.interface).noise for o in self.observations]
        return sum(noise.constant(n or 0) for noise, n in zip(noises, counts, strict=True))

    @cached_property
    def _shared(self) -> JointErrors | None:
        return shared_errors(self.observations, self.discrepancy)

    def _compared(self, observation: Observation, simulated: Interface) -> Compared:
        return compared(observation, self.discrepancy, len(simulated.points))

    def _matched(self, interfaces: Interface | Mapping[str, Interface]) -> Mapping[str, Interface]:
        """Return the simulated interfaces by condition, which include all observed ones."""
        if isinstance(interfaces, Interface):
            interfaces = {self.conditions[0] if len(self.conditions) == 1 else "": interfaces}
        missing = [name for name in self.conditions if name not in interfaces]
        lacking, found, wanted = (", ".join(map(_spoken, some)) for some in (missing, interfaces, self.conditions))
        what = f"the simulated interfaces lack {lacking}, which was observed"
        remedy = "Give each observation the name that its condition has in the model."
        require(not missing, what, found or None, f"at least {wanted}", remedy)
        return interfaces

    def _discrepancy(self, simulated: Interface, observation: Observation) -> float:
        found: Any = None
        try:
            found = self._compared(observation, simulated).measure(simulated, observation.interface)
            d2 = float(found)
        except (TypeError, ValueError, ArithmeticError, LookupError, AttributeError) as error:
            if isinstance(error, StrandlineError):
                raise
            raise InvalidInput(
                f"discrepancy {self.discrepancy!r}",
                value=f"a {type(found).__name__}" if found is not None else f"{type(error).__name__}: {error}",
                expected="d², one number",
                remedy="Correct the discrepancy; strandline.testing.discrepancies checks it.",
            ) from error
        if not (math.isfinite(d2) and d2 >= 0):
            raise NumericsError(
                f"discrepancy {self.discrepancy!r} of condition {observation.condition!r} is {d2:g}; "
                "a squared distance is finite and not negative: fix the measure"
            )
        return d2


def _spoken(condition: str) -> str:
    return f"condition {condition!r}" if condition else "a condition without a name"
