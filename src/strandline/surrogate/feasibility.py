"""The probability that a run at given inputs yields an interface, learnt from the runs that did and those that did not.

A Gaussian process classifier with the logistic likelihood in Laplace's approximation: Rasmussen and Williams (2006),
Algorithms 3.1 and 3.2; the mean of the logistic function by MacKay's formula. Its hyperparameters come from a small
grid, by evidence and a weak prior: random failures widen its error bars but move no border.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial.distance import cdist
from scipy.special import expit, log_expit, logit

Inputs = Float[np.ndarray, "run dim"]
Outcomes = Bool[np.ndarray, " run"]
LENGTHS = (0.5, 1.0, 2.0, 4.0)  # length scales tried, in standard deviations of the inputs
SPREADS = (0.3, 2.0, 6.0)
"""Standard deviations of the latent function tried; the smallest means that failures are random."""
_STEPS = 50
_PRIOR_RUNS = 1.0  # weight of each outcome in the base rate
_LARGEST = 1500  # the last runs, which are learnt from


@dataclass(frozen=True, eq=False)
class Feasibility:
    """The classifier; without failures it returns 1 everywhere. Inputs of its methods are standardised.

    It has the inputs of the runs learnt from, the length scale, the standard deviation of the latent function and its
    mean, the logit of the base rate. At the mode of that function, `slope` is the derivative of the log-likelihood,
    `roots` √W, and `factor` the lower Cholesky factor of I + √W K √W.
    """

    z: Inputs
    length: float = 1.0
    spread: float = 0.0
    offset: float = np.inf
    slope: Float[np.ndarray, " run"] | None = None
    roots: Float[np.ndarray, " run"] | None = None
    factor: Float[np.ndarray, "run run"] | None = None

    def log_probability(self, z: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the log probability that a run at each of the standardised inputs z succeeds."""
        if self.slope is None or self.roots is None or self.factor is None:
            return np.zeros(len(z))
        k = _kernel(z, self.z, self.length, self.spread)
        half = solve_triangular(self.factor, self.roots[:, None] * k.T, lower=True, check_finite=False)
        variance = np.maximum(self.spread**2 - np.einsum("rp,rp->p", half, half), 0.0)
        mean = self.offset + k @ self.slope
        return np.asarray(log_expit(mean / np.sqrt(1 + np.pi * variance / 8)))


def learn_feasibility(z: Inputs, ok: Outcomes, *, largest: int = _LARGEST) -> Feasibility:
    """Return the classifier of highest evidence, learnt from at most the `largest` last runs."""
    z, ok = z[-largest:], ok[-largest:]
    if ok.all():
        return Feasibility(z)
    offset = float(logit((ok.sum() + _PRIOR_RUNS) / (len(ok) + 2 * _PRIOR_RUNS)))
    tried = [_laplace(z, ok, length, spread, offset) for length, spread in product(LENGTHS, SPREADS)]
    return max(tried, key=lambda one: one[0])[1]


def _laplace(z: Inputs, ok: Outcomes, length: float, spread: float, offset: float) -> tuple[float, Feasibility]:
    """Return the log evidence and the classifier at given hyperparameters."""
    K = _kernel(z, z, length, spread)
    sign, f = np.where(ok, 1.0, -1.0), np.zeros(len(z))
    for _ in range(_STEPS):
        p = expit(offset + f)
        roots, slope = np.sqrt(p * (1 - p)), ok - p
        L = cholesky(np.eye(len(z)) + roots[:, None] * K * roots, lower=True, check_finite=False)
        b = roots**2 * f + slope
        inner = solve_triangular(L, roots * (K @ b), lower=True, check_finite=False)
        a = b - roots * solve_triangular(L, inner, lower=True, trans="T", check_finite=False)
        step = K @ a - f
        f = f + step
        if np.abs(step).max() < 1e-8:
            break
    evidence = -0.5 * a @ f + log_expit(sign * (offset + f)).sum() - np.log(np.diagonal(L)).sum()
    return float(evidence), Feasibility(z, length, spread, offset, ok - expit(offset + f), roots, L)


def _kernel(
    a: Inputs, b: Float[np.ndarray, "other dim"], length: float, spread: float
) -> Float[np.ndarray, "run other"]:
    return np.asarray(spread**2 * np.exp(-0.5 * cdist(a, b, "sqeuclidean") / length**2))
