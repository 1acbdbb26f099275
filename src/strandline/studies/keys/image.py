"""The key `observation.image` of study.yaml: a picture, and where the interface is in it."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from strandline.studies.keys.scalars import Number
from strandline.studies.keys.section import Section, Switch

__all__ = ["ImageFile", "RegisteredTo"]

Place = Annotated[list[Number], Field(min_length=2, max_length=2)]


class RegisteredTo(Section):
    """Another picture of the same set-up, and what does not move from one to the other."""

    to: str | Annotated[list[str], Field(min_length=1)]
    """the other picture, e.g. of the undeformed specimen, or frames of it; `frame` is then the model's place in it"""
    marks: str | None = None
    """file of clicks on that picture, with its fixed regions and the origin"""
    fixed: list[Annotated[list[Place], Field(min_length=3)]] = []
    """or the fixed regions themselves, polygons in pixels of that picture"""

    @model_validator(mode="after")
    def _a_region(self) -> "RegisteredTo":
        if self.marks is None and not self.fixed:
            raise ValueError("the regions that do not move: `fixed: [[[x, y], …]]`, or `marks: FILE.path.json`")
        return self

    @property
    def files(self) -> list[str]:
        """The files of the other picture."""
        return [self.to] if isinstance(self.to, str) else list(self.to)


class ImageFile(Section):
    """A picture with the observed interface; `strandline.imaging` checks `edge`, and from `pixel` to `frame`."""

    file: str | Annotated[list[str], Field(min_length=1)]
    """the picture, relative to the study folder; a list, or a folder: frames of one state, averaged"""
    pixel: Any = None
    """size of a pixel, `{size: 3.1, unit: um}` or `{x: 6, y: 4, unit: um}`; needed unless the file's header or a scale
    bar in the file of clicks states it"""
    page: Any = None
    """page of a TIFF, from 0"""
    average: Any = None
    """`true`: the mean of all pages, as frames of one state"""
    index: Any = None
    """refractive index by which depths, along y, are divided"""
    scale: Any = None
    """what the numbers are: `intensity` (default), `amplitude`, `log10`, `dB` or `sRGB`"""
    channel: Any = None
    """of a colour picture: `grey` (default), `red`, `green` or `blue`"""
    dataset: Any = None
    """name of the data set in an HDF5 file"""
    reader: Any = None
    """[your own reader](../how-to/extend.md#a-picture-format) of the file, `module:name`; default: by its suffix"""
    frame: Any = None
    """where the model's (0, 0) is, `{origin: [212, 640]}` in pixels from the left and the top; with `x: left` or
    `y: down` if the model's axes point there, and `rotation` in degrees"""
    registration: RegisteredTo | None = None
    """where the set-up is in this picture: [found](../how-to/picture.md#two-pictures-of-one-specimen) from another one
    of it"""
    path: str | list[Place]
    """the interface, roughly: a file of clicks (`strandline image STUDY --edit` makes one), three or more pixels
    [[x, y], …], or `model`, the model's own outline"""
    closed: Switch = False
    """whether the interface is closed"""
    solid: Literal["bright", "dark"]
    """the side of the model: the brighter or the darker one"""
    edge: Any = "erf"
    """how the edge is found: `erf` for cameras, `path` for speckle, `contour` for the half level of clean pictures; or
    [your own](../how-to/extend.md#an-edge-method), `{method: "module:name", options: {…}}`"""
    trim: Annotated[Number, Field(ge=0, lt=0.5)] = 0.05
    """share of the edge left out at each end of an open one"""
    exclude: list[Annotated[list[Place], Field(min_length=3)]] = []
    """polygons in pixels in which the interface is not used"""

    @model_validator(mode="after")
    def _three_places(self) -> "ImageFile":
        if isinstance(self.path, list) and len(self.path) < 3:
            raise ValueError("`path` with at least three pixels [x, y] along the interface")
        return self

    @property
    def files(self) -> list[str]:
        """The files of the picture."""
        return [self.file] if isinstance(self.file, str) else list(self.file)

    @property
    def reading(self) -> dict[str, Any]:
        """How to read the picture."""
        names = ("pixel", "page", "average", "index", "scale", "channel", "dataset", "reader")
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}
