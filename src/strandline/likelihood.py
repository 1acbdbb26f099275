"""From discrepancies to a log-likelihood; several conditions add."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import Discrepancy, independent_terms, unit_of
from strandline.errors import InvalidInput, NumericsError
from strandline.interface import Interface, Observation

__all__ = ["InterfaceLikelihood"]


@dataclass(frozen=True)
class InterfaceLikelihood:
    """log L = Σ over conditions c of -½ d_c²/σ_N,c²; Eq. (4) of the study without its constant.

    Args:
        observations: one for each condition or time, in the order of the simulated interfaces.
        discrepancy: the measure d².

    Raises:
        InvalidInput: no observation.
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

    def __call__(self, interfaces: Interface | Sequence[Interface]) -> float:
        """Return log L, without `constant`, of the simulated interfaces, one a condition in the same order."""
        variances = np.array([o.noise_variance for o in self.observations], float)
        return float(-0.5 * np.sum(self.discrepancies(interfaces) / variances))

    def discrepancies(self, interfaces: Interface | Sequence[Interface]) -> Float[np.ndarray, " condition"]:
        """Return d² of each condition, in `unit`.

        Args:
            interfaces: one a condition, in the order of the observations; a bare interface serves for one.

        Raises:
            InvalidInput: another number of interfaces than of observations.
            NumericsError: the measure returned a number that is negative or not finite.
        """
        pairs = zip(self._in_order(interfaces), self.observations, strict=True)
        return np.array([self._discrepancy(simulated, observation) for simulated, observation in pairs])

    @property
    def unit(self) -> str:
        """Unit of d² and of the noise variances."""
        return unit_of(self.discrepancy)

    @property
    def constant(self) -> float | None:
        """The Gaussian constant -½ Σ n_c log(2πσ_N,c²) that `__call__` leaves out.

        None where d² is not the sum of a number n_c of independent residuals fixed by the observation. σ_N in mm: the
        constant depends on the unit, as any log density of data does.
        """
        counts = [independent_terms(self.discrepancy, o.interface) for o in self.observations]
        if any(count is None for count in counts):
            return None
        logs = [math.log(2 * math.pi * o.noise_variance) for o in self.observations]
        return -0.5 * sum((n or 0) * log for n, log in zip(counts, logs, strict=True))

    def _in_order(self, interfaces: Interface | Sequence[Interface]) -> Sequence[Interface]:
        given = [interfaces] if isinstance(interfaces, Interface) else interfaces
        if len(given) != len(self.observations):
            raise InvalidInput(
                "simulated interfaces of the likelihood",
                value=f"{len(given)}",
                expected=f"{len(self.observations)}, one for each observation",
                remedy="Supply one interface for each condition, in the order of the observations.",
            )
        return given

    def _discrepancy(self, simulated: Interface, observation: Observation) -> float:
        d2 = float(self.discrepancy(simulated, observation.interface))
        if not (math.isfinite(d2) and d2 >= 0):
            raise NumericsError(
                f"discrepancy {self.discrepancy!r} of condition {observation.condition!r} is {d2:g}; "
                "a squared distance is finite and not negative: mend the measure"
            )
        return d2
