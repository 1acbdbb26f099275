"""Exact sensitivities of the interface against central differences with Richardson extrapolation, and their cost."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from verification.validation.biofilm_mesh import flow_cell
from verification.validation.tables import Table, table

from strandline.models.biofilm.cell import FlowCell, Setting
from strandline.models.biofilm.geometry import MESHES, Partition

Points = Float[np.ndarray, "node 2"]
STEPS = (2e-3, 1e-3, 5e-4)
"""Relative steps of E and V_in; the steps of ν are absolute, and smaller near ½."""


@dataclass(frozen=True)
class Inputs:
    """Young's moduli (Pa), Poisson's ratios, inflow (mm²/s)."""

    young: tuple[float, ...]
    poisson: tuple[float, ...]
    rate: float

    def label(self) -> str:
        return "; ".join((", ".join(f"{x:g}" for x in self.young), ", ".join(f"{x:g}" for x in self.poisson)))

    def names(self) -> list[str]:
        """Return the names of the inputs, in the order of `FlowCell.sensitivities`."""
        numbers = [str(k) for k in range(1, len(self.young) + 1)] if len(self.young) > 1 else [""]
        return [f"{kind}{n}" for kind in ("E", "ν") for n in numbers] + ["V_in"]

    def flat(self) -> list[float]:
        return [*self.young, *self.poisson, self.rate]

    def setting(self) -> Setting:
        return Setting(self.young, self.poisson, self.rate)


POINTS = (
    Inputs((400.0,), (0.3,), 100.0),
    Inputs((600.0,), (0.499,), 100.0),
    Inputs((300.0,), (-0.5,), 80.0),
    Inputs((2000.0,), (0.0,), 150.0),
    Inputs((300.0, 500.0, 800.0), (0.2, 0.35, -0.3), 100.0),
)


def relative_differences(cell: FlowCell, at: Inputs) -> list[float]:
    """Return max |exact - difference| / max |exact| over the interface, for each input."""
    exact, flat, parts, found = cell.sensitivities(cell.solve(at.setting())), at.flat(), len(at.young), []
    for k, derivative in enumerate(exact):
        scale = flat[k] if not parts <= k < 2 * parts else min(1.0, 200 * (0.5 - flat[k]))

        def moved(value: float, k: int = k) -> Points:
            x = [*flat[:k], value, *flat[k + 1 :]]
            return cell.solve(Setting(x[:parts], x[parts : 2 * parts], x[-1])).displacement

        difference = extrapolated(moved, flat[k], [scale * h for h in STEPS])
        found.append(float(np.abs(derivative - difference).max() / np.abs(derivative).max()))
    return found


def extrapolated(function: Callable[[float], Points], at: float, steps: Sequence[float]) -> Points:
    """Return the derivative to sixth order from central differences with three steps, each half of the one before."""
    d = [(function(at + h) - function(at - h)) / (2 * h) for h in steps]
    once = [(4 * d[i + 1] - d[i]) / 3 for i in range(2)]
    return (16 * once[1] - once[0]) / 15


def cost(cell: FlowCell, at: Inputs, *, repeats: int = 5) -> float:
    """Return the median time of all sensitivities as a share of the median time of a solve."""
    solves, derivatives = [], []
    for _ in range(repeats):
        start = time.perf_counter()
        solution = cell.solve(at.setting())
        middle = time.perf_counter()
        cell.sensitivities(solution)
        solves.append(middle - start)
        derivatives.append(time.perf_counter() - middle)
    return float(np.median(derivatives) / np.median(solves))


def tables(points: Sequence[Inputs] = POINTS, *, mesh: str = "default") -> list[Table]:
    """Return the table of differences between exact sensitivities and extrapolated ones."""
    rows = []
    cells = {n: flow_cell(MESHES[mesh], partition=partition_of(n)) for n in {len(at.young) for at in points}}
    for at in points:
        cell = cells[len(at.young)]
        share = cost(cell, at)
        for name, difference in zip(at.names(), relative_differences(cell, at), strict=True):
            rows.append((at.label(), at.rate, name, difference, 100 * share if name == "V_in" else None))
    heading = "E, Pa; ν | V_in, mm²/s {g} | derivative by | relative difference {.1e} | cost of all, % of a solve {.0f}"
    return [table("sensitivities", "Exact sensitivities against central differences", heading, rows)]


def partition_of(parts: int) -> Partition:
    """Return the partition of the specimen into this number of parts."""
    return Partition.PRESETS["three_parts"] if parts == 3 else Partition()
