"""Anchors: steady states at fixed points of a box of inputs, kept on disk, and what they tell of a run between them.

Cubic radial basis functions with a linear part interpolate all unknowns, so no reduced basis is needed: with a proper
orthogonal decomposition that keeps every mode the result is the same. The anchors depend on the geometry, the options
and the box alone, never on the runs of a study, so a run's result depends on its inputs alone.

A run in the box starts from the state that the anchors predict. Broyden's updates of the nearest anchor's factorised
Jacobian usually lead to the steady state; if they do not contract, Newton's method goes on from the prediction; if that
fails too, the run is solved as without anchors. So is each run outside the box, and each whose first-order compression
is predicted above `LARGEST_STRAIN`: there Newton's method alone cannot tell which branch a state is on, see `steady`.

The Jacobian of an anchor is rescaled to the stiffness of a run. Let the run's solid be s times as stiff as the
anchor's. Multiply by s the Jacobian's rows of momentum in fluid and solid, and divide by s its columns of v, p and pₛ.
In the solid and its constraint the result is the run's Jacobian: the stress there is proportional to Young's modulus.
In the fluid the derivatives by v and p are unchanged, and only those by the moving geometry, which are weaker, are s
times too large. So an anchor serves runs of very different stiffness.
"""

import contextlib
import hashlib
import os
import platform
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import RBFInterpolator

from strandline.foundations import ForwardModelError, unfit, whole_file
from strandline.models.biofilm import newton
from strandline.models.biofilm.cells.cell import FlowCell, Setting, Solution
from strandline.models.biofilm.cells.steady import DIRECT_STRAIN, SAFE_STRAIN, AtLoad, first_order
from strandline.models.biofilm.equations.flow import DROP, RATE
from strandline.models.biofilm.equations.system import CoupledSystem
from strandline.models.biofilm.linear import Factorisation, linear_solver
from strandline.models.biofilm.mesh.outline import finite
from strandline.models.biofilm.newton import NewtonSettings, Vector
from strandline.models.protocol import ModelInput

Ranges = tuple[tuple[str, float, float], ...]
"""Lowest and highest value of each input, by name."""

POINTS_PER_INPUT = 12
"""Points of Sobol's sequence for each input that varies."""
MOST_CORNERS = 8
"""Up to this number, the corners of the box are points too."""
OPTION = "anchors of the biofilm model"
DRIVES = (RATE.name, DROP.name)
EXAMPLE = "e.g. {E: [100, 800], nu: [0.1, 0.45], V_in: 100}"
FIELDS = ("coordinates", "strains", "solved", "unknowns")
REVISION = 1
"""Raised whenever other anchors are found for a cell and a box."""
PACKAGES = ("ngsolve", "numpy", "scipy", "mkl")
LARGEST_STRAIN = 0.95 * SAFE_STRAIN
MOST_FACTORS = 8
"""Anchors whose Jacobian is kept factorised; spread over the box."""
KEPT = NewtonSettings(1e-8, maximum_jacobians=0, smallest_damping=1.0, contraction=0.7)
"""Steps with a kept Jacobian; the error after the last is shorter than it by the contraction, about a fifth."""
FRESH = NewtonSettings(maximum_jacobians=2, smallest_damping=1.0)


@dataclass(frozen=True)
class Axis:
    """One input that varies in the box."""

    name: str
    low: float
    high: float

    @property
    def is_logarithmic(self) -> bool:
        """Whether the coordinate is the logarithm of the input."""
        return self.low > 0 and self.high > 2 * self.low

    def coordinate(self, value: float) -> float:
        """Return the coordinate, from 0 to 1 in the range."""
        if self.is_logarithmic:
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)

    def value(self, coordinate: float) -> float:
        """Return the input at a coordinate; the bounds are exact."""
        if coordinate in (0.0, 1.0):
            return self.high if coordinate else self.low
        if self.is_logarithmic:
            return float(self.low * (self.high / self.low) ** coordinate)
        return self.low + coordinate * (self.high - self.low)

    @property
    def length(self) -> float:
        """Length of the range, as `Box.distances` measures it.

        Jacobians are rescaled to the shear modulus of a run, see `Rescaled`: what Young's modulus changes is
        mostly made good, what Poisson's ratio changes is not. So the latter counts as it is, an e-fold of another input
        0.3, and the whole range of one whose ends have a ratio below 2 likewise 0.6.
        """
        if self.name.rstrip("0123456789") == "nu":
            return self.high - self.low
        return 0.3 * float(np.log(self.high / self.low)) if self.is_logarithmic else 0.6


