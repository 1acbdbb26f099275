"""Inputs at the limits of what the model admits: ν = ½ exactly, ν near -1, no flow, a very stiff solid; all laws."""

from collections.abc import Iterable

from verification.validation.biofilm_mesh import flow_cell
from verification.validation.energies import FURTHER
from verification.validation.tables import Table, table

from strandline.errors import ForwardModelError
from strandline.models.biofilm.cell import Setting
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.materials import LAWS

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


def tables(*, mesh: str = "default", laws: Iterable[str] = tuple(LAWS)) -> list[Table]:
    """Return the table of outcomes."""
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
