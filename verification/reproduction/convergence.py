"""Error of the surrogate over the number of training runs (Willmann et al. 2022, Remark 9 and Fig. 12)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import logsumexp

from strandline.errors import InvalidInput
from strandline.surrogate import fit_log_likelihood

__all__ = ["STUDY_SIZES", "Convergence", "convergence_study", "relative_error", "relative_error_of_exponentials"]

STUDY_SIZES = (100, 200, 500, 1000, 2000, 5000)


@dataclass(frozen=True, eq=False)
class Convergence:
    """Relative L² errors of the surrogate's mean at test points, by the number of training runs.

    Args:
        sizes: numbers of training runs.
        log_likelihood: ‖m - 𝓛‖ / ‖𝓛‖ of the posterior mean m.
        likelihood: ‖exp m - L‖ / ‖L‖; dominated by the few test points of high likelihood.
    """

    sizes: Int[np.ndarray, " size"]
    log_likelihood: Float[np.ndarray, " size"]
    likelihood: Float[np.ndarray, " size"]


def convergence_study(
    x: Float[np.ndarray, "run dim"],
    log_likelihood: Float[np.ndarray, " run"],
    x_test: Float[np.ndarray, "point dim"],
    log_likelihood_test: Float[np.ndarray, " point"],
    *,
    sizes: Sequence[int] | None = None,
    kernel: str = "matern32",
) -> Convergence:
    """Fit surrogates to more and more of the first runs, and compare each with the truth at the test points.

    Args:
        x: Physical inputs of the successful runs, in the order of the Sobol sequence.
        log_likelihood: Log-likelihoods of these runs.
        x_test: Physical inputs of test runs, none of them in `x`; the study takes 100 from later in the sequence.
        log_likelihood_test: Log-likelihoods of the test runs.
        sizes: Numbers of training runs; by default those of `STUDY_SIZES` for which there are runs.
        kernel: A name in `KERNELS`.

    Raises:
        InvalidInput: more training runs asked for than given, or no test points.
        TooFewRuns: fewer than dim + 2 runs in one of the fits.
        NumericsError: hyperparameters that could not be found.
    """
    chosen = [n for n in STUDY_SIZES if n <= len(x)] if sizes is None else list(sizes)
    _require_sizes(chosen, len(x))
    if len(x_test) == 0:
        raise InvalidInput("test points of the surrogate", value=0, expected="at least one", remedy="Add some.")
    means = [fit_log_likelihood(x[:n], log_likelihood[:n], kernel=kernel).process.mean(x_test) for n in chosen]
    return Convergence(
        sizes=np.array(chosen),
        log_likelihood=np.array([relative_error(mean, log_likelihood_test) for mean in means]),
        likelihood=np.array([relative_error_of_exponentials(mean, log_likelihood_test) for mean in means]),
    )


def relative_error(found: Float[np.ndarray, " point"], truth: Float[np.ndarray, " point"]) -> float:
    """Return ‖found - truth‖ / ‖truth‖."""
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def relative_error_of_exponentials(found: Float[np.ndarray, " point"], truth: Float[np.ndarray, " point"]) -> float:
    """Return ‖exp found - exp truth‖ / ‖exp truth‖, whatever the size of the exponents; inf if it overflows."""
    top = max(found.max(), truth.max())
    difference = float(np.linalg.norm(np.exp(found - top) - np.exp(truth - top)))
    if difference == 0:
        return 0.0
    with np.errstate(over="ignore"):
        return float(np.exp(np.log(difference) - 0.5 * logsumexp(2 * (truth - top))))


def _require_sizes(sizes: Sequence[int], runs: int) -> None:
    if not sizes or max(sizes) > runs:
        raise InvalidInput(
            "numbers of training runs",
            value=list(sizes),
            expected=f"some, none above {runs}, the number of runs given",
            remedy="Give smaller sizes, or more runs.",
        )
