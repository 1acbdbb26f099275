"""The mesh error that `strandline check` estimates on another outline than the study's, against the true error.

The estimate is the difference from the next finer mesh, the true error that from a much finer one; both are the largest
distance of corresponding nodes of the interface.

Run it with:  python -m verification.validation.mesh_on_other_outlines
"""

import dataclasses
import time

import numpy as np
from verification.validation.tables import show, table

from strandline.models.biofilm.cells.cell import FlowCell, Setting
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.mesh.geometry import MESHES, MeshSize
from strandline.models.biofilm.mesh.outline import Channel, Outline
from strandline.models.biofilm.model import Biofilm

REFERENCE = MeshSize(far=0.03, interface=0.006, foot=0.0028, grading=0.2)
"""Mesh of the truth, finer than the one that ``fine`` is compared with."""

MODEL = Biofilm(
    material="neo_hookean",
    channel=Channel(length=3.0),
    outline=Outline(((0.0, 0.3), (0.8, 0.35), (1.5, 0.6), (2.2, 0.35), (3.0, 0.3))),
)
"""A layer below a gap of 0.4 mm."""
INPUTS = {"E": 150.0, "nu": 0.3, "V_in": 60.0}


def rows() -> list[tuple]:
    """Return a row for each mesh: elements, estimated and true error in µm, share in %, CPU seconds per run."""
    outline, setting = MODEL.outline.interface(), Setting([INPUTS["E"]], [INPUTS["nu"]], INPUTS["V_in"])

    def cell(size: MeshSize) -> FlowCell:
        return FlowCell(outline, size, channel=MODEL.channel, partition=MODEL.partition, law=LAWS["neo_hookean"])

    truth = outline.points + cell(REFERENCE).solve(setting).displacement
    moved = 1e3 * float(np.linalg.norm(truth - MODEL.undeformed().points, axis=1).max())
    found = []
    for mesh, size in MESHES.items():
        chosen = dataclasses.replace(MODEL, mesh=mesh)
        begun = time.process_time()
        points = chosen(INPUTS).interface.points
        seconds = time.process_time() - begun
        finer = chosen.on_finer_mesh(INPUTS)[""].points
        estimate, error = (1e3 * float(np.linalg.norm(points - o, axis=1).max()) for o in (finer, truth))
        found.append((mesh, cell(size).mesh.ne, estimate, error, 100 * error / moved, moved, seconds))
    return found


if __name__ == "__main__":
    heading = (
        "mesh | elements {d} | estimate by check, µm {.3f} | true error, µm {.3f} | true error, % {.3f} "
        "| largest displacement, µm {.1f} | CPU seconds, mesh and run {.2f}"
    )
    show([table("mesh_on_other_outlines", "The meshes on a layer below a narrow gap", heading, rows())])