@dataclass(frozen=True)
class Box:
    """Ranges of inputs; those whose ends are equal have one value and no coordinate."""

    ranges: Ranges

    @property
    def axes(self) -> tuple[Axis, ...]:
        return tuple(Axis(*entry) for entry in self.ranges if entry[1] < entry[2])

    def holds(self, inputs: Mapping[str, float]) -> bool:
        """Return whether inputs lie in the box, its bounds included."""
        return all(low <= inputs[name] <= high for name, low, high in self.ranges)

    def coordinates(self, inputs: Mapping[str, float]) -> Float[np.ndarray, " axis"]:
        """Return coordinates of inputs, from 0 to 1 in the box."""
        return np.array([axis.coordinate(inputs[axis.name]) for axis in self.axes])

    def inputs(self, coordinates: Sequence[float]) -> dict[str, float]:
        at = {axis.name: axis.value(c) for axis, c in zip(self.axes, coordinates, strict=True)}
        return {name: at.get(name, low) for name, low, _ in self.ranges}

    def points(self) -> Iterator[tuple[float, ...]]:
        """Yield coordinates of the points to solve: corners if they are few, then Sobol's without its first."""
        from scipy.stats import qmc  # slow to import, and needed only where anchors are not on disk

        count = len(self.axes)
        if 2**count <= MOST_CORNERS:
            yield from product((0.0, 1.0), repeat=count)
        sequence = qmc.Sobol(count, scramble=False)
        sequence.fast_forward(1)
        for row in sequence.random(POINTS_PER_INPUT * count):
            yield tuple(float(c) for c in row)

    def distances(
        self, coordinates: Float[np.ndarray, "point axis"], at: Float[np.ndarray, " axis"]
    ) -> Float[np.ndarray, " point"]:
        """Return how far the factorised Jacobians of points are from that at a point."""
        lengths = np.array([axis.length for axis in self.axes])
        return np.asarray(np.linalg.norm((coordinates - at) * lengths, axis=1))


def as_ranges(given: Any) -> Ranges:
    """Return a mapping of inputs to numbers or pairs [lowest, highest] as ranges."""
    if not isinstance(given, Mapping) or not given:
        raise unfit(OPTION, given, f"lowest and highest value of each input of the model, {EXAMPLE}")
    ranges = {}
    for name, entry in given.items():
        ends = finite(entry if isinstance(entry, list | tuple) else [entry, entry])
        if ends.shape != (2,):
            raise unfit(f"{name} in the {OPTION}", entry, "a number, or lowest and highest value as [100, 800]")
        ranges[str(name)] = ends.tolist()
    return tuple((name, low, high) for name, (low, high) in ranges.items())


def check_ranges(ranges: Ranges, inputs: Sequence[ModelInput], *, steady: bool) -> None:
    """Refuse ranges of other inputs than the model's, or outside what these admit, and anchors of runs through time.

    Without inflow nothing bends, and logarithms of strains have no value: a range of the inflow lies above 0.
    """
    if not ranges:
        return
    if not steady:
        expected = "no course: a run through time does not start from anchors"
        raise unfit(OPTION, "anchors with a course", expected, "Remove one of the two.")
    known = {item.name: item for item in inputs}
    for name in sorted(known.keys() ^ {name for name, _, _ in ranges}):
        found, remedy = (f"no {name}", "Add it.") if name in known else (f"{name}, which is no input", "Remove it.")
        expected = f"lowest and highest value of {', '.join(known)}; one number where an input is the same in all runs"
        raise unfit(OPTION, found, expected, remedy)
    for name, low, high in ranges:
        item = replace(known[name], low_included=known[name].low_included and name not in DRIVES)
        if not (low <= high and item.admits(low) and item.admits(high)):
            expected = f"the lowest value, then the highest, both in {item.range_text()}"
            raise unfit(f"{name} in the {OPTION}", low if low == high else [low, high], expected)
    if all(low == high for _, low, high in ranges):
        raise unfit(OPTION, "no range", f"at least one input that varies, {EXAMPLE}", "Give one a range.")


