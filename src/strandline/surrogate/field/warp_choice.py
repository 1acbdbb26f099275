"""Which inputs of the surrogate enter by their logarithm or reciprocal: those whose runs are then predicted better.

Inputs that are positive over a wide box may, first all in the same way, then one by one: the warp with the smallest
leave-one-run-out error of the leading modes is taken.
"""

import math
from collections import OrderedDict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np
from jaxtyping import Float

from strandline.surrogate.field.mode_process import ModeProcess, fit_mode
from strandline.surrogate.field.modes import Modes, decompose
from strandline.surrogate.field.restricted_evidence import Observed
from strandline.surrogate.field.warping import WARPS, Warping, eligible

__all__ = ["Data", "choose_warping", "fewest_runs", "fit_modes"]

LEADING = 3
"""Modes whose errors choose the warps."""
ROWS, GROWTH = 160, 1.25
"""Observations that choose the warps, at most; factor by which their runs grow from one choice to the next."""
KEPT = 8
"""Choices that are remembered."""
_kept: OrderedDict[Hashable, tuple[str, ...]] = OrderedDict()  # the last choices, by all that they depend on


def fewest_runs(dim: int, *, gradients: bool) -> int:
    """Return the smallest number of runs from which a field can be learnt."""
    return 3 if gradients else dim + 3


@dataclass(frozen=True, eq=False)
class Data:
    """What the modes are fitted to.

    Args:
        x: Physical inputs, shape (run, dim).
        fields: Values of the field (run, value), mm.
        weights: Weights of the values in the mean square, shape (value,).
        gradients: Derivatives of the fields with respect to the physical inputs (run, value, dim), mm per unit of the
            input; None if there are none.
    """

    x: Float[np.ndarray, "run dim"]
    fields: Float[np.ndarray, "run value"]
    weights: Float[np.ndarray, " value"]
    gradients: Float[np.ndarray, "run value dim"] | None

    def first(self, number: int) -> "Data":
        """Return the first runs alone."""
        gradients = None if self.gradients is None else self.gradients[:number]
        return Data(self.x[:number], self.fields[:number], self.weights, gradients)

    def fingerprint(self) -> str:
        """Return a hash of all numbers."""
        some = [self.x, self.fields, self.weights, *([] if self.gradients is None else [self.gradients])]
        return sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in some)).hexdigest()


def fit_modes(
    data: Data, warping: Warping, tolerance: float, most: int | None = None
) -> tuple[Modes, tuple[ModeProcess, ...]]:
    """Return the modes and their processes; `most` limits their number, for comparisons."""
    z = warping.standardise(data.x)
    derivatives = None if data.gradients is None else warping.gradients(data.x, data.gradients)
    modes = decompose(data.fields, data.weights, derivatives, tolerance=tolerance)
    values = modes.coefficients(data.fields)
    slopes = None if derivatives is None else modes.by_input(derivatives)
    linear = slopes is not None or len(z) >= 2 * (z.shape[1] + 1)
    number = values.shape[1] if most is None else min(most, values.shape[1])
    observed = [Observed(z, values[:, m], None if slopes is None else slopes[:, m], linear) for m in range(number)]
    return modes, tuple(fit_mode(one, quick=most is not None) for one in observed)


def choose_warping(data: Data, warping: Warping, tolerance: float) -> Warping:
    """Return the warping with the best warp for each input, the others held fixed; ties change nothing.

    Some of the first runs decide. Their number grows in steps, so that a design that grows run by run need not choose
    again each time.
    """
    some = eligible(warping.low, warping.high)
    if not some:
        return warping
    few = data.first(_choosing_runs(data))
    key = (few.fingerprint(), warping.low.tobytes(), warping.high.tobytes(), tolerance)
    if key not in _kept:
        while len(_kept) >= KEPT:
            _kept.popitem(last=False)
        _kept[key] = _chosen(few, warping, some, tolerance).names
    return replace(warping, names=_kept[key])


def _choosing_runs(data: Data) -> int:
    """Return the number of runs that choose the warps: the largest of a geometric sequence that there are."""
    rows = 1 if data.gradients is None else 1 + data.x.shape[1]
    number = fewest_runs(data.x.shape[1], gradients=rows > 1)
    most = min(len(data.x), max(ROWS // rows, number))
    while (more := math.ceil(GROWTH * number)) <= most:
        number = more
    return number


def _chosen(few: Data, warping: Warping, some: Sequence[int], tolerance: float) -> Warping:
    together = [replace(warping, names=_changed(warping.names, some, name)) for name in WARPS]
    errors = [_error(few, tried, tolerance) for tried in together]
    best, warping = min(errors), together[int(np.argmin(errors))]
    for j in some if len(some) > 1 else ():
        for name in WARPS:
            tried = replace(warping, names=_changed(warping.names, [j], name))
            error = best if tried.names == warping.names else _error(few, tried, tolerance)
            if error < best:
                best, warping = error, tried
    return warping


def _changed(names: tuple[str, ...], inputs: Sequence[int], name: str) -> tuple[str, ...]:
    return tuple(name if j in inputs else old for j, old in enumerate(names))


def _error(data: Data, warping: Warping, tolerance: float) -> float:
    """Return the sum of squares of the leading modes' errors at left-out runs, mm²; extremes are clipped."""
    _, processes = fit_modes(data, warping, tolerance, most=LEADING)
    errors = np.sum([process.left_out().errors ** 2 for process in processes], axis=0)
    return float(np.sum(np.minimum(errors, 25 * np.median(errors))))
