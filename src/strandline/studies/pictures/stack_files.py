"""What `strandline image` writes on a stack: the surface for VTK, slices with its outline, its errors in numbers."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from strandline.discrepancy import Discrepancy
from strandline.interface import Interface
from strandline.report.plots.stack import plot_stack
from strandline.report.plots.style import DOTS_PER_INCH
from strandline.studies.folder import require_writable, told_if_unwritable, whole_file, write_json
from strandline.studies.pictures.picture_files import IMAGE, PictureFiles, variances
from strandline.studies.pictures.scanned import Scanned

__all__ = ["described", "vtu", "write_stacks"]

TRIANGLE = 5
"""VTK's number of the kind of a cell."""


def write_stacks(
    folder: Path, stacks: Mapping[str, Scanned], *, measures: Mapping[str, Discrepancy] = MappingProxyType({})
) -> list[PictureFiles]:
    """Write surface, slices and numbers of each condition into ``image/`` of the study's folder.

    Args:
        folder: Folder of the study.
        stacks: The stacks with the observed surfaces, by condition.
        measures: The measures of the study, by name, whose noise variances are given.

    Raises:
        InvalidStudy: The folder cannot be written to.
    """
    require_writable(folder)
    target, out = folder / IMAGE, []
    with told_if_unwritable(target):
        target.mkdir(exist_ok=True)
        for condition, one in stacks.items():
            stem = f"{condition}-surface" if condition else "surface"
            content = described(one, measures)
            with whole_file(target / f"{stem}.vtu") as path:
                path.write_text(vtu(one.interface), encoding="utf-8")
            figure: Any = plot_stack(one.stack, one.surface.mesh)
            with whole_file(target / f"{stem}.png") as path:
                figure.savefig(path, dpi=DOTS_PER_INCH, format="png", metadata={"Software": None})
            write_json(target / f"{stem}.json", content)
            names = tuple(f"{IMAGE}/{stem}.{suffix}" for suffix in ("vtu", "png", "json"))
            out.append(PictureFiles(condition, content, names))
    return out


def described(one: Scanned, measures: Mapping[str, Discrepancy]) -> dict[str, Any]:
    """Return the errors of a surface, lengths in mm, and σ_N² of measures that fit them."""
    e = one.surface.errors
    return {
        "stack": one.name,
        "sha256": one.stack.sha256,
        "voxel_mm": list(one.stack.voxel),
        "notes": list(one.notes),
        "triangles": len(one.interface.cells),
        "points": len(one.interface.points),
        "closed": one.interface.closed,
        "sd": e.sd,
        "length": e.length,
        "offset": e.offset,
        "blur": e.blur,
        "contrast_to_noise": e.contrast_to_noise,
        "open_share": e.open_share,
        "facts": e.facts,
        "noise_variance": variances(one.interface, one.errors, measures),
    }


def vtu(surface: Interface) -> str:
    """Return a surface as the text of a file .vtu, in mm."""
    number = len(surface.cells)
    arrays = {
        "Points": _array("Points", "Float64", (" ".join(f"{x:.9g}" for x in row) for row in surface.points), 3),
        "Cells": _array("connectivity", "Int64", (" ".join(map(str, row)) for row in surface.cells.tolist()))
        + _array("offsets", "Int64", map(str, range(3, 3 * number + 1, 3)))
        + _array("types", "UInt8", [str(TRIANGLE)] * number),
    }
    inner = "".join(f"<{name}>\n{text}</{name}>\n" for name, text in arrays.items())
    return (
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">\n'
        f'<UnstructuredGrid>\n<Piece NumberOfPoints="{len(surface.points)}" NumberOfCells="{number}">\n{inner}'
        "</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"
    )


def _array(name: str, kind: str, rows: Any, components: int = 1) -> str:
    several = f' NumberOfComponents="{components}"' if components > 1 else ""
    body = "\n".join(rows)
    return f'<DataArray type="{kind}" Name="{name}"{several} format="ascii">\n{body}\n</DataArray>\n'
