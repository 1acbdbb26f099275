"""The simulator's own scatter: what its interfaces do that no smooth function of the inputs explains.

Loose tolerances of a solver, or a mesh that changes with the inputs, move the interface a little from run to run. The
nuggets of the modes' processes estimate by how much. The posterior is that of the mean response, which the surrogate
smooths out of all runs; but each run at a draw of it has a log-likelihood that scatters, which limits what a check can
confirm.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.design.active.state import Knowledge
from strandline.likelihood import noise_length
from strandline.numerics.one_thread import one_thread

__all__ = ["NONE", "Scatter", "scatter_of", "typical_variance"]

PLACES, REPEATS = 64, 32
"""Most draws of the posterior, and runs imagined at each, that show what the scatter does to the log-likelihood."""
NEGLIGIBLE = 0.01
"""Share of the shift hidden by the noise below which the scatter changes no log-likelihood worth mentioning."""
SURE = 2.0
"""Standard errors by which a shift must stay within its tolerance."""
MOST = 0.3
"""Share of the variance of the log ratios that the scatter must explain to be the reason why they vary."""
MAD = 1.4826
"""Standard deviation of normal numbers over their median absolute deviation."""
_SEED = 11


@dataclass(frozen=True)
class Scatter:
    """The simulator's own scatter and what it does to the log-likelihood of a run.

    Args:
        rms: Root mean square along the interface, mm.
        hidden: Shift of the interface that the noise hides, mm.
        variance: Variance of the log-likelihood of repeated runs, mean over some draws of the posterior.
    """

    rms: float
    hidden: float
    variance: float

    @property
    def share(self) -> float:
        """Size as a share of the shift that the noise hides."""
        return self.rms / self.hidden

    @property
    def sd(self) -> float:
        """Standard deviation of the log-likelihood of repeated runs."""
        return math.sqrt(self.variance)

    @property
    def words(self) -> str:
        """The size in words."""
        return (
            f"the simulator's own scatter: {1e3 * self.rms:.2g} µm, {self.share:.2g} times the shift that the local "
            "noise hides"
        )

    @property
    def reason(self) -> str:
        """Why a check cannot confirm a posterior, with advice."""
        return (
            f"{self.words}, changes the log-likelihood of a run by {self.sd:.2g}, too much for a check to confirm the "
            "posterior: tighten the solver's tolerance or keep its mesh, average repeated runs, or state the scatter "
            "as part of the noise"
        )

    def prevents(self, *, draws: int, shift: float, effective: float, observed: float | None) -> bool:
        """Return whether a check of a right posterior fails for the scatter alone.

        Args:
            draws: Number of draws.
            shift: Tolerated shift of a mean, in standard deviations.
            effective: Share of draws that must be effective.
            observed: Typical variance of the log ratios of the check; None: none was made.
        """
        if observed is not None and not self.explains(observed):
            return False
        return math.exp(-self.variance) < effective or SURE * math.sqrt(self.variance / max(draws, 1)) > shift

    def explains(self, observed: float) -> bool:
        """Return whether it is the reason why log ratios vary, given their typical variance."""
        return self.variance > 0 and self.variance >= MOST * observed


NONE = Scatter(0.0, 1.0, 0.0)
"""A simulator that does not scatter."""


def scatter_of(knowledge: Knowledge, draws: Float[np.ndarray, "draw dim"]) -> Scatter:
    """Return the scatter that the runs show, and its effect at draws of the posterior.

    Runs are imagined there whose modes scatter independently. The effect is larger in the tails: for a check, give its
    own draws.
    """
    surrogate, likelihood = knowledge.surrogate, knowledge.likelihood
    rms = surrogate.scatter
    hidden = min(noise_length(seen, likelihood.discrepancy) for seen in likelihood.known_observations)
    if rms < NEGLIGIBLE * hidden:
        return Scatter(rms, hidden, 0.0)
    means = surrogate.mean(draws[:: max(len(draws) // PLACES, 1)][:PLACES])
    normal = np.random.default_rng(_SEED).standard_normal((REPEATS, means.shape[1]))
    runs = means[:, None] + normal * np.sqrt(surrogate.scatter_variances)
    with one_thread():
        values = likelihood.at(runs.reshape(-1, means.shape[1])).reshape(len(means), REPEATS)
    return Scatter(rms, hidden, float(np.mean(np.var(values, axis=1, ddof=1))))


def typical_variance(log_ratios: Float[np.ndarray, " draw"]) -> float:
    """Return the variance of normal numbers with the same median absolute deviation; a few extremes change little."""
    finite = log_ratios[np.isfinite(log_ratios)]
    return float((MAD * np.median(np.abs(finite - np.median(finite)))) ** 2) if len(finite) else 0.0
