"""A surrogate of the simulator's result: the interface as a field over the inputs.

Interfaces → fields over common points → modes (POD) → one Gaussian process per mode. It works for every measure,
noise and observation, and is far smoother in the inputs than a log-likelihood.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.foundations import TooFewRuns, one_thread, unfit
from strandline.interface import Interface
from strandline.surrogate.field.correspondence import PointLayout, by_condition, common_layout, fields_of
from strandline.surrogate.field.mode_process import ModeProcess
from strandline.surrogate.field.warping import Data, Modes, Warping, choose_warping, fewest_runs, fit_modes

TOLERANCE = 1e-5  # default of the remainder that the modes may leave, root mean square along the interface, mm


@dataclass(frozen=True, eq=False)
class FieldTraining:
    """Successful runs: physical inputs, and the interfaces of each run by condition.

    `gradients` are derivatives d(points)/d(inputs) of each run by condition (point, xyz, dim), mm per unit of the
    input; None: there are none. `low` and `high` are corners of the box of the inputs.
    """

    x: Float[np.ndarray, "run dim"]
    interfaces: Sequence[Mapping[str, Interface]]
    gradients: Sequence[Mapping[str, Float[np.ndarray, "_ xyz dim"]]] | None
    low: Float[np.ndarray, " dim"]
    high: Float[np.ndarray, " dim"]


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
    processes: tuple[ModeProcess, ...]
    registration_error: float
    gradients: bool

    @property
    def ways(self) -> tuple[str, ...]:
        """How the interfaces of the conditions share their points, as `PointLayout` names it."""
        return tuple(sorted({layout.way for layout in self.layouts.values()}))

    @property
    def templates(self) -> dict[str, Interface]:
        """An interface of each condition with the points that are predicted, for its cells."""
        return {name: layout.template for name, layout in self.layouts.items()}

    @property
    def runs(self) -> int:
        return len(self.processes[0].observed.z)

    def mean(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point mode"]:
        """Return the predicted coefficients, mm."""
        z = self.warping.standardise(x)
        return np.stack([process.mean(z) for process in self.processes], axis=1)

    def predict(self, x: Float[np.ndarray, "point dim"]) -> FieldPrediction:
        z = self.warping.standardise(x)
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
    if len(training.x) < needed:
        found, expected = f"{len(training.x)} successful run(s)", f"at least {needed} for {dim} input(s)"
        remedy = "Add runs to the design, or look at why runs failed."
        raise TooFewRuns("training of the surrogate", value=found, expected=expected, remedy=remedy)
    x = (training.x - training.low) / (training.high - training.low)
    layouts = {name: common_layout([run[name] for run in training.interfaces], x) for name in training.interfaces[0]}
    fields, error = fields_of(training.interfaces, layouts)
    if not np.ptp(fields, axis=0).any():
        expected, remedy = "interfaces that the inputs change", "Look at the model: does it read its inputs?"
        raise unfit("interfaces of the runs", f"the same one in all {len(fields)} runs", expected, remedy)
    gradients = _gradients(training, layouts) if all(one.by_nodes for one in layouts.values()) else None
    weights = np.concatenate([np.repeat(layout.weights, layout.template.dim) for layout in layouts.values()])
    data = Data(training.x, fields, weights, gradients)
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
    dim = training.x.shape[1]
    return np.array(
        [
            np.concatenate([slopes[name][one.order(run[name])].reshape(-1, dim) for name, one in layouts.items()])
            for run, slopes in zip(training.interfaces, training.gradients, strict=True)
        ]
    )
