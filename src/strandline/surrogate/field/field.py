"""A surrogate of the simulator's result: the interface as a field over the inputs.

Interfaces → fields over common points → modes (POD) → one Gaussian process per mode. It works for every measure,
noise and observation, and is far smoother in the inputs than a log-likelihood.

A stiffness acts on a displacement by its logarithm or its reciprocal. Inputs that are positive over a wide box may
enter so, first all in the same way, then one by one: the warp with the smallest leave-one-run-out error of the leading
modes is taken.
"""

import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import cast

import numpy as np
from jaxtyping import Float

from strandline.foundations import one_thread, require
from strandline.interface import Interface
from strandline.surrogate.field.correspondence import PointLayout, by_condition, common_layout, fields_of
from strandline.surrogate.field.mode_process import ModeData, ModeProcess, fit_mode
from strandline.surrogate.field.shared_process import SharedProcess, fit_shared, mean_with_slopes
from strandline.surrogate.hyperparameters import require_enough

Fields = Float[np.ndarray, "run value"]
Slopes = Float[np.ndarray, "run value dim"]
AnySlopes = Float[np.ndarray, "run *value dim"]
Weights = Float[np.ndarray, " value"]
MOST_SHARED = 40  # largest number of modes that share a kernel
MOST = 20  # largest number of modes with their own process
STEP = 0.5  # derivatives enter the decomposition as a step of this many standard deviations of an input
_NOTHING = 1e-14
MANY_INPUTS = 6  # number of inputs from which all modes share a kernel, if there are derivatives
SMALLEST_RATIO = 2.0  # an input whose box spans a smaller ratio is left as it is: all warps are nearly linear there
LEADING = 3  # modes whose errors choose the warps
ROWS, GROWTH = 160, 1.25
"""Observations that choose the warps, at most; factor by which their runs grow from one choice to the next."""
KEPT = 8  # choices that are remembered
_kept: OrderedDict[Hashable, tuple[str, ...]] = OrderedDict()  # the last choices, by all that they depend on
TOLERANCE = 1e-5  # default of the remainder that the modes may leave, root mean square along the interface, mm


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

    apply: Callable[[Float[np.ndarray, "..."]], Float[np.ndarray, "..."]]
    slope: Callable[[Float[np.ndarray, "..."]], Float[np.ndarray, "..."]]


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
        middle, spread = self._scale
        z = np.empty(x.shape)
        for name, columns in self._alike:
            z[:, columns] = WARPS[name].apply(x[:, columns])
        return np.asarray((z - middle) / spread)

    def gradients(self, x: Float[np.ndarray, "run dim"], by_input: AnySlopes) -> AnySlopes:
        """Return derivatives with respect to the standardised inputs, given those by the physical ones."""
        slopes = np.empty(x.shape)
        for name, columns in self._alike:
            slopes[:, columns] = WARPS[name].slope(x[:, columns])
        shape = (len(x), *(1,) * (by_input.ndim - 2), len(self.names))
        return np.asarray(by_input / (slopes / self._scale[1]).reshape(shape))

    def by_physical(self, x: Float[np.ndarray, "run dim"], by_standardised: Float[np.ndarray, "run dim"]) -> AnySlopes:
        """Return derivatives by the physical inputs, given those by the standardised ones."""
        return np.asarray(by_standardised / self.gradients(x, np.ones_like(by_standardised)))

    @cached_property
    def _alike(self) -> list[tuple[str, list[int]]]:
        """The names of the different warps, and the inputs that have each."""
        return [(one, [j for j, n in enumerate(self.names) if n == one]) for one in dict.fromkeys(self.names)]

    @cached_property
    def _scale(self) -> tuple[Float[np.ndarray, " dim"], Float[np.ndarray, " dim"]]:
        """Return middle and standard deviation of a uniform distribution over the warped box."""
        box = zip(self.names, self.low, self.high, strict=True)
        ends = np.array([[float(WARPS[name].apply(np.array([end]))[0]) for end in (a, b)] for name, a, b in box])
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
    shared: bool = False

    def first(self, number: int) -> "Data":
        gradients = None if self.gradients is None else self.gradients[:number]
        return Data(self.x[:number], self.fields[:number], self.weights, gradients, self.shared)

    def fingerprint(self) -> str:
        some = [self.x, self.fields, self.weights, *([] if self.gradients is None else [self.gradients])]
        return sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in some)).hexdigest()


Processes = tuple[ModeProcess, ...] | tuple[SharedProcess, ...]


