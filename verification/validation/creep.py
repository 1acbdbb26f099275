"""A solid that relaxes and creeps: closed forms of generalised Maxwell solids, and orders in time.

- Relaxation: a block is stretched suddenly, held, stretched further at a constant rate of Green's strain, and held.
- Oscillation: a block is sheared to and fro by 50 %. The neo-Hookean shear stress is linear in the shear at any size,
  so each branch adds the storage and loss moduli of small strains, g μ ω²τ²/(1 + ω²τ²) and g μ ωτ/(1 + ω²τ²).
- Creep: an inflow so slow that everything is linear is switched on, lowered and switched off. With one branch the
  interface moves as u(t) = u∞ (1 - g/(1+g) exp(-t/τ(1+g))) after each change (Findley, Lai and Onaran, Creep and
  Relaxation of Nonlinear Viscoelastic Materials, 1976, section 5.4).
- Order: the study's flow cell with constant steps, against steps of half the size.

Run it with:  python -m verification.validation.creep [--publish]
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import ngsolve as ng
import numpy as np
from verification.validation.analytic import YOUNG, LoadedSolid, square
from verification.validation.biofilm_mesh import flow_cell
from verification.validation.tables import DOCS, Table, arguments, show, table

from strandline.models.biofilm.cells.cell import Setting
from strandline.models.biofilm.cells.creeping_cell import CreepingCell, QuasiStatic
from strandline.models.biofilm.equations.flow import WATER
from strandline.models.biofilm.equations.memory import Branch
from strandline.models.biofilm.mesh.course import Course
from strandline.models.biofilm.mesh.geometry import MESHES

PAGE = DOCS / "results" / "forward-model.md"
BRANCHES = (Branch(0.7, 0.5), Branch(1.5, 4.0))
SHEAR, RATE = 0.5, 2.0
"""Amplitude of the shear, and its angular frequency, 1/s."""
SLOW = 0.01
"""Inflow, mm²/s, at which everything is linear."""
LAG = 1.0
"""Time, s, at which the creep test is looked at first."""


def block_stresses(
    law: str, poisson: float, times: Sequence[float], gradient: Callable[[float], np.ndarray], branches: Sequence
) -> np.ndarray:
    """Return the first Piola–Kirchhoff stresses (time, 2, 2) of a block whose boundary follows F(t), scaled.

    Steps end at `times`, s; the first begins at rest at 0 s. A step of length 0 is a sudden change.
    """
    block = LoadedSolid(square(0.4), law, poisson, "bottom|right|top|left", remembers=True)
    memory, now = block.coupled.memory, 0.0
    assert memory is not None
    past = memory.at_rest(len(branches))
    tests = [[_coefficients(block, i, j) for j in range(2)] for i in range(2)]
    found = []
    for time in times:
        memory.begin(past, branches, time - now)
        F = gradient(time) - np.eye(2)
        moved = ng.CF(tuple(F[i, 0] * ng.x + F[i, 1] * ng.y for i in range(2)))
        block.prescribe(moved, "bottom|right|top|left")
        block.solve()
        found.append([[float(test @ block.coupled.full_residual()) for test in row] for row in tests])
        past, now = memory.after(past, branches, time - now, block.coupled.elastic_stress), time
    return np.array(found)


def _coefficients(block: LoadedSolid, i: int, j: int) -> np.ndarray:
    """Return the coefficients of the test displacement e_i x_j: its power in the unit square is P_ij."""
    test = ng.GridFunction(block.coupled.space)
    place = (ng.x, ng.y)[j]
    test.components[2].Set(ng.CF((place, 0) if i == 0 else (0, place)))
    return np.array(test.vec.FV().NumPy())


def relaxation_error(poisson: float = 0.3) -> float:
    """Return the largest error of the stress of a stretched block, as a share of the largest stress."""
    sudden, end, hold = 0.1, 0.3, 3.0

    def strain(time: float) -> float:
        return sudden if time <= 1.0 else min(end, sudden + 0.1 * (time - 1.0))

    times = [0.0, 0.5, 1.0, 1.7, hold, 4.0, 10.0]
    F = [np.diag([np.sqrt(1 + 2 * strain(time)), 1.0]) for time in times]
    P = block_stresses("saint_venant_kirchhoff", poisson, times, lambda t: F[times.index(t)], BRANCHES)[:, 0, 0]
    modulus = YOUNG * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    exact = []
    for time, gradient in zip(times, F, strict=True):
        S = strain(time)
        for branch in BRANCHES:
            g, tau = branch.ratio, branch.time
            ramp = min(max(time - 1.0, 0.0), hold - 1.0)
            since = max(time - hold, 0.0)
            S += g * sudden * np.exp(-time / tau)
            S += g * 0.1 * tau * (1 - np.exp(-ramp / tau)) * np.exp(-since / tau)
        exact.append(gradient[0, 0] * modulus * S)
    return float(np.abs(P - exact).max() / np.abs(exact).max())


def oscillation_errors(steps: Sequence[int], poisson: float = 0.4) -> list[float]:
    """Return the largest errors of the shear stress over two periods, as a share of its largest, by steps a period."""
    shear = 0.5 * YOUNG / (1 + poisson)
    errors = []
    for number in steps:
        times = np.arange(1, 2 * number + 1) * (2 * np.pi / RATE / number)
        sheared = lambda time: np.array([[1.0, SHEAR * np.sin(RATE * time)], [0.0, 1.0]])  # noqa: E731
        P = block_stresses("neo_hookean", poisson, times.tolist(), sheared, BRANCHES)[:, 0, 1]
        exact = np.sin(RATE * times)
        for branch in BRANCHES:
            wt = RATE * branch.time
            decay = np.exp(-times / branch.time)
            exact = exact + branch.ratio * wt / (1 + wt**2) * (wt * np.sin(RATE * times) + np.cos(RATE * times) - decay)
        exact = shear * SHEAR * exact
        errors.append(float(np.abs(P - exact).max() / np.abs(exact).max()))
    return errors


def creep_error(tolerance: float = 1e-4, law: str = "neo_hookean") -> tuple[float, int]:
    """Return the largest error of the creeping interface, as a share of its largest displacement, and the steps."""
    branch, cell = Branch(1.5, 3.0), flow_cell(MESHES["coarse"], law=law, kind=CreepingCell)
    relaxed = cell.solve(Setting([400.0], [0.3], SLOW)).displacement
    size = np.linalg.norm(relaxed, axis=1).max()
    times = (0.0, LAG, 3.0, 6.0, 6.0 + LAG, 9.0, 12.0, 12.0 + LAG, 16.0, 24.0)
    inflow = ((0.0, 0.0), (0.0, 1.0), (6.0, 1.0), (6.0, 0.4), (12.0, 0.4), (12.0, 0.0), (24.0, 0.0))
    way = QuasiStatic(cell, SLOW, WATER, [branch], tolerance)
    found = list(way.follow(Course(inflow, tuple((f"{time:g}", time) for time in times))))
    changes = ((0.0, 1.0), (6.0, -0.6), (12.0, -0.4))
    worst = 0.0
    for moment in found:
        share = sum(change * _crept(moment.time - begin, branch) for begin, change in changes if begin <= moment.time)
        worst = max(worst, float(np.linalg.norm(moment.displacement - share * relaxed, axis=1).max() / size))
    return worst, way.steps


def _crept(time: float, branch: Branch) -> float:
    """Return the displacement after a sudden load, as a share of the final one."""
    return 1.0 - branch.ratio / (1.0 + branch.ratio) * float(np.exp(-time / (branch.time * (1.0 + branch.ratio))))


def flow_errors(steps: Sequence[float]) -> list[float]:
    """Return how far the study's interface differs from that with half the step, µm, while it creeps.

    Steps are constant, s, each half of the one before; the last serves only for the comparison.
    """
    cell, found = flow_cell(MESHES["coarse"], law="neo_hookean", kind=CreepingCell), []
    times = tuple((f"{time:g}", time) for time in (1.0, 2.0, 4.0, 6.0))
    course = Course(((0.0, 0.0), (1.0, 1.0), (4.0, 0.3), (6.0, 0.3)), times)
    cell.set(Setting([400.0], [0.3], 100.0))
    for step in steps:
        way = QuasiStatic(cell, 100.0, WATER, [Branch(1.5, 3.0)], np.inf, largest_step=step)
        found.append(np.array([moment.displacement for moment in way.follow(course)]))
    differences = [np.linalg.norm(a - b, axis=2).max() for a, b in pairwise(found)]
    return [1e3 * float(difference) for difference in differences]


def tables() -> list[Table]:
    """Return the tables of closed forms and of orders in time."""
    forms = [
        ("relaxation of a block stretched in steps and ramps, Saint-Venant–Kirchhoff", "7 steps", relaxation_error()),
        ("the same, incompressible within 1e-4", "7 steps", relaxation_error(0.4999)),
        ("shear to and fro by 50 %, neo-Hookean", "512 a period", oscillation_errors([512])[0]),
    ]
    for tolerance in (1e-2, 1e-3, 1e-4):
        error, number = creep_error(tolerance)
        what = f"creep of the biofilm in a slow flow, on, lowered, off; tolerance {tolerance:g}"
        forms.append((what, f"{number} chosen", error))
    numbers, steps = (16, 32, 64, 128), (0.5, 0.25, 0.125, 0.0625, 0.03125)
    shear, flow = oscillation_errors(numbers), flow_errors(steps)
    orders = [[None, *(float(np.log2(a / b)) for a, b in pairwise(errors))] for errors in (shear, flow)]
    rows = zip(numbers, shear, orders[0], steps[:-1], flow, orders[1], strict=True)
    heading = (
        "steps a period {d} | error of the shear stress {.1e} | order {.2f} | step, s {g} "
        "| biofilm, against half of it, µm {.1e} | order {.2f}"
    )
    return [
        table("creep_forms", "Closed forms", "what | steps | largest error, relative {.1e}", forms),
        table("creep_orders", "Orders in time", heading, rows),
    ]


if __name__ == "__main__":
    show(tables(), page=PAGE if arguments(__doc__, publish=False).publish else None)
