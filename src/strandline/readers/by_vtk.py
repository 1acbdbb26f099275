"""Files that VTK itself reads: legacy polygonal data, as pyvista saves them, and structured grids in XML."""

import importlib
import re
from pathlib import Path
from typing import Any

from strandline.errors import InvalidInput
from strandline.readers.by_meshio import read_by_meshio
from strandline.readers.contents import Contents
from strandline.readers.options import Reading
from strandline.readers.vtk_xml import contents_of

__all__ = ["read_by_vtk", "read_legacy"]


def read_legacy(path: Path, how: Reading, name: str) -> Contents:
    """Return the contents of a legacy file: polygonal data by VTK, anything else by meshio."""
    if re.search(rb"^DATASET\s+POLYDATA", path.read_bytes()[:1000], re.MULTILINE | re.IGNORECASE):
        return read_by_vtk(path, how, name)
    return read_by_meshio(path, how, name)


def read_by_vtk(path: Path, how: Reading, name: str) -> Contents:
    """Return the contents of a file, which VTK rewrites as VTU or VTP.

    Raises:
        InvalidInput: VTK is not installed.
        ValueError: VTK reports an error, or finds no points.
    """
    core, xml, legacy, filters = (_imported(f"vtkmodules.{module}", name) for module in MODULES)
    reader = legacy.vtkGenericDataObjectReader() if how.suffix == ".vtk" else xml.vtkXMLGenericDataObjectReader()
    usual, errors, log = core.vtkOutputWindow.GetInstance(), core.vtkStringOutputWindow(), core.vtkLogger
    verbosity = log.GetCurrentVerbosityCutoff()
    core.vtkOutputWindow.SetInstance(errors)
    log.SetStderrVerbosity(log.VERBOSITY_OFF)
    try:
        reader.SetFileName(str(path))
        reader.Update()
    finally:
        core.vtkOutputWindow.SetInstance(usual)
        log.SetStderrVerbosity(verbosity)
    found = reader.GetOutput()
    if errors.GetOutput() or reader.GetErrorCode() or found is None or not found.GetNumberOfPoints():
        raise ValueError((errors.GetOutput().strip() or "VTK finds no points in it").splitlines()[-1])
    writer = xml.vtkXMLPolyDataWriter()
    if not found.IsA("vtkPolyData"):
        writer, append = xml.vtkXMLUnstructuredGridWriter(), filters.vtkAppendFilter()
        append.AddInputData(found)
        append.Update()
        found = append.GetOutput()
    writer.SetInputData(found)
    writer.SetDataModeToBinary()
    writer.SetCompressorTypeToNone()
    writer.WriteToOutputStringOn()
    writer.Write()
    return contents_of(writer.GetOutputString().encode())


MODULES = ("vtkCommonCore", "vtkIOXML", "vtkIOLegacy", "vtkFiltersCore")


def _imported(module: str, name: str) -> Any:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError:
        raise InvalidInput(
            f"{name} needs VTK",
            value="no package vtk",
            expected="the extra `vtk`",
            remedy="Install it: pip install 'strandline[vtk]'; or save the file as .vtp or .vtu.",
        ) from None
