"""Exact sensitivities of other flow cells against central differences: each law with each of its parameters.

Run it with:  python -m verification.validation.generality
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from verification.validation.energies import FURTHER
from verification.validation.tables import Cell, Table

from strandline.models.biofilm.materials import LAWS, further_parameters
from strandline.models.biofilm.model import Biofilm

__all__ = ["law_inputs", "sensitivity_errors", "tables"]

STEPS = (4e-2, 2e-2, 1e-2)
"""Steps, as shares of a value; see `_scale`."""


def law_inputs(law: str) -> dict[str, float]:
    """Return inputs of the study's specimen with another law."""
    names = (item.name for item in further_parameters(LAWS[law]))
    return {
        "E": 250.0 if FURTHER[law] else 400.0,
        "nu": 0.3,
        **dict(zip(names, FURTHER[law], strict=True)),
        "V_in": 100.0,
    }


def sensitivity_errors(model: Biofilm, inputs: Mapping[str, float]) -> dict[str, float]:
    """Return max |exact - difference| / max |exact| over the interface, by input.

    The differences are central with three steps, extrapolated to sixth order.
    """
    exact = replace(model, sensitivities=True)(inputs).sensitivities[""]
    return {
        name: float(np.abs(exact[name] - _extrapolated(model, inputs, name)).max() / np.abs(exact[name]).max())
        for name in inputs
    }


def _extrapolated(model: Biofilm, inputs: Mapping[str, float], name: str) -> np.ndarray:
    d = []
    for step in (share * _scale(name, inputs[name]) for share in STEPS):
        moved = [model({**inputs, name: inputs[name] + sign * step}).interface.points for sign in (1, -1)]
        d.append((moved[0] - moved[1]) / (2 * step))
    once = [(4 * d[i + 1] - d[i]) / 3 for i in range(2)]
    return np.asarray((16 * once[1] - once[0]) / 15)


def _scale(name: str, value: float) -> float:
    """Return the size that steps of an input are shares of.

    It is small for ν, which the interface depends on steeply, and large for inputs that change it little: Newton's
    tolerance would show in small differences.
    """
    if name == "nu":
        return 0.05
    return abs(value) if name in ("E", "V_in", "p_drop", "viscosity", "density") else 8 * abs(value)


def tables(mesh: str = "coarse") -> list[Table]:
    """Return the table of differences."""
    rows: list[tuple[Cell, ...]] = []
    for law in LAWS:
        found = sensitivity_errors(Biofilm(mesh=mesh, material=law), law_inputs(law))
        rows += [(law, name, law_inputs(law)[name], error) for name, error in found.items()]
    columns = ("flow cell", "derivative by", "at", "relative difference")
    title = "Sensitivities of other flow cells"
    return [Table("generality_sensitivities", title, columns, ("s", "s", "g", ".1e"), tuple(rows))]


def main() -> None:
    """Print the tables."""
    for table in tables():
        print(f"\n{table.title}\n\n{table.markdown()}")


if __name__ == "__main__":
    main()
