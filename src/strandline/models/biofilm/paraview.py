"""The solved state as files for ParaView: one VTU of the undeformed, one of the deformed mesh, and a PVD of both."""

from pathlib import Path

import numpy as np

from strandline.errors import InvalidInput
from strandline.models.biofilm.cell import FlowFields

__all__ = ["write_vtu"]

COLLECTION = """<?xml version="1.0"?>
<VTKFile type="Collection" version="0.1">
  <Collection>
    <DataSet timestep="0" part="0" file="undeformed.vtu"/>
    <DataSet timestep="1" part="0" file="deformed.vtu"/>
  </Collection>
</VTKFile>
"""


def write_vtu(fields: FlowFields, folder: Path) -> Path:
    """Write undeformed.vtu, deformed.vtu and flow.pvd into `folder`, made if needed; return the path of the last.

    Both meshes carry velocity [mm/s], pressure [Pa] and displacement [mm] at the nodes. Per cell they carry the `part`,
    0 in the fluid, 1, 2, … in the solid in the order of the partition's markers, and the solid's Cauchy stress [Pa], 0
    in the fluid, with the components in ParaView's order xx, yy, zz, xy, yz, xz. In the fluid the displacement is that
    of the mesh; in the solid velocity and pressure are 0. In the PVD, time 0 is the undeformed and time 1 the deformed
    state.

    Args:
        fields: Solved state from `Biofilm.fields`.
        folder: Folder of the files.

    Raises:
        InvalidInput: the package meshio is not installed, or the folder cannot be written to.
    """
    try:
        import meshio
    except ImportError:
        raise InvalidInput(
            "files for ParaView",
            value="no package meshio",
            expected="the optional package meshio",
            remedy='Install it: pip install "strandline[vtu]"',
        ) from None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, points in (("undeformed", fields.points - fields.displacement), ("deformed", fields.points)):
            mesh = meshio.Mesh(
                _in_space(points),
                [("triangle", fields.triangles)],
                point_data={
                    "velocity [mm/s]": _in_space(fields.velocity),
                    "pressure [Pa]": fields.pressure,
                    "displacement [mm]": _in_space(fields.displacement),
                },
                cell_data={
                    "part": [fields.cell_part.astype(np.int8)],
                    "Cauchy stress [Pa]": [_symmetric(fields.stress)],
                },
            )
            mesh.write(folder / f"{name}.vtu")
        (folder / "flow.pvd").write_text(COLLECTION, encoding="utf-8")
    except OSError as error:
        raise InvalidInput(
            "folder for the files for ParaView",
            value=str(error),
            expected="a folder that can be written to",
            remedy="Choose another folder.",
        ) from None
    return folder / "flow.pvd"


def _in_space(vectors: np.ndarray) -> np.ndarray:
    """Return plane vectors with a third component 0."""
    return np.column_stack([vectors, np.zeros(len(vectors))])


def _symmetric(stress: np.ndarray) -> np.ndarray:
    """Return (xx, yy, xy, zz) as (xx, yy, zz, xy, yz, xz)."""
    xx, yy, xy, zz = stress.T
    return np.column_stack([xx, yy, zz, xy, 0.0 * xy, 0.0 * xy])
