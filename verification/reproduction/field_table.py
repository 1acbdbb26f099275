"""The interface of a loaded solid as a Chebyshev table over load, Poisson's ratio and inflow rate.

At a fixed Poisson's ratio the deformation depends mainly on V/E, and on V through the Reynolds number: at 100 mm²/s the
same V/E bends three times as much as in creeping flow. Soft states end at a fold, near which the displacement varies as
the square root of the distance to it. So the coordinates of the table are s = √(1 - load), in which the displacement is
smooth up to the fold, ν and V; the load is V/E relative to its value at the fold. At s = 1 there is no load and no run
is needed.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import BarycentricInterpolator

from strandline.foundations import NumericsError
from strandline.interface import Interface
from strandline.models.protocol import ForwardModel
from strandline.runs import Executor, Ledger, run_campaign

BIOFILM_FOLD = (
    (-0.8, 44.6), (-0.6, 84.1), (-0.45, 110.2), (-0.3, 134.6), (-0.15, 165.7), (0.0, 196.8),
    (0.1, 216.8), (0.2, 235.2), (0.3, 250.9), (0.4, 260.7), (0.48, 265.7), (0.5, 264.0),
)  # fmt: skip
"""(ν, E in Pa) of the fold of the built-in biofilm at V_in = 100 mm²/s on its default mesh."""


@dataclass(frozen=True)
class LoadCoordinates:
    """The map between (E, ν, V) and a box in which all interfaces exist and are smooth.

    Args:
        fold: (ν, E) pairs of the fold at the inflow rate `fold_rate`; a cubic of E/(1+ν) is fitted to them.
        fold_rate: V at which the fold was found, mm²/s.
        inertia: (a, b) in mm²/s: at another V, E of the fold is assumed to be ∝ V √(b² + (a + V)²). For the built-in
            biofilm this E is 2 % below to 26 % above the folds found for E from 60 to 240 Pa, and hardly below those
            of the softest solids in creeping flow. None: E ∝ V.
        reach: Load of the softest states of the table, as a share of the load at the fold.
        nu: Interval of Poisson's ratio.
        rate: Interval of V, mm²/s; its lower end is above 0, since at V = 0 the load would need E = 0. The table is
            extrapolated from there to 0.
    """

    fold: tuple[tuple[float, float], ...] = BIOFILM_FOLD
    fold_rate: float = 100.0
    inertia: tuple[float, float] | None = (17.0, 67.0)
    reach: float = 0.88
    nu: tuple[float, float] = (-0.8, 0.5)
    rate: tuple[float, float] = (1.0, 110.0)
    names: ClassVar[tuple[str, ...]] = ("E", "nu", "V_in")

    def fold_load(
        self, nu: Float[np.ndarray, "*point"], rate: float | Float[np.ndarray, "*point"]
    ) -> Float[np.ndarray, "*point"]:
        """Return V/E at the fold, mm²/(s Pa), from the fit."""
        at, young = np.array(self.fold).T
        stiffness = np.polynomial.Polynomial.fit(at, young / (1 + at), 3)
        at_fold_rate = self.fold_rate / ((1 + nu) * stiffness(nu))
        if self.inertia is None:
            return np.asarray(at_fold_rate)
        a, b = self.inertia
        return np.asarray(at_fold_rate * np.hypot(b, a + self.fold_rate) / np.hypot(b, a + rate))

    def load(self, x: Float[np.ndarray, "*point 3"]) -> Float[np.ndarray, "*point"]:
        """Return the load at (E, ν, V) as a share of the load at the fold."""
        return np.asarray(x[..., 2] / x[..., 0] / self.fold_load(x[..., 1], x[..., 2]))

    def inside(self, x: Float[np.ndarray, "*point 3"]) -> Bool[np.ndarray, "*point"]:
        """Return which (E, ν, V) the table covers."""
        slack = 1e-9
        covered = (self.nu[0] - slack <= x[..., 1]) & (x[..., 1] <= self.nu[1] + slack)
        covered &= (x[..., 2] >= 0) & (x[..., 2] <= self.rate[1] * (1 + slack)) & (x[..., 0] > 0)
        return np.asarray(covered & (self.load(x) <= self.reach * (1 + slack)))

    def to_box(self, x: Float[np.ndarray, "*point 3"]) -> Float[np.ndarray, "*point 3"]:
        """Map (E, ν, V) to [-1, 1]³; the first coordinate is -1 without load and 1 at `reach`."""
        columns = (np.sqrt(1 - np.minimum(self.load(x), 1.0)), x[..., 1], x[..., 2])
        return np.stack([2 * (c - a) / (b - a) - 1 for c, (a, b) in zip(columns, self._ends, strict=True)], axis=-1)

    def from_box(self, z: Float[np.ndarray, "*point 3"]) -> Float[np.ndarray, "*point 3"]:
        """Invert `to_box`; without load E is infinite."""
        s, nu, rate = (a + 0.5 * (z[..., k] + 1) * (b - a) for k, (a, b) in enumerate(self._ends))
        with np.errstate(divide="ignore"):
            young = rate / ((1 - s**2) * self.fold_load(nu, rate))
        return np.stack([young, nu, rate], axis=-1)

    def softest(self, nu: Float[np.ndarray, "*point"], rate: float) -> Float[np.ndarray, "*point"]:
        """Return the E at which the table ends, Pa."""
        return np.asarray(rate / (self.reach * self.fold_load(nu, rate)))

    @property
    def _ends(self) -> tuple[tuple[float, float], ...]:
        """The values of s, ν and V at both ends of the box."""
        return (1.0, float(np.sqrt(1 - self.reach))), self.nu, self.rate


@dataclass(frozen=True, eq=False)
class FieldTable:
    """Displacements of the interface's points, mm, at Chebyshev nodes of the box, interpolated by polynomials.

    `reference` is the interface without load. With a single node in a coordinate, the table is constant in it.
    """

    coordinates: LoadCoordinates
    reference: Float[np.ndarray, "point 2"]
    axes: tuple[Float[np.ndarray, " s"], Float[np.ndarray, " nu"], Float[np.ndarray, " rate"]]
    values: Float[np.ndarray, "s nu rate coordinate"]
    runs: int = 0

    def at(self, x: Float[np.ndarray, "run 3"]) -> Float[np.ndarray, "run point 2"]:
        """Return the interfaces at (E, ν, V), mm."""
        z = self.coordinates.to_box(x)
        flat = self.values.reshape(-1, self.values.shape[-1])
        rows = []
        for block in np.array_split(z, max(1, len(z) // 2048)):
            a, b, c = (lagrange(axis, block[:, k]) for k, axis in enumerate(self.axes))
            rows.append(np.einsum("pi,pj,pk->pijk", a, b, c, optimize=True).reshape(len(block), -1) @ flat)
        return np.asarray(self.reference + np.concatenate(rows).reshape(len(x), -1, 2))

    def on_grid(
        self, s: Float[np.ndarray, " s"], nu: Float[np.ndarray, " nu"], rate: Float[np.ndarray, " rate"]
    ) -> Float[np.ndarray, "s nu rate point 2"]:
        """Return the interfaces on a tensor grid of box coordinates."""
        a, b, c = (lagrange(axis, z) for axis, z in zip(self.axes, (s, nu, rate), strict=True))
        field_ = np.einsum("ai,bj,ck,ijkx->abcx", a, b, c, self.values, optimize=True)
        return np.asarray(self.reference + field_.reshape(len(s), len(nu), len(rate), -1, 2))

    def halved(self) -> "FieldTable":
        """Return the nested table with half the intervals in every coordinate."""
        a, b, c = (axis[::2] for axis in self.axes)
        return FieldTable(self.coordinates, self.reference, (a, b, c), self.values[::2, ::2, ::2])


def lagrange(nodes: Float[np.ndarray, " node"], z: Float[np.ndarray, " point"]) -> Float[np.ndarray, "point node"]:
    """Return the Lagrange basis of `nodes` at `z`."""
    if len(nodes) == 1:
        return np.ones((len(z), 1))
    return np.asarray(BarycentricInterpolator(nodes, np.eye(len(nodes)))(z))


def lobatto(intervals: int) -> Float[np.ndarray, " node"]:
    """Return the Chebyshev–Lobatto nodes from -1 to 1; only the upper end for 0 intervals."""
    if intervals == 0:
        return np.ones(1)
    return np.asarray(-np.cos(np.pi * np.arange(intervals + 1) / intervals))


def tabulate(
    model: ForwardModel,
    reference: Interface,
    *,
    intervals: tuple[int, int, int],
    ledger: Ledger,
    executor: Executor,
    coordinates: LoadCoordinates | None = None,
) -> FieldTable:
    """Make the forward runs of a table, in E, nu and V_in; those in the ledger are not repeated.

    Even numbers of intervals in s, ν and V have a nested table with half as many. 0 in V fixes V at its upper end.
    """
    box = coordinates or LoadCoordinates()
    a, b, c = (lobatto(n) for n in intervals)
    loaded = np.stack(np.meshgrid(a[1:], b, c, indexing="ij"), axis=-1)
    moved = run_at(model, box.from_box(loaded.reshape(-1, 3)), ledger, executor) - reference.points
    values = np.zeros((len(a), len(b), len(c), reference.points.size))
    values[1:] = moved.reshape(len(a) - 1, len(b), len(c), -1)
    return FieldTable(box, reference.points, (a, b, c), values, len(moved))


def withheld(
    table: FieldTable, model: ForwardModel, x: Float[np.ndarray, "run 3"], *, ledger: Ledger, executor: Executor
) -> Float[np.ndarray, " run"]:
    """Run the model at (E, ν, V) inside the table; return the largest distance of a point from its place there, mm."""
    distance = np.linalg.norm(run_at(model, x, ledger, executor) - table.at(x), axis=-1)
    return np.asarray(distance.max(axis=-1))


def run_at(
    model: ForwardModel, x: Float[np.ndarray, "run 3"], ledger: Ledger, executor: Executor
) -> Float[np.ndarray, "run point 2"]:
    """Return the interfaces of forward runs at (E, ν, V); a run that fails is a hole in the table, and an error."""
    inputs = [dict(zip(LoadCoordinates.names, row.tolist(), strict=True)) for row in np.asarray(x, float)]
    records = run_campaign(model, inputs, ledger=ledger, executor=executor)
    failed = [dict(record.inputs) for record in records if not record.ok]
    if failed:
        raise NumericsError(
            f"{len(failed)} of {len(records)} runs in the table failed, e.g. {failed[0]}; lower its reach"
        )
    return np.array([record.interface.points for record in records if record.interface is not None])