@dataclass(frozen=True, eq=False)
class States:
    """What was found at the points of a box.

    `strains` are the largest compressive strains of the first-order states, which were found at the `coordinates`;
    `unknowns` are the steady states, scaled, of those points that are `solved`.
    """

    coordinates: Float[np.ndarray, "point axis"]
    strains: Float[np.ndarray, " point"]
    solved: Bool[np.ndarray, " point"]
    unknowns: Float[np.ndarray, "solved unknown"]

    @property
    def anchors(self) -> Float[np.ndarray, "solved axis"]:
        """Coordinates of the steady states."""
        return np.asarray(self.coordinates[self.solved])

    @property
    def suffice(self) -> bool:
        """Whether there are enough steady states to interpolate."""
        axes = self.coordinates.shape[1]
        enough = len(self.anchors) > axes + 1
        return bool(enough and np.linalg.matrix_rank(self.anchors - self.anchors.mean(0)) == axes)

    def strain(self, at: Float[np.ndarray, " axis"]) -> float:
        """Return the predicted strain of the first-order state."""
        return float(np.exp(self._strain(at[None])[0]))

    def guess(self, at: Float[np.ndarray, " axis"]) -> Vector:
        """Return the predicted steady state, scaled."""
        return np.asarray(self._state(at[None])[0])

    @cached_property
    def _strain(self) -> RBFInterpolator:
        return RBFInterpolator(self.coordinates, np.log(self.strains), kernel="cubic", degree=1)

    @cached_property
    def _state(self) -> RBFInterpolator:
        return RBFInterpolator(self.anchors, self.unknowns, kernel="cubic", degree=1)


def anchors_file(geometry: str, box: Box) -> Path:
    """Return the file in the user's cache for a cell and a box; its name depends on all that determines their bits."""
    parts = [str(REVISION), geometry, repr(box), linear_solver(), platform.machine(), *map(_installed, PACKAGES)]
    folder = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "strandline" / "anchors"
    return folder / f"{hashlib.sha256('|'.join(parts).encode()).hexdigest()[:32]}.npz"


def save_anchors(states: States, path: Path) -> None:
    """Write a file, or none where the disk refuses it; another process never sees half of it."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial, partial.open("wb") as file:
            np.savez(file, **{field: getattr(states, field) for field in FIELDS})


def load_anchors(path: Path) -> States | None:
    """Return the states of a file; None if there is none, or a damaged one: each array has a checksum."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            return States(**{field: content[field] for field in FIELDS})
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error):
        return None


