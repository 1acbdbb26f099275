"""Meshes whose shapes are known, and files of them."""

from pathlib import Path
from typing import Any

import meshio
import numpy as np

from strandline.interface import Interface
from strandline.readers import Reading, read_interface

NX, NY = 4, 2
TOP = np.stack([np.arange(NX + 1.0), np.full(NX + 1, float(NY))], axis=1)
BENT = TOP + np.stack([np.zeros(NX + 1), 0.2 * np.arange(NX + 1.0)], axis=1)
TETRA = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
VTP_ASCII = """<VTKFile type="PolyData" version="0.1"><PolyData>
<Piece NumberOfPoints="4" NumberOfVerts="1" NumberOfLines="2" NumberOfPolys="0">
<Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 2 1 0 3 1 0</DataArray></Points>
<Verts><DataArray type="Int32" Name="connectivity">0</DataArray><DataArray type="Int32" Name="offsets">1</DataArray>
</Verts>
<Lines><DataArray type="Int32" Name="connectivity">3 2 0 1 2</DataArray>
<DataArray type="Int32" Name="offsets">2 5</DataArray></Lines>
<CellData><DataArray type="Int32" Name="part">0 1 2</DataArray></CellData>
</Piece></PolyData></VTKFile>"""


def read(path: Path, **options: Any) -> Interface:
    return read_interface(path, Reading.from_options({"file": path.name, "unit": "mm", **options}, "result"))


def grid(kind: str = "triangle") -> meshio.Mesh:
    """A rectangle 4 by 2 of triangles or quads, its region 1 below, 2 above; line cells along its top, shuffled."""
    x, y = np.meshgrid(np.arange(NX + 1.0), np.arange(NY + 1.0))
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    corner = np.array([j * (NX + 1) + i for j in range(NY) for i in range(NX)])
    quads = corner[:, None] + np.array([0, 1, NX + 2, NX + 1])
    region = np.repeat([1, 2], NX)
    if kind == "triangle":
        cells = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        region = np.concatenate([region, region])
    else:
        cells = quads
    top = NY * (NX + 1) + np.arange(NX)
    lines = np.stack([top, top + 1], axis=1)[[2, 0, 3, 1]]
    lines[0] = lines[0, ::-1]
    moved = np.stack([0 * points[:, 0], 0.1 * points[:, 0] * points[:, 1], 0 * points[:, 0]], axis=1)
    return meshio.Mesh(
        points,
        [(kind, cells), ("line", lines)],
        point_data={"u": moved, "top": (points[:, 1] == NY).astype(float)},
        cell_data={"region": [region, np.full(NX, 7)]},
    )


def vtu(folder: Path, mesh: meshio.Mesh, **options: Any) -> Path:
    path = folder / "mesh.vtu"
    meshio.vtu.write(str(path), mesh, **options)
    return path


def cells_of(folder: Path, points: Any, kind: str, cells: Any) -> Path:
    return vtu(folder, meshio.Mesh(np.array(points, float), [(kind, cells)]))


def pvd(folder: Path) -> Path:
    """Write a series of three times, at which the displacements are 0, 1 and 2 times those of the grid."""
    entries, mesh = [], grid()
    (folder / "steps").mkdir(exist_ok=True)
    for k, at in enumerate((0.0, 1.0, 2.0)):
        mesh.point_data["u"] = at * grid().point_data["u"]
        meshio.vtu.write(str(folder / "steps" / f"{k}.vtu"), mesh)
        entries.append(f'<DataSet timestep="{at}" part="0" file="steps/{k}.vtu"/>')
    path = folder / "series.pvd"
    path.write_text(
        f'<?xml version="1.0"?><VTKFile type="Collection"><Collection>{"".join(entries)}</Collection></VTKFile>'
    )
    return path
