"""Inputs at the limits of what the model admits: ν = ½ exactly, ν near -1, no flow, a very stiff solid; all laws.

Run it with:  python -m verification.validation.extremes
"""

from collections.abc import Iterable

from verification.validation.biofilm_mesh import flow_cell
from verification.validation.energies import FURTHER
from verification.validation.tables import Table

from strandline.errors import ForwardModelError
from strandline.models.biofilm.cell import Setting
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.materials import LAWS

__all__ = ["CASES", "tables"]

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
    columns = (
        "law", "E, Pa", "ν", "V_in, mm²/s", "outcome",
        "largest displacement, µm", "min J fluid", "min J solid", "Jacobians",
    )  # fmt: skip
    formats = ("s", "g", ".7g", "g", "s", ".4g", ".3f", ".3f", "d")
    return [Table("extremes", "Extreme inputs", columns, formats, tuple(rows))]


def main() -> None:
    """Print the table."""
    for table in tables():
        print(f"{table.title}\n\n{table.markdown()}")


if __name__ == "__main__":
    main()
