"""The mesh error that `strandline check` estimates on outlines other than the study's, against the true error.

The estimate is the difference from the next finer mesh, the true error that from a much finer one; both are the largest
distance of corresponding nodes of the interface.

Run it with:  python -m verification.validation.mesh_on_other_outlines [WORD ...]
"""

import dataclasses
import time
from collections.abc import Mapping

import numpy as np
from verification.validation.tables import arguments, show, table

from strandline.models.biofilm.cell import FlowCell, Setting
from strandline.models.biofilm.geometry import MESHES, MeshSize
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Channel, Outline

REFERENCE = MeshSize(far=0.03, interface=0.006, foot=0.0028, grading=0.2)
"""Mesh of the truth, finer than the one that ``fine`` is compared with."""

CASES: Mapping[str, tuple[Biofilm, Mapping[str, float]]] = {
    "layer, gap 0.4 mm, neo-Hookean": (
        Biofilm(
            material="neo_hookean",
            channel=Channel(length=3.0),
            outline=Outline(((0.0, 0.3), (0.8, 0.35), (1.5, 0.6), (2.2, 0.35), (3.0, 0.3))),
        ),
        {"E": 150.0, "nu": 0.3, "V_in": 60.0},
    ),
    "flat wide hump": (
        Biofilm(
            channel=Channel(length=4.0),
            outline=Outline(((0.5, 0.0), (0.8, 0.12), (1.3, 0.22), (2.0, 0.25), (2.7, 0.22), (3.2, 0.12), (3.5, 0.0))),
        ),
        {"E": 60.0, "nu": 0.3, "V_in": 100.0},
    ),
    "steep bump with corners": (
        Biofilm(
            material="neo_hookean",
            outline=Outline(((0.75, 0.0), (0.8, 0.4), (0.92, 0.7), (1.08, 0.7), (1.2, 0.4), (1.25, 0.0)), spline=False),
        ),
        {"E": 1500.0, "nu": 0.3, "V_in": 40.0},
    ),
}
"""Model, whose mesh is replaced, and inputs, by the name of the outline."""


def rows(name: str) -> list[tuple]:
    """Return a row for each mesh: elements, estimated and true error in µm, share in %, CPU seconds per run."""
    model, inputs = CASES[name]
    outline, young, poisson = model.outline.interface(), [inputs["E"]], [inputs["nu"]]

    def cell(size: MeshSize) -> FlowCell:
        return FlowCell(outline, size, channel=model.channel, partition=model.partition, law=LAWS[model.material])

    truth = outline.points + cell(REFERENCE).solve(Setting(young, poisson, inputs["V_in"])).displacement
    moved = 1e3 * float(np.linalg.norm(truth - model.undeformed().points, axis=1).max())
    found = []
    for mesh, size in MESHES.items():
        chosen = dataclasses.replace(model, mesh=mesh)
        begun = time.process_time()
        points = chosen(inputs).interface.points
        seconds = time.process_time() - begun
        finer = chosen.on_finer_mesh(inputs)[""].points
        estimate, error = (1e3 * float(np.linalg.norm(points - o, axis=1).max()) for o in (finer, truth))
        found.append((name, mesh, cell(size).mesh.ne, estimate, error, 100 * error / moved, moved, seconds))
    return found


if __name__ == "__main__":
    wanted = arguments(__doc__, words="WORD").words
    heading = (
        "outline | mesh | elements {d} | estimate by check, µm {.3f} | true error, µm {.3f} | true error, % {.3f} "
        "| largest displacement, µm {.1f} | CPU seconds, mesh and run {.2f}"
    )
    for name in CASES:
        if not wanted or any(word in name for word in wanted):
            show([table("mesh_on_other_outlines", "The meshes on other outlines", heading, rows(name))])
