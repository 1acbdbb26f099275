"""All verifications of the forward model; they take a few minutes on one core.

Prints the tables and writes their raw numbers to verification/validation/output/verification.json. With ``--publish``
the tables go into the page docs/results/forward-model.md, their numbers next to it, and the figures are drawn again.

Run it with:  python -m verification.validation [--publish]
"""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from verification.reproduction.figures import plot_parts
from verification.validation import analytic, biofilm_mesh, generality, turek_hron
from verification.validation.tables import DOCS, Table, arguments, show

from strandline.models.biofilm.mesh.geometry import Partition
from strandline.models.biofilm.model import Biofilm

PAGE = DOCS / "results" / "forward-model.md"
PARTS = (turek_hron.tables, analytic.tables, biofilm_mesh.tables, biofilm_mesh.extremes, generality.tables)


def draw(tables: Sequence[Table], folder: Path) -> None:
    """Write forward-convergence.png and forward-mesh.png into `folder`."""
    named = {table.name: table for table in tables}
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    _convergence_of_benchmark(axes[0], named["FSI1"])
    _convergence_of_solid(axes[1], named["manufactured"])
    figure.savefig(folder / "forward-convergence.png", dpi=130)
    plt.close(figure)
    figure, axes = plt.subplots(figsize=(8, 4.2), layout="constrained")
    plot_parts(Biofilm(partition=Partition.PRESETS["three_parts"]), axes)
    figure.savefig(folder / "forward-mesh.png", dpi=130)
    plt.close(figure)


def _convergence_of_benchmark(ax: Axes, table: Table) -> None:
    for k, key in enumerate(dict.fromkeys(table.column("quantity"))):
        for order, style in ((2, "o-"), (3, "s--")):
            rows = [row for row in table.rows if (row[0], row[2]) == (key, order)]
            errors = [abs(float(row[7] or 0.0)) for row in rows]
            ax.loglog([row[4] for row in rows], errors, style, color=f"C{k}", label=f"{key}, P{order}")
    ax.set(xlabel="unknowns", ylabel="error against the published value, %", title="FSI1")
    ax.legend(fontsize="x-small", ncols=2)


def _convergence_of_solid(ax: Axes, table: Table) -> None:
    """Draw the errors of the manufactured solution against the element size; other laws are as good as neo-Hookean."""
    for k, law in enumerate(("saint_venant_kirchhoff", "neo_hookean")):
        for poisson, style in ((-0.5, "o-"), (0.49, "s--")):
            rows = [row for row in table.rows if row[:2] == (law, poisson)]
            ax.loglog([r[2] for r in rows], [r[3] for r in rows], style, color=f"C{k}", label=f"{law}, ν = {poisson}")
    h = np.array([0.05, 0.2])
    ax.loglog(h, 3e-6 * (h / 0.05) ** 3, "k:", label="order 3")
    ax.set(xlabel="element size", ylabel="L² error of the displacement", title="Manufactured solution")
    ax.legend(fontsize="x-small")


if __name__ == "__main__":
    options, tables = arguments(__doc__, publish=False), list[Table]()
    for part in PARTS:
        tables += part()
        print(f"{tables[-1].title} done", flush=True)
    show(tables, page=PAGE if options.publish else None, numbers="verification.json")
    if options.publish:
        draw(tables, DOCS / "figures")
