"""The key `observation.stack` of study.yaml: pictures of parallel planes, and where the surface is in them."""

from typing import Annotated, Any, Literal

from pydantic import Field

from strandline.studies.keys.scalars import Number
from strandline.studies.keys.section import Section

__all__ = ["StackFile"]


class StackFile(Section):
    """A stack of pictures with the observed surface; `strandline.imaging` checks the keys from `voxel` to `exclude`."""

    file: str | Annotated[list[str], Field(min_length=1)]
    """the stack, relative to the study folder; a list: a picture for each plane, from the first to the last"""
    voxel: Any = None
    """size of a voxel, `{x: 0.2, y: 0.2, z: 0.5, unit: um}`; needed unless the file's header states it"""
    index: Any = None
    """refractive index by which depths, along y, are divided"""
    scale: Any = None
    """what the numbers are, as for `observation.image.scale`"""
    channel: Any = None
    """of pictures in colour: `grey` (default), `red`, `green` or `blue`"""
    dataset: Any = None
    """name of the data set in an HDF5 file"""
    reader: Any = None
    """your own reader of the file, as for `observation.image.reader`"""
    frame: Any = None
    """where the model's (0, 0, 0) is, `{origin: [128, 128, 64]}` in voxels from the left, the top and the first plane;
    with `x: left`, `y: up` or `z: first` if the model's axes point there, and `rotation: [0, 0, 30]` in degrees about
    its x, y and z axes"""
    exclude: list[Any] = []
    """regions in which the surface is not used: `{box: [[0, 0, 0], [10, 10, 5]], unit: um}` or
    `{ball: [5, 5, 0], radius: 2, unit: um}` in the model's coordinates, or `{voxels: [[0, 0, 0], [50, 50, 9]]}`"""
    solid: Literal["bright", "dark"]
    """the side of the model: the brighter or the darker one"""
    triangles: Annotated[int, Field(ge=100, le=50_000)] = 5000
    """most triangles of the surface"""
    smooth: Annotated[Number, Field(ge=0, le=5)] | None = None
    """standard deviation of the Gaussian that smooths the stack, in sides of a voxel; default: 1, up to 2 if noisy"""

    @property
    def files(self) -> list[str]:
        """The files of the stack."""
        return [self.file] if isinstance(self.file, str) else list(self.file)
