"""From discrepancies to a log-likelihood, summed over conditions."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import Discrepancy, JointErrors, independent_terms, shared_errors, unit_of
from strandline.foundations import InvalidInput, NumericsError, StrandlineError
from strandline.interface import Interface, Observation
from strandline.likelihood.compared import Compared, Registered, WhitenedNoise, adapted, compared


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
        if not self.observations:
            raise InvalidInput(
                "observations of the likelihood",
                value="none",
                expected="at least one observed interface",
                remedy="Supply an observation.",
            )
        name, number = Counter(self.conditions).most_common(1)[0]
        if number > 1:
            raise InvalidInput(
                "conditions of the observations",
                value=f"{number} observations of {_spoken(name)}",
                expected="a different condition for each",
                remedy="Name the conditions as the model does.",
            )

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
        leaves out -½ n log 2π alone. σ_N is in mm: the
        constant depends on the unit, as any log density of data does.
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
        if missing:
            raise InvalidInput(
                f"the simulated interfaces lack {', '.join(map(_spoken, missing))}, which was observed",
                value=", ".join(map(_spoken, interfaces)) or None,
                expected=f"at least {', '.join(map(_spoken, self.conditions))}",
                remedy="Give each observation the name that its condition has in the model.",
            )
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
