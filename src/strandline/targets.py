"""What a surrogate gives to the sampler and to the checks: the log-likelihood in the forms that they need."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.active import Knowledge
from strandline.field_likelihood import OnHost
from strandline.parameters import ParameterSpace
from strandline.smc import BatchedLogDensity
from strandline.surrogate import GaussianProcess, batched_mean

__all__ = ["Target", "of_field", "of_process"]

Values = Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, " point"]]
_STEP = 0.1  # of finite differences, in the given scales


@dataclass(frozen=True, eq=False)
class Target:
    """A log-likelihood.

    Args:
        compiled: for the sampler, with JAX.
        values: the same of NumPy arrays.
        hessian: its second derivatives at one point (dim, dim), given the scales of the inputs there.
        weighted: the log-likelihood that draws are weighted to, where it is another one than that which is sampled.
    """

    compiled: BatchedLogDensity
    values: Values
    hessian: Callable[[Float[np.ndarray, " dim"], Float[np.ndarray, " dim"]], Float[np.ndarray, "dim dim"]]
    weighted: Values | None = None


def of_process(process: GaussianProcess) -> Target:
    """Return the mean of a surrogate of the log-likelihood; its Hessian is exact."""
    return Target(batched_mean(process), process.mean, lambda x, scales: process.hessian(x[None])[0])


def of_field(knowledge: Knowledge, space: ParameterSpace) -> Target:
    """Return log L of the predicted interface, sampled, and log E[L] over possible ones, weighted to.

    The Hessian is by central differences over a tenth of the scales.
    """

    def hessian(x: Float[np.ndarray, " dim"], scales: Float[np.ndarray, " dim"]) -> Float[np.ndarray, "dim dim"]:
        return central_hessian(knowledge.plug_in, x, _STEP * scales, space.low, space.high)

    return Target(OnHost(knowledge.plug_in), knowledge.plug_in, hessian, knowledge.expected)


def central_hessian(
    values: Values,
    x: Float[np.ndarray, " dim"],
    step: Float[np.ndarray, " dim"],
    low: Float[np.ndarray, " dim"],
    high: Float[np.ndarray, " dim"],
) -> Float[np.ndarray, "dim dim"]:
    """Return second derivatives by central differences, around a point that is moved inside where x is at the edge."""
    dim = len(x)
    step = np.minimum(step, (high - low) / 4)
    x = np.clip(x, low + step, high - step)
    signs = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    E = np.diag(step)
    points = [x, *(x + s * E[i] for i in range(dim) for s in (1, -1))]
    pairs = [(i, j) for i in range(dim) for j in range(i)]
    points += [x + a * E[i] + b * E[j] for i, j in pairs for a, b in signs]
    f = values(np.array(points))
    H = np.empty((dim, dim))
    for i in range(dim):
        H[i, i] = (f[1 + 2 * i] - 2 * f[0] + f[2 + 2 * i]) / step[i] ** 2
    for k, (i, j) in enumerate(pairs):
        pp, pm, mp, mm = f[1 + 2 * dim + 4 * k : 5 + 2 * dim + 4 * k]
        H[i, j] = H[j, i] = (pp - pm - mp + mm) / (4 * step[i] * step[j])
    return H
