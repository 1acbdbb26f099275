"""Modes of displaced interfaces (POD), and which inputs enter their processes by their logarithm or reciprocal.

A stiffness acts on a displacement by its logarithm or its reciprocal. Inputs that are positive over a wide box may
enter so, first all in the same way, then one by one: the warp with the smallest leave-one-run-out error of the leading
modes is taken.
"""

import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np
from jaxtyping import Float

from strandline.surrogate.field.mode_process import ModeData, ModeProcess, fit_mode

Fields = Float[np.ndarray, "run value"]
Slopes = Float[np.ndarray, "run value dim"]
AnySlopes = Float[np.ndarray, "run *value dim"]
Weights = Float[np.ndarray, " value"]
MOST = 20  # largest number of modes with their own process
STEP = 0.5  # derivatives enter the decomposition as a step of this many standard deviations of an input
_NOTHING = 1e-14
SMALLEST_RATIO = 2.0  # an input whose box spans a smaller ratio is left as it is: all warps are nearly linear there
LEADING = 3  # modes whose errors choose the warps
ROWS, GROWTH = 160, 1.25
"""Observations that choose the warps, at most; factor by which their runs grow from one choice to the next."""
KEPT = 8  # choices that are remembered
_kept: OrderedDict[Hashable, tuple[str, ...]] = OrderedDict()  # the last choices, by all that they depend on


@dataclass(frozen=True, eq=False)
class Modes:
    """An orthonormal basis of the fields seen; the squared norm of a field is its mean square along the interface.

    `roots` are square roots of the weights of the values, whose squares sum to the number of conditions. `basis` has
    orthonormal weighted fields of the modes, `tail` those of the modes cut off, times their standard deviations over
    the runs, mm.
    """

    mean: Weights
    roots: Weights
    basis: Float[np.ndarray, "mode value"]
    tail: Float[np.ndarray, "rest value"]

    @property
    def remainder(self) -> float:
        """Root mean square of the modes cut off, along the interface, mm."""
        return float(np.sqrt(np.sum(self.tail**2)))

    def coefficients(self, fields: Fields) -> Float[np.ndarray, "run mode"]:
        return np.asarray(((fields - self.mean) * self.roots) @ self.basis.T)

    def by_input(self, derivatives: Slopes) -> Float[np.ndarray, "run mode dim"]:
        """Return derivatives of the coefficients, given those of the fields."""
        return np.asarray(np.einsum("rvd,mv->rmd", derivatives * self.roots[:, None], self.basis, optimize=True))

    def fields(self, coefficients: Float[np.ndarray, "run mode"]) -> Fields:
        return np.asarray(self.mean + (coefficients @ self.basis) / self.roots)


def decompose(
    fields: Fields, weights: Weights, derivatives: Slopes | None, *, tolerance: float, most: int = MOST
) -> Modes:
    """Return the fewest modes that leave a root mean square of the fields below `tolerance`, mm.

    The modes span the directions of the derivatives with respect to the standardised inputs, too.
    """
    mean, roots = fields.mean(axis=0), np.sqrt(weights)
    centred = (fields - mean) * roots
    rows = [centred]
    if derivatives is not None:
        steps = np.moveaxis(STEP * derivatives * roots[:, None], 2, 1)
        rows.append(steps.reshape(-1, fields.shape[1]))
    _, sizes, basis = np.linalg.svd(np.concatenate(rows), full_matrices=False)
    basis = basis[sizes > _NOTHING * max(float(sizes[0]), _NOTHING)]
    shares = np.mean((centred @ basis.T) ** 2, axis=0)
    left = shares.sum() - np.cumsum(shares)
    enough = np.flatnonzero(left <= tolerance**2)
    number = min(int(enough[0]) + 1 if enough.size else len(basis), most)
    tail = basis[number:] * np.sqrt(shares[number:])[:, None]
    return Modes(mean, roots, basis[:number], tail)


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

    There is a warp of `WARPS` for each input; `low` and `high` are corners of the box.
    """

    names: tuple[str, ...]
    low: Float[np.ndarray, " dim"]
    high: Float[np.ndarray, " dim"]

    def standardise(self, x: Float[np.ndarray, "run dim"]) -> Float[np.ndarray, "run dim"]:
        middle, spread = self._scale()
        columns = [WARPS[name].apply(x[:, j]) for j, name in enumerate(self.names)]
        return np.asarray((np.stack(columns, axis=1) - middle) / spread)

    def gradients(self, x: Float[np.ndarray, "run dim"], by_input: AnySlopes) -> AnySlopes:
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


def fewest_runs(dim: int, *, gradients: bool) -> int:
    """Return the smallest number of runs from which a field can be learnt."""
    return 3 if gradients else dim + 3


@dataclass(frozen=True, eq=False)
class Data:
    """What the modes are fitted to: values of the field, mm, their weights in the mean square, and derivatives with
    respect to the physical inputs, mm per unit of the input; None if there are none.
    """

    x: Float[np.ndarray, "run dim"]
    fields: Fields
    weights: Weights
    gradients: Slopes | None

    def first(self, number: int) -> "Data":
        gradients = None if self.gradients is None else self.gradients[:number]
        return Data(self.x[:number], self.fields[:number], self.weights, gradients)

    def fingerprint(self) -> str:
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
    observed = [ModeData(z, values[:, m], None if slopes is None else slopes[:, m], linear) for m in range(number)]
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
