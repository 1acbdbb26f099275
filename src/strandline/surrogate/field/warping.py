"""Inputs transformed to act more linearly: a stiffness acts on a displacement by its logarithm or its reciprocal."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["WARPS", "Warp", "Warping", "eligible"]

SMALLEST_RATIO = 2.0
"""An input whose box spans a smaller ratio is left as it is: all warps are nearly linear there."""


@dataclass(frozen=True)
class Warp:
    """A monotone map of one input, and its derivative."""

    apply: Callable[[Float[np.ndarray, " run"]], Float[np.ndarray, " run"]]
    slope: Callable[[Float[np.ndarray, " run"]], Float[np.ndarray, " run"]]


WARPS = {
    "identity": Warp(lambda x: x, np.ones_like),
    "log": Warp(np.log, lambda x: 1.0 / x),
    "reciprocal": Warp(lambda x: 1.0 / x, lambda x: -1.0 / x**2),
}


@dataclass(frozen=True, eq=False)
class Warping:
    """Physical inputs → standardised ones: warped, centred and scaled by their standard deviation over the box.

    Args:
        names: a warp of `WARPS` for each input.
        low: lower corner of the box of the inputs.
        high: upper corner of the box of the inputs.
    """

    names: tuple[str, ...]
    low: Float[np.ndarray, " dim"]
    high: Float[np.ndarray, " dim"]

    def standardise(self, x: Float[np.ndarray, "run dim"]) -> Float[np.ndarray, "run dim"]:
        """Return the standardised inputs."""
        middle, spread = self._scale()
        columns = [WARPS[name].apply(x[:, j]) for j, name in enumerate(self.names)]
        return np.asarray((np.stack(columns, axis=1) - middle) / spread)

    def gradients(
        self, x: Float[np.ndarray, "run dim"], by_input: Float[np.ndarray, "run *value dim"]
    ) -> Float[np.ndarray, "run *value dim"]:
        """Return derivatives with respect to the standardised inputs, given those by the physical ones."""
        _, spread = self._scale()
        slopes = np.stack([WARPS[name].slope(x[:, j]) for j, name in enumerate(self.names)], axis=1) / spread
        shape = (len(x), *(1,) * (by_input.ndim - 2), len(self.names))
        return np.asarray(by_input / slopes.reshape(shape))

    def _scale(self) -> tuple[Float[np.ndarray, " dim"], Float[np.ndarray, " dim"]]:
        """Return middle and standard deviation of a uniform distribution over the warped box."""
        ends = np.array(
            [
                [float(WARPS[name].apply(np.array([end]))[0]) for end in (a, b)]
                for name, a, b in zip(self.names, self.low, self.high, strict=True)
            ]
        )
        return ends.mean(axis=1), np.abs(ends[:, 1] - ends[:, 0]) / np.sqrt(12.0)


def eligible(low: Float[np.ndarray, " dim"], high: Float[np.ndarray, " dim"]) -> Sequence[int]:
    """Return the inputs for which warps other than the identity can be tried: positive, with a wide enough ratio."""
    return [j for j in range(len(low)) if low[j] > 0 and high[j] >= SMALLEST_RATIO * low[j]]