def fit_modes(data: Data, warping: Warping, tolerance: float, most: int | None = None) -> tuple[Modes, Processes]:
    """Return the modes and their processes; `most` limits their number, for comparisons."""
    z = warping.standardise(data.x)
    derivatives = None if data.gradients is None else warping.gradients(data.x, data.gradients)
    many = (derivatives is not None or data.shared) and z.shape[1] >= MANY_INPUTS
    least, limit = (tolerance / 8, MOST_SHARED) if many else (tolerance, MOST)
    modes = decompose(data.fields, data.weights, derivatives, tolerance=least, most=limit)
    values = modes.coefficients(data.fields)
    slopes = None if derivatives is None else modes.by_input(derivatives)
    linear = slopes is not None or len(z) >= 2 * (z.shape[1] + 1)
    number = values.shape[1] if most is None else min(most, values.shape[1])
    observed = [ModeData(z, values[:, m], None if slopes is None else slopes[:, m], linear) for m in range(number)]
    if many:
        return modes, fit_shared(observed)
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


@dataclass(frozen=True, eq=False)
class FieldTraining:
    """Successful runs: physical inputs, and the interfaces of each run by condition.

    `gradients` are derivatives d(points)/d(inputs) of each run by condition (point, xyz, dim), mm per unit of the
    input; None: there are none. `low` and `high` are corners of the box of the inputs. Modes of six inputs and more
    share a kernel if there are derivatives, or if they are to be `shared`.
    """

    x: Float[np.ndarray, "run dim"]
    interfaces: Sequence[Mapping[str, Interface]]
    gradients: Sequence[Mapping[str, Float[np.ndarray, "_ xyz dim"]]] | None
    low: Float[np.ndarray, " dim"]
    high: Float[np.ndarray, " dim"]
    shared: bool = False


@dataclass(frozen=True, eq=False)
class FieldPrediction:
    """Means and variances of the modes' coefficients at some points (point, mode); mm and mm²."""

    mean: Float[np.ndarray, "point mode"]
    variance: Float[np.ndarray, "point mode"]