def _installed(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return ""


class Rescaled:
    """The factorised Jacobian of an anchor, for runs whose solid is `ratio` times as stiff."""

    def __init__(self, factorised: Factorisation, system: CoupledSystem, ratio: float) -> None:
        self._factorised = factorised
        displacement, is_motion = system.block(2), system.is_motion[system.free]
        constraint = ~(system.block(0) | system.block(1) | displacement)
        self._rows, self._columns = ratio ** -(1.0 - (is_motion | constraint)), ratio ** -(displacement - 1.0)

    def solve(self, right: Vector) -> Vector:
        return np.asarray(self._columns * self._factorised.solve(self._rows * right))


class AnchoredCell:
    """A flow cell with the anchors of a box of its inputs; `setting` gives what a run is made with, by its inputs."""

    def __init__(
        self, cell: FlowCell, box: Box, setting: Callable[[Mapping[str, float]], Setting], states: States | None = None
    ) -> None:
        self.cell, self.box, self._setting = cell, box, setting
        self.states = states or self._solved()
        self._factors: dict[int, Factorisation] = {}
        self._kept = _spread(box, self.states.anchors)

    @classmethod
    def kept(
        cls, cell: FlowCell, box: Box, setting: Callable[[Mapping[str, float]], Setting], geometry: str
    ) -> "AnchoredCell":
        """Return the cell with the anchors on disk, or with new ones, which are written there."""
        path = anchors_file(geometry, box)
        states = load_anchors(path)
        made = cls(cell, box, setting, states)
        if states is None:
            save_anchors(made.states, path)
        return made

    def solve(self, inputs: Mapping[str, float], budget: int) -> Solution:
        """Return the steady state, which depends on `inputs` alone, as `FlowCell.solve`; that is called if anchors do
        not serve."""
        figures, strain = {"anchored": 0.0}, self._predicted_strain(inputs)
        if np.isfinite(strain):
            figures["predicted_strain"] = strain
        found = self._from_anchors(inputs) if strain <= LARGEST_STRAIN else None
        if found is not None:
            return replace(found, figures=figures | {"anchored": 1.0})
        return replace(self.cell.solve(self._setting(inputs), budget), figures=figures)

    def serves(self, inputs: Mapping[str, float]) -> bool:
        return self._predicted_strain(inputs) <= LARGEST_STRAIN

    def _solved(self) -> States:
        """Return the states at the points of the box; where it bends too far, or the run fails, there is no anchor."""
        points, strains, solved, unknowns = [], [], [], []
        for point in self.box.points():
            with contextlib.suppress(ForwardModelError):
                inputs = self.box.inputs(point)
                strain = self._first_order_strain(inputs)
                points.append(point)
                strains.append(max(strain, np.finfo(float).tiny))
                solved.append(False)
                if strain <= DIRECT_STRAIN:
                    unknowns.append(self.cell.solve(self._setting(inputs)).unknowns)
                    solved[-1] = True
        coordinates = np.array(points).reshape(len(points), len(self.box.axes))
        steady = np.array(unknowns) if unknowns else np.empty((0, 0))
        return States(coordinates, np.array(strains), np.array(solved, dtype=bool), steady)

    def _first_order_strain(self, inputs: Mapping[str, float]) -> float:
        load = self.cell.set(self._setting(inputs))
        start, first = first_order(self.cell, load)
        return self.cell.largest_compression(np.asarray(start + first.correction))

    def _predicted_strain(self, inputs: Mapping[str, float]) -> float:
        """Return the first-order compression that the anchors predict; infinity if they do not serve these inputs."""
        if not (self.states.suffice and self.box.holds(inputs)):
            return np.inf
        return self.states.strain(self.box.coordinates(inputs))

    def _from_anchors(self, inputs: Mapping[str, float]) -> Solution | None:
        """Return the steady state near the prediction; None if Newton's method does not find it."""
        at = self.box.coordinates(inputs)
        nearest = self._kept[int(np.argmin(self.box.distances(self.states.anchors[self._kept], at)))]
        setting, cell = self._setting(inputs), self.cell
        jacobian = self._factor(nearest)
        anchor = self._setting(self.box.inputs(tuple(self.states.anchors[nearest])))
        load, guess = cell.set(setting), self.states.guess(at)
        system, weights = AtLoad(cell, load), cell.weights
        rescaled = Rescaled(jacobian, cell.system, setting.stiffness / anchor.stiffness)
        for settings in (KEPT, FRESH):
            with contextlib.suppress(ForwardModelError):
                first = newton.step(system, guess, rescaled) if settings is KEPT else None
                found = newton.solve(system, guess, weights=weights, settings=settings, first=first)
                return cell.accepted(found.x, load, found.jacobians)
        return None

    def _factor(self, number: int) -> Factorisation:
        """Return the factorised Jacobian of an anchor, made when it is first needed."""
        if number not in self._factors:
            load = self.cell.set(self._setting(self.box.inputs(tuple(self.states.anchors[number]))))
            self._factors[number] = self.cell.factorise(self.states.unknowns[number], load, own_analysis=True)
        return self._factors[number]


def _spread(box: Box, anchors: Float[np.ndarray, "anchor axis"]) -> list[int]:
    """Return the numbers of anchors that lie far from each other, from the middle of all outwards."""
    if not len(anchors):
        return []
    chosen = [int(np.argmin(box.distances(anchors, anchors.mean(0))))]
    while len(chosen) < min(MOST_FACTORS, len(anchors)):
        gaps = np.min([box.distances(anchors, anchors[k]) for k in chosen], axis=0)
        chosen.append(int(np.argmax(gaps)))
    return chosen
