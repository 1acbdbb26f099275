"""The biofilm's interface on the coarse, default and fine mesh against a reference mesh, in the study's (E, ν) box.

Inputs at the limits of what the model admits are tried too, with all laws, by `python -m verification.validation`.

Run it with:  python -m verification.validation.biofilm_mesh
"""

import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.validation.energies import FURTHER
from verification.validation.tables import Table, show, table

from strandline.design import sobol
from strandline.foundations import ForwardModelError
from strandline.models.biofilm.cells.cell import FlowCell, Setting
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.mesh.geometry import MESHES, MeshSize, Partition
from strandline.models.biofilm.mesh.outline import Channel, Outline

CASES = (
    (400.0, 0.5, 100.0),
    (400.0, 0.4999999, 100.0),
    (400.0, -0.9, 100.0),
    (400.0, -0.99, 100.0),
    (400.0, 0.3, 0.0),
    (1e7, 0.3, 100.0),
    (1e7, 0.5, 100.0),
)
"""E in Pa, ν, V_in in mm²/s."""
REFERENCE = MeshSize(far=0.035, interface=0.0075, foot=0.0033, grading=0.22)
BOX = ((100.0, 800.0), (-0.8, 0.5))
RATE = 100.0
POINTS = 24
Points = Float[np.ndarray, "node 2"]


def extremes(*, mesh: str = "default", laws: Iterable[str] = tuple(LAWS)) -> list[Table]:
    """Return the table of outcomes at the limits of the model: ν = ½, ν near -1, no flow, a very stiff solid."""
    rows = []
    for law in laws:
        cell = flow_cell(MESHES[mesh], law=law)
        for young, poisson, rate in CASES:
            try:
                found = cell.solve(Setting([young], [poisson], rate, tuple([x] for x in FURTHER[law]))).diagnostics()
                figures = (1e3 * found["max_displacement"], found["min_J_fluid"], found["min_J_solid"])
                rows.append((law, young, poisson, rate, "solved", *figures, int(found["newton_jacobians"])))
            except ForwardModelError as error:
                rows.append((law, young, poisson, rate, error.kind, None, None, None, None))
    heading = (
        "law | E, Pa {g} | ν {.7g} | V_in, mm²/s {g} | outcome | largest displacement, µm {.4g} | min J fluid {.3f} "
        "| min J solid {.3f} | Jacobians {d}"
    )
    return [table("extremes", "Extreme inputs", heading, rows)]


def flow_cell(size: MeshSize, *, law: str = "saint_venant_kirchhoff", kind: type[FlowCell] = FlowCell) -> Any:
    """Return the study's specimen on a mesh of the given sizes."""
    return kind(Outline().interface(), size, channel=Channel(), partition=Partition(), law=LAWS[law])


def box_points(count: int, *, scramble: int | None = 5) -> Float[np.ndarray, "run 2"]:
    """Return (E in Pa, ν) at the first points of a Sobol sequence over the box."""
    low, high = np.array(BOX).T
    return low + (high - low) * np.asarray(sobol(count, 2, scramble=scramble))


def displacements(cell: FlowCell, points: Float[np.ndarray, "run 2"]) -> tuple[list[Points | None], list[float]]:
    """Return the interface's displacement at each point, None if the run failed, and the seconds of successful runs."""
    found: list[Points | None] = []
    seconds = []
    for young, poisson in points:
        start = time.perf_counter()
        try:
            found.append(cell.solve(Setting([young], [poisson], RATE)).displacement)
            seconds.append(time.perf_counter() - start)
        except ForwardModelError:
            found.append(None)
    return found, seconds


def tables() -> list[Table]:
    """Return the table of errors over the points at which both the reference mesh and the mesh succeed."""
    points = box_points(POINTS)
    reference, _ = displacements(flow_cell(REFERENCE), points)
    rows = []
    for name, size in MESHES.items():
        cell = flow_cell(size)
        found, seconds = displacements(cell, points)
        pairs = [(a, b) for a, b in zip(found, reference, strict=True) if a is not None and b is not None]
        errors = np.array([np.linalg.norm(a - b, axis=1).max() for a, b in pairs])
        shares = errors / np.array([np.linalg.norm(b, axis=1).max() for _, b in pairs])
        only = sum((a is None) != (b is None) for a, b in zip(found, reference, strict=True))
        sizes = (cell.mesh.ne, len(cell.system.free), len(pairs), only)
        figures = (1e3 * np.median(errors), 1e3 * errors.max(), 100 * np.median(shares), 100 * shares.max())
        rows.append((name, *sizes, *map(float, figures), 1e3 * float(np.median(seconds))))
    heading = (
        "mesh | elements {d} | unknowns {d} | points {d} | failed on one mesh only {d} | median, µm {.3f} "
        "| largest, µm {.3f} | median, % {.3f} | largest, % {.3f} | ms a solve {.0f}"
    )
    return [table("biofilm_mesh", "The biofilm's interface against a reference mesh", heading, rows)]


if __name__ == "__main__":
    show(tables())