@dataclass(frozen=True, eq=False)
class FieldSurrogate:
    """The interface of every condition as a function of the inputs.

    `registration_error` is the largest root mean square error of fitting a run's interface to the layout, mm;
    `gradients` tells whether it was trained with sensitivities too.
    """

    layouts: Mapping[str, PointLayout]
    warping: Warping
    modes: Modes
    processes: Processes
    registration_error: float
    gradients: bool

    @property
    def shares_kernel(self) -> bool:
        """Whether all modes share a kernel, as those of many inputs do."""
        return isinstance(self.processes[0], SharedProcess)

    @property
    def ways(self) -> tuple[str, ...]:
        """How the interfaces of the conditions share their points, as `PointLayout` names it."""
        return tuple(sorted({layout.way for layout in self.layouts.values()}))

    @property
    def templates(self) -> dict[str, Interface]:
        """An interface of each condition with the points that are predicted, for its cells."""
        return {name: layout.template for name, layout in self.layouts.items()}

    @property
    def _shared(self) -> tuple[SharedProcess, ...]:
        return cast(tuple[SharedProcess, ...], self.processes)

    @property
    def runs(self) -> int:
        return len(self.processes[0].observed.z)

    def mean(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point mode"]:
        """Return the predicted coefficients, mm."""
        z = self.warping.standardise(x)
        if self.shares_kernel:
            return mean_with_slopes(self._shared, z)[0]
        return np.stack([process.mean(z) for process in self.processes], axis=1)

    def mean_with_slopes(
        self, x: Float[np.ndarray, "point dim"]
    ) -> tuple[
        Float[np.ndarray, "point mode"], Callable[[Float[np.ndarray, "point mode"]], Float[np.ndarray, "point dim"]]
    ]:
        """Return the predicted coefficients, and a function of factors of them → the derivative of the sum by x."""
        mean, by_standardised = mean_with_slopes(self._shared, self.warping.standardise(x))
        return mean, lambda factors: self.warping.by_physical(x, by_standardised(factors))

    def predict(self, x: Float[np.ndarray, "point dim"]) -> FieldPrediction:
        z = self.warping.standardise(x)
        if isinstance(first := self.processes[0], SharedProcess):
            scales = [process.scale for process in self.processes]
            return FieldPrediction(self.mean(x), np.outer(first.kernel.unexplained(z), scales))
        return FieldPrediction(self.mean(x), np.stack([process.variance(z) for process in self.processes], axis=1))

    def points(
        self, coefficients: Float[np.ndarray, "draw mode"], tail: Float[np.ndarray, "draw rest"] | None = None
    ) -> dict[str, Float[np.ndarray, "draw point xyz"]]:
        """Return the points of the interfaces by condition, mm, given coefficients of the modes, mm.

        `tail` are standard normal numbers that multiply the remainder that the modes leave; None leaves it out.
        """
        fields = self.modes.fields(coefficients)
        if tail is not None:
            fields = fields + (tail @ self.modes.tail) / self.modes.roots
        return self.by_condition(fields)

    def by_condition(self, fields: Float[np.ndarray, "draw value"]) -> dict[str, Float[np.ndarray, "draw point xyz"]]:
        return by_condition(fields, self.layouts)

    def interfaces(self, x: Float[np.ndarray, " dim"]) -> dict[str, Interface]:
        points = self.points(self.mean(x[None]))
        return {name: layout.with_points(points[name][0]) for name, layout in self.layouts.items()}

    def left_out_fields(self) -> Float[np.ndarray, "run value"]:
        """Return the errors of all values of the field at each run, predicted from the others, mm."""
        errors = np.stack([process.left_out().errors for process in self.processes], axis=1)
        return np.asarray((errors @ self.modes.basis) / self.modes.roots)

    def left_out_error(self) -> Float[np.ndarray, " run"]:
        """Return the root mean square of these errors along the interface, with the remainder of the modes, mm."""
        errors = np.stack([process.left_out().errors for process in self.processes], axis=1)
        return np.asarray(np.sqrt(np.sum(errors**2, axis=1) / len(self.layouts) + self.modes.remainder**2))

    @property
    def scatter_variances(self) -> Float[np.ndarray, " mode"]:
        """Variances of the coefficients about any smooth function of the inputs, by the nuggets, mm²."""
        return np.array([process.nugget * process.scale for process in self.processes])

    @property
    def scatter(self) -> float:
        """The simulator's own scatter, root mean square along the interface, mm."""
        return float(np.sqrt(self.scatter_variances.sum() / len(self.layouts)))

    def predicted_error(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the standard deviation of the field, root mean square along the interface, at points; mm."""
        variance = self.predict(x).variance.sum(axis=1) / len(self.layouts)
        return np.asarray(np.sqrt(variance + self.modes.remainder**2))


def fit_field(training: FieldTraining, *, tolerance: float = TOLERANCE) -> FieldSurrogate:
    """Return the surrogate of the field from these runs; the result depends on nothing else.

    Inputs that are positive over a wide box may enter by their logarithm or reciprocal, whichever predicts the runs
    better. The modes may leave a root mean square along the interface of at most `tolerance`, mm.

    Raises:
        TooFewRuns: fewer than `fewest_runs`.
        NoCommonPoints: interfaces that cannot be brought to common points.
        InvalidInput: interfaces that are all the same.
        NumericsError: no length scales could be found.
    """
    dim = training.x.shape[1]
    needed = fewest_runs(dim, gradients=training.gradients is not None)
    require_enough(len(training.x), needed, dim)
    x = (training.x - training.low) / (training.high - training.low)
    layouts = {name: common_layout([run[name] for run in training.interfaces], x) for name in training.interfaces[0]}
    fields, error = fields_of(training.interfaces, layouts)
    words = "interfaces that the inputs change", "Look at the model: does it read its inputs?"
    found = f"the same one in all {len(fields)} runs"
    require(np.ptp(fields, axis=0).any(), "interfaces of the runs", found, *words)
    gradients = _gradients(training, layouts) if all(one.by_nodes for one in layouts.values()) else None
    weights = np.concatenate([np.repeat(layout.weights, layout.template.dim) for layout in layouts.values()])
    data = Data(training.x, fields, weights, gradients, training.shared)
    with one_thread():
        warping = choose_warping(data, Warping(("identity",) * dim, training.low, training.high), tolerance)
        modes, processes = fit_modes(data, warping, tolerance)
    return FieldSurrogate(layouts, warping, modes, processes, error, gradients is not None)


def _gradients(
    training: FieldTraining, layouts: Mapping[str, PointLayout]
) -> Float[np.ndarray, "run value dim"] | None:
    """Return the derivatives of the fields with respect to the physical inputs."""
    if training.gradients is None:
        return None
    dim, pairs = training.x.shape[1], zip(training.interfaces, training.gradients, strict=True)
    parts = [[slopes[name][one.order(run[name])] for name, one in layouts.items()] for run, slopes in pairs]
    return np.array([np.concatenate([part.reshape(-1, dim) for part in row]) for row in parts])
